"""Poses during a motion, for films.

A simulator is exactly Markov, so nothing is recorded while an episode runs: its actions are simulated again, in a
simulator that reads the poses after every time step. Reading changes nothing.
"""

from __future__ import annotations

from visualrhp.errors import ConfigError, DataError
from visualrhp.simulation.chipmunk import Space
from visualrhp.simulation.simulator import Simulator
from visualrhp.simulation.transition_model import TransitionModel
from visualrhp.types import Action, Episode, State


class RecordingSimulator(Simulator):
    """A simulator that keeps the state after every time step of its last motion.

    Attributes:
        recorded: the state before the motion, then one after every time step; the last one is the result of
            :meth:`~visualrhp.simulation.simulator.Simulator.advance`.
    """

    recorded: list[State]

    def begin(self, state: State, closed: bool) -> Space:
        self._closed = closed
        self.recorded = [state]
        return super().begin(state, closed)

    def step(self, space: Space, steps: int) -> None:
        for _ in range(steps):
            super().step(space, 1)
            self.recorded.append(self.read(space, self._closed))


class MotionRecorder:
    """Simulates actions again, and returns the states during their motions, equally spaced in time.

    Args:
        model: of the world in which the actions were executed.
        frames_per_action: number of states during the commanded motion (0.5 s by default). While the world comes to
            rest, further states follow at the same rate.

    Attributes:
        model: as given.

    Raises:
        ConfigError: ``frames_per_action`` is not positive.
    """

    def __init__(self, model: TransitionModel, frames_per_action: int) -> None:
        if frames_per_action < 1:
            raise ConfigError(f"frames_per_action={frames_per_action}: a motion needs at least one frame, of its end")
        self.model = model
        self._frames = frames_per_action
        self._simulator = RecordingSimulator(model.scene, model.simulator.physics)

    def record(self, state: State, action: Action) -> list[State]:
        """The states during ``action``: the first is ``state``, the last is ``model.advance(state, action)``.

        Raises:
            ActionError, SceneError, SimulationError: as :meth:`TransitionModel.advance`.
        """
        self._simulator.advance(state, self.model.action_space.motion(action))
        recorded = self._simulator.recorded
        last = len(recorded) - 1
        count = max(self._frames, last * self._frames // self.model.simulator.physics.motion_steps)
        return [recorded[round(last * number / count)] for number in range(count + 1)]

    def record_episode(self, episode: Episode) -> list[list[State]]:
        """The states during each action of ``episode``, as :meth:`record`.

        Raises:
            ActionError, SceneError, SimulationError: as :meth:`TransitionModel.advance`.
            DataError: an action leads to another state here, so the episode happened in another world.
        """
        motions = []
        pairs = zip(episode.actions, episode.states[:-1], episode.states[1:], strict=True)
        for number, (action, state, expected) in enumerate(pairs, start=1):
            motions.append(self.record(state, action))
            if motions[-1][-1] != expected:
                raise DataError(
                    f"action {number} of {len(episode)} leads to another state in this model than in the episode; give "
                    "the model of the world in which the episode happened, with its scene and physics"
                )
        return motions
