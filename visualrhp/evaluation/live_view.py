"""Shows an episode in a window while it runs."""

from __future__ import annotations

from collections.abc import Iterable

from visualrhp.evaluation.films import imagined_paths
from visualrhp.execution.episode import EpisodeListener, TimedDecision
from visualrhp.rendering.episode_renderer import EpisodeRenderer
from visualrhp.rendering.video import Frame
from visualrhp.rendering.window import Window
from visualrhp.simulation.recording import MotionRecorder
from visualrhp.types import Action, Outcome, State


class LiveView(EpisodeListener):
    """Draws every state and decision in a window at the pace of a video.

    Args:
        window: shows the frames.
        renderer: of the episode's frames; it knows the initial state.
        recorder: of the motions in the world.
        fps: frames a second.
        hold_s: how long the end is shown [s].
    """

    def __init__(
        self, window: Window, renderer: EpisodeRenderer, recorder: MotionRecorder, fps: float, hold_s: float
    ) -> None:
        self._window, self._renderer, self._recorder = window, renderer, recorder
        self._frame_s, self._hold_s = 1.0 / fps, hold_s
        self._step: tuple[State, Action] | None = None

    def observed(self, state: State, outcome: Outcome | None) -> None:
        if self._step is None:
            self._show([self._renderer.still()])
        elif self._window.is_open:
            self._show(self._renderer.move(self._recorder.record(*self._step), outcome))

    def decided(self, decision: TimedDecision) -> None:
        if decision.decision.action is not None:
            self._step = decision.state, decision.decision.action
        self._show(self._renderer.imagine(imagined_paths(decision.decision), decision.time_s))

    def end(self, outcome: Outcome) -> None:
        """Show the last state with the outcome of the episode for a while."""
        self._window.show(self._renderer.still(outcome), self._hold_s)
        self._window.show(self._renderer.still(outcome), 0.0)

    def _show(self, frames: Iterable[Frame]) -> None:
        for frame in frames:
            if not self._window.show(frame, self._frame_s):
                return
