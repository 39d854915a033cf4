"""Pictures of a task: anti-aliased frames of a scene with its past, the label image and imagined roll-outs.

The world frame (x right, y up, metres) appears with y up; pixels exist only in this package.
"""

from __future__ import annotations

from collections.abc import Sequence

from visualrhp.rendering.drawing import DEFAULT_SIZE_PX
from visualrhp.rendering.imagined import ImaginedPath
from visualrhp.rendering.panels import Caption
from visualrhp.rendering.scene_view import SceneView
from visualrhp.rendering.video import Frame
from visualrhp.scene import Scene
from visualrhp.types import State


def render_frame(
    scene: Scene,
    state: State,
    *,
    size_px: int = DEFAULT_SIZE_PX,
    trail: Sequence[State] = (),
    imagined: Sequence[ImaginedPath] | None = None,
    caption: Caption | None = None,
    show_legend: bool = False,
    show_observation: bool = False,
    show_inset: bool = False,
) -> Frame:
    """Draw a state of a scene.

    Args:
        scene: the scene.
        state: the state to draw.
        size_px: height and width of the picture of the scene; the caption adds a bar above it, the imagined paths and
            the legend bars below it, and the observation a panel to its right.
        trail: earlier states, oldest first; the paths of the gripper and of the desired object are drawn through them
            and fade with age.
        imagined: a planner's roll-outs or its plan, drawn with their returns over the picture, with a bar below for
            their number and the colour scale of returns; an empty sequence gives an empty bar, None no bar.
        caption: text of the bar above; None for no bar.
        show_legend: whether to add a bar below that says what the colours mean.
        show_observation: whether to add the abstract label image (Sec. 5.1), enlarged pixel by pixel, as a panel.
        show_inset: whether to draw the abstract label image in the corner of the picture where it hides least.

    Returns:
        [H, W, 3] uint8 RGB, H and W even; H = W = ``size_px`` (rounded up to even) without bars and panels.

    Raises:
        ConfigError: ``size_px`` is below 64.
    """
    view = SceneView(scene, size_px, show_legend=show_legend, show_observation=show_observation, show_inset=show_inset)
    return view.draw(state, state, trail, caption, imagined or (), imagined, None)
