"""How well a heuristic does when followed greedily, measured between iterations of a training (Fig. 5 and 6)."""

from __future__ import annotations

from visualrhp.environments.task import ClutterTask, Outcome
from visualrhp.errors import ConfigError
from visualrhp.heuristics.heuristic import Heuristic
from visualrhp.scene.sampling import SceneDistribution, Split
from visualrhp.simulation.action_spaces import make_action_space
from visualrhp.simulation.physics import Physics


class GreedyValidation:
    """Solves the same task instances with the mode of a heuristic's policy (the Greedy baseline of Sec. 7.5).

    All instances advance together, so that the network is called once an action.

    Args:
        distribution: of the task instances.
        num_instances: how many, the indices 0, 1, ... of the stream.
        seed: of the task instances.
        split: stream of the task instances.
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
        self._distribution = distribution
        self._num_instances = num_instances
        self._seed = seed
        self._split = split
        self._physics = physics

    def __call__(self, heuristic: Heuristic) -> dict[str, float]:
        """Measure ``heuristic``.

        Returns:
            ``success_rate`` and ``dropped_rate``, shares of the instances; ``action_efficiency``, mean number of
            objects over actions (Sec. 7.3), and ``num_actions``, mean, both over the solved instances (0 if none is).
        """
        tasks = [
            ClutterTask(self._distribution, make_action_space(heuristic.action_space), self._physics)
            for _ in range(self._num_instances)
        ]
        for index, task in enumerate(tasks):
            task.start(self._seed, self._split, index)
        running = tasks
        ended: list[tuple[ClutterTask, Outcome]] = []
        while running:
            guidance = heuristic.guide([task.instance.scene for task in running], [task.state for task in running])
            outcomes = [task.act(action) for task, action in zip(running, guidance.mode(), strict=True)]
            is_over = [outcome.terminated or outcome.truncated for outcome in outcomes]
            ended += [pair for pair, over in zip(zip(running, outcomes, strict=True), is_over, strict=True) if over]
            running = [task for task, over in zip(running, is_over, strict=True) if not over]
        solved = [task for task, outcome in ended if outcome.is_goal]
        efficiencies = [task.instance.scene.num_objects / task.num_actions for task in solved]
        return {
            "success_rate": len(solved) / len(tasks),
            "dropped_rate": sum(outcome.is_dropped for _, outcome in ended) / len(tasks),
            "action_efficiency": sum(efficiencies) / max(1, len(efficiencies)),
            "num_actions": sum(task.num_actions for task in solved) / max(1, len(solved)),
        }
