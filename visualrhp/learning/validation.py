"""Success of the greedy policy of a heuristic, measured between iterations of a training (Fig. 5 and 6)."""

from __future__ import annotations

from visualrhp.errors import ConfigError
from visualrhp.execution.episode import RunningEpisode
from visualrhp.execution.world import SimulatedWorld
from visualrhp.heuristics.heuristic import Heuristic
from visualrhp.scene.sampling import SceneDistribution, sample_task_instance
from visualrhp.simulation.action_spaces import make_action_space
from visualrhp.simulation.physics import Physics
from visualrhp.simulation.transition_model import TransitionModel
from visualrhp.streams import Split
from visualrhp.types import Metrics, Outcome


class GreedyValidation:
    """Solves the same task instances with the mode of a heuristic's policy (the Greedy baseline of Sec. 7.5).

    All instances advance together, so the network is called once per action.

    Args:
        distribution: of the task instances.
        num_instances: number of task instances, with the indices 0, 1, ... of the split.
        seed: of the task instances.
        split: split of the task instances.
        physics: of the simulation.

    Raises:
        ConfigError: ``num_instances`` is not positive.
    """

    def __init__(
        self,
        distribution: SceneDistribution,
        num_instances: int,
        seed: int,
        split: Split = Split.VALIDATION,
        physics: Physics | None = None,
    ) -> None:
        if num_instances < 1:
            raise ConfigError(f"num_instances={num_instances}: greedy validation needs at least one task instance")
        self._physics = physics
        # Sampled once: all evaluations of a training use the same instances.
        self._instances = [sample_task_instance(distribution, seed, split, index) for index in range(num_instances)]

    def __call__(self, heuristic: Heuristic) -> Metrics:
        """Evaluate ``heuristic``.

        Returns:
            ``success_rate`` and ``dropped_rate``, shares of the instances; ``action_efficiency``, mean number of
            objects over actions (Sec. 7.3), and ``num_actions``, mean, both over the solved instances (0 if there are
            none).
        """
        action_space = make_action_space(heuristic.action_space)
        episodes = [
            RunningEpisode(SimulatedWorld(instance, TransitionModel(instance.scene, action_space, self._physics)))
            for instance in self._instances
        ]
        running = episodes
        while running:
            guidance = heuristic.guide([episode.scene for episode in running], [episode.state for episode in running])
            for episode, action in zip(running, guidance.mode(), strict=True):
                episode.act(action)
            running = [episode for episode in running if episode.outcome is None]
        solved = [episode for episode in episodes if episode.outcome is Outcome.SUCCESS]
        efficiencies = [episode.scene.num_objects / episode.num_actions for episode in solved]
        dropped = sum(episode.outcome is Outcome.DROPPED for episode in episodes)
        return {
            "success_rate": len(solved) / len(episodes),
            "dropped_rate": dropped / len(episodes),
            "action_efficiency": sum(efficiencies) / max(1, len(efficiencies)),
            "num_actions": sum(episode.num_actions for episode in solved) / max(1, len(solved)),
        }
