"""Frames of an episode: states, the motions between them, and imagined roll-outs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from visualrhp.errors import ConfigError
from visualrhp.rendering.drawing import DEFAULT_SIZE_PX
from visualrhp.rendering.imagined import ImaginedPath
from visualrhp.rendering.panels import Caption
from visualrhp.rendering.scene_view import SceneView
from visualrhp.rendering.video import Frame
from visualrhp.scene import Scene
from visualrhp.types import Outcome, State


class EpisodeRenderer:
    """Renders an episode step by step: the planner's roll-outs in a state, then the motion to the next state.

    The poses during a motion are those of the simulation (:mod:`visualrhp.simulation.recording`). The label image is
    always that of the last state at rest.

    Args:
        scene: the scene in which the episode runs.
        state: the initial state.
        title: of the caption; empty for no caption.
        max_steps: the action limit, for the caption.
        size_px: see :func:`~visualrhp.rendering.frames.render_frame`.
        imagined_frames: pictures of the planner's roll-outs before each action.
        show_imagined: whether to add a bar below the pictures for the number and the returns of the imagined paths.
        show_observation: see :func:`~visualrhp.rendering.frames.render_frame`.
        show_inset: see :func:`~visualrhp.rendering.frames.render_frame`.
        believed_scene: the scene of the planner's model, shown in the label image; None if it is that of the world
            (Sec. 8.2).

    Raises:
        ConfigError: ``imagined_frames`` is not positive, or see :func:`~visualrhp.rendering.frames.render_frame`.
    """

    def __init__(
        self,
        scene: Scene,
        state: State,
        *,
        title: str = "",
        max_steps: int | None = None,
        size_px: int = DEFAULT_SIZE_PX,
        imagined_frames: int = 6,
        show_imagined: bool = False,
        show_observation: bool = False,
        show_inset: bool = False,
        believed_scene: Scene | None = None,
    ) -> None:
        if imagined_frames < 1:
            raise ConfigError(f"imagined_frames={imagined_frames}: at least one picture for each action is needed")
        self._view = SceneView(
            scene,
            size_px,
            show_legend=True,
            show_observation=show_observation,
            show_inset=show_inset,
            believed_scene=believed_scene,
        )
        self._title = title
        self._max_steps = max_steps
        self._imagined_frames = imagined_frames
        self._states = [state]
        self._listed: Sequence[ImaginedPath] | None = () if show_imagined else None
        self._decision_s: float | None = None

    def still(self, outcome: Outcome | None = None) -> Frame:
        """Draw the current state, with the outcome of the episode if it has ended."""
        return self._draw(self._states[-1], outcome=outcome)

    def imagine(self, paths: Sequence[ImaginedPath], decision_s: float | None = None) -> Iterator[Frame]:
        """Draw roll-outs in the current state; their returns stay until the next ones. No frames if there are none.

        Args:
            paths: of the roll-outs.
            decision_s: duration of the decision [s], for the bar.
        """
        if self._listed is None or not paths:
            return
        self._listed, self._decision_s = paths, decision_s
        picture = self._draw(self._states[-1], paths)
        for _ in range(self._imagined_frames):
            yield picture

    def move(self, motion: Sequence[State], outcome: Outcome | None = None) -> Iterator[Frame]:
        """Draw a motion: the first of its states is the current one, the last becomes the current one."""
        for state in motion[1:-1]:
            yield self._draw(state, moving=True)
        self._states.append(motion[-1])
        yield self.still(outcome)

    def _draw(
        self,
        state: State,
        paths: Sequence[ImaginedPath] = (),
        *,
        moving: bool = False,
        outcome: Outcome | None = None,
    ) -> Frame:
        trail = self._states if moving else self._states[:-1]
        caption = Caption(self._title, len(trail), self._max_steps, outcome) if self._title else None
        return self._view.draw(state, self._states[-1], trail, caption, paths, self._listed, self._decision_s)


def episode_frames(
    scene: Scene,
    state: State,
    motions: Sequence[Sequence[State]],
    *,
    title: str = "",
    outcome: Outcome | None = None,
    max_steps: int | None = None,
    imagined: Sequence[Sequence[ImaginedPath]] | None = None,
    decision_s: Sequence[float] | None = None,
    size_px: int = DEFAULT_SIZE_PX,
    imagined_frames: int = 6,
    hold: int = 18,
    show_observation: bool = False,
    show_inset: bool = False,
    believed_scene: Scene | None = None,
) -> Iterator[Frame]:
    """Frames of a video of an episode: its states, the motions between them, and ``hold`` frames of its end.

    Args:
        scene: the scene in which the episode ran.
        state: the initial state.
        motions: the states during each action, the first and last of them at rest
            (:meth:`visualrhp.simulation.recording.MotionRecorder.record_episode`).
        title: of the caption; empty for no caption.
        outcome: shown in the caption of the last state.
        max_steps: the action limit, for the caption.
        imagined: for each of the first states, up to all of them, the roll-outs that the planner compared, or its
            plan; they are shown before the motion. None for no such bar.
        decision_s: duration of the decision in each of these states [s], for the bar.
        size_px: see :func:`~visualrhp.rendering.frames.render_frame`.
        imagined_frames: see :class:`EpisodeRenderer`.
        hold: number of repetitions of the last picture.
        show_observation: see :func:`~visualrhp.rendering.frames.render_frame`.
        show_inset: see :func:`~visualrhp.rendering.frames.render_frame`.
        believed_scene: see :class:`EpisodeRenderer`.

    Raises:
        ConfigError: ``imagined_frames`` is not positive, or see :func:`~visualrhp.rendering.frames.render_frame`.
    """
    renderer = EpisodeRenderer(
        scene,
        state,
        title=title,
        max_steps=max_steps,
        size_px=size_px,
        imagined_frames=imagined_frames,
        show_imagined=imagined is not None,
        show_observation=show_observation,
        show_inset=show_inset,
        believed_scene=believed_scene,
    )
    last = len(motions)
    picture = renderer.still(outcome if last == 0 else None)
    yield picture
    for step in range(last + 1):
        if imagined is not None and step < len(imagined):
            yield from renderer.imagine(imagined[step], None if decision_s is None else decision_s[step])
        if step < last:
            for picture in renderer.move(motions[step], outcome if step + 1 == last else None):
                yield picture
    for _ in range(hold):
        yield picture
