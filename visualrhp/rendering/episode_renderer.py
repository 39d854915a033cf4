"""Frames of an episode: states, the motions between them, and imagined roll-outs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from visualrhp.errors import ConfigError
from visualrhp.rendering.imagined import ImaginedPath
from visualrhp.rendering.panels import Caption
from visualrhp.rendering.scene_view import SceneView
from visualrhp.rendering.video import Frame
from visualrhp.scene import Scene
from visualrhp.types import Column, Outcome, State, wrap_angle


class EpisodeRenderer:
    """Renders an episode step by step: the planner's roll-outs in a state, then the motion to the next state.

    Only states at rest are recorded, so the pictures between them interpolate the poses (a visual aid, not physics; the
    label image is always that of the last state at rest).

    Args:
        scene: the scene in which the episode runs.
        state: the initial state.
        title: of the caption; empty for no caption.
        max_steps: the action limit, for the caption.
        size_px: see :func:`~visualrhp.rendering.frames.render_frame`.
        frames_per_action: pictures for each action, including the state that it leads to.
        imagined_frames: pictures of the planner's roll-outs before each action.
        show_imagined: whether to add a bar below the pictures for the legend of the imagined paths.
        show_observation: see :func:`~visualrhp.rendering.frames.render_frame`.
        show_inset: see :func:`~visualrhp.rendering.frames.render_frame`.
        believed_scene: the scene of the planner's model, shown in the label image; None if it is that of the world
            (Sec. 8.2).

    Raises:
        ConfigError: ``frames_per_action`` or ``imagined_frames`` is not positive, or see
            :func:`~visualrhp.rendering.frames.render_frame`.
    """

    def __init__(
        self,
        scene: Scene,
        state: State,
        *,
        title: str = "",
        max_steps: int | None = None,
        size_px: int = 480,
        frames_per_action: int = 6,
        imagined_frames: int = 6,
        show_imagined: bool = False,
        show_observation: bool = False,
        show_inset: bool = False,
        believed_scene: Scene | None = None,
    ) -> None:
        for name, value in (("frames_per_action", frames_per_action), ("imagined_frames", imagined_frames)):
            if value < 1:
                raise ConfigError(f"{name}={value}: at least one picture for each action is needed")
        self._view = SceneView(scene, size_px, show_observation, show_inset, believed_scene)
        self._title = title
        self._max_steps = max_steps
        self._frames_per_action = frames_per_action
        self._imagined_frames = imagined_frames
        self._states = [state]
        self._legend: Sequence[ImaginedPath] | None = () if show_imagined else None
        self._decision_s: float | None = None

    def still(self, outcome: Outcome | None = None) -> Frame:
        """Draw the current state, with the outcome of the episode if it has ended."""
        return self._draw(self._states[-1], outcome=outcome)

    def imagine(self, paths: Sequence[ImaginedPath], decision_s: float | None = None) -> Iterator[Frame]:
        """Draw roll-outs in the current state; their legend stays until the next ones. No frames if there are none.

        Args:
            paths: of the roll-outs.
            decision_s: duration of the decision [s], for the legend.
        """
        if self._legend is None or not paths:
            return
        self._legend, self._decision_s = paths, decision_s
        picture = self._draw(self._states[-1], paths)
        for _ in range(self._imagined_frames):
            yield picture

    def move(self, state: State, outcome: Outcome | None = None) -> Iterator[Frame]:
        """Draw the motion from the current state to ``state``, which becomes the current state."""
        past = self._states[-1]
        for part in range(1, self._frames_per_action):
            yield self._draw(interpolate(past, state, part / self._frames_per_action), moving=True)
        self._states.append(state)
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
        return self._view.draw(state, self._states[-1], trail, caption, paths, self._legend, self._decision_s)


def episode_frames(
    scene: Scene,
    states: Sequence[State],
    *,
    title: str = "",
    outcome: Outcome | None = None,
    max_steps: int | None = None,
    imagined: Sequence[Sequence[ImaginedPath]] | None = None,
    decision_s: Sequence[float] | None = None,
    size_px: int = 480,
    frames_per_action: int = 6,
    imagined_frames: int = 6,
    hold: int = 18,
    show_observation: bool = False,
    show_inset: bool = False,
    believed_scene: Scene | None = None,
) -> Iterator[Frame]:
    """Frames of a video of an episode: its states, interpolated pictures between them, and ``hold`` frames of its end.

    Args:
        scene: the scene in which the episode ran.
        states: L + 1 states, the first one initial.
        title: of the caption; empty for no caption.
        outcome: shown in the caption of the last state.
        max_steps: the action limit, for the caption.
        imagined: for each of the first states, up to all of them, the roll-outs that the planner compared, or its
            plan; they are shown before the motion. None for no legend.
        decision_s: duration of the decision in each of these states [s], for the legend.
        size_px: see :func:`~visualrhp.rendering.frames.render_frame`.
        frames_per_action: see :class:`EpisodeRenderer`.
        imagined_frames: see :class:`EpisodeRenderer`.
        hold: number of repetitions of the last picture.
        show_observation: see :func:`~visualrhp.rendering.frames.render_frame`.
        show_inset: see :func:`~visualrhp.rendering.frames.render_frame`.
        believed_scene: see :class:`EpisodeRenderer`.

    Raises:
        ConfigError: ``frames_per_action`` or ``imagined_frames`` is not positive, or see
            :func:`~visualrhp.rendering.frames.render_frame`.
    """
    renderer = EpisodeRenderer(
        scene,
        states[0],
        title=title,
        max_steps=max_steps,
        size_px=size_px,
        frames_per_action=frames_per_action,
        imagined_frames=imagined_frames,
        show_imagined=imagined is not None,
        show_observation=show_observation,
        show_inset=show_inset,
        believed_scene=believed_scene,
    )
    last = len(states) - 1
    picture = renderer.still(outcome if last == 0 else None)
    yield picture
    for step in range(last + 1):
        if imagined is not None and step < len(imagined):
            yield from renderer.imagine(imagined[step], None if decision_s is None else decision_s[step])
        if step < last:
            for picture in renderer.move(states[step + 1], outcome if step + 1 == last else None):
                yield picture
    for _ in range(hold):
        yield picture


def interpolate(start: State, end: State, fraction: float) -> State:
    """Interpolate two states: positions and opening linearly, angles along the shorter arc; ``fraction`` in [0, 1]."""
    if fraction >= 1.0:
        return end
    difference = end.vector - start.vector
    for angles in (Column.GRIPPER_THETA, Column.OBJECTS_THETA):
        difference[angles] = wrap_angle(difference[angles])
    difference[Column.CLOSED] = 0.0  # the command changes with the next action
    return State(start.vector + fraction * difference)
