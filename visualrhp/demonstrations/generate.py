"""Generation of demonstrations with the kinodynamic RRT (Sec. 6.1)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from visualrhp.demonstrations.shards import Arrays, pack
from visualrhp.planning.kinodynamic_rrt import KinodynamicRRT
from visualrhp.scene.sampling import SceneDistribution, sample_task_instance
from visualrhp.scene.scene import TaskInstance
from visualrhp.simulation.action_spaces import make_action_space
from visualrhp.simulation.physics import Physics
from visualrhp.simulation.transition_model import TransitionModel
from visualrhp.streams import Split, Stream, generator_for
from visualrhp.types import ActionSpaceName, Episode


@dataclass(frozen=True, slots=True)
class Attempt:
    """Result of the planner on one task instance: a demonstration, or a failure.

    Attributes:
        index: index of the task instance.
        task: the task instance.
        episode: the demonstration, or None if the planner found no plan within its budget.
        num_simulated: actions simulated by the search.
        num_nodes: nodes of the search tree.
        search_time_s: wall-clock time of the search [s]; not part of a stored set, because it is not reproducible.
    """

    index: int
    task: TaskInstance
    episode: Episode | None
    num_simulated: int
    num_nodes: int
    search_time_s: float


def generate_demonstration(
    distribution: SceneDistribution,
    action_space: ActionSpaceName,
    planner: KinodynamicRRT,
    seed: int,
    index: int,
    physics: Physics | None = None,
    split: Split = Split.DEMONSTRATIONS,
) -> Attempt:
    """Plan task instance ``index`` of ``split`` with the kinodynamic RRT: a function of the arguments only.

    This holds unless ``planner`` reaches a time limit.
    """
    task = sample_task_instance(distribution, seed, split, index)
    model = TransitionModel(task.scene, make_action_space(action_space), physics or Physics())
    started = time.perf_counter()
    found = planner.search(model, task.state, generator_for(seed, split, index, Stream.PLANNER))
    elapsed = time.perf_counter() - started
    return Attempt(index, task, found.episode, found.num_simulated, found.num_nodes, elapsed)


def generate_block(
    indices: Sequence[int],
    distribution: SceneDistribution,
    action_space: ActionSpaceName,
    planner: KinodynamicRRT,
    seed: int,
    physics: Physics | None = None,
) -> Arrays:
    """Attempt the task instances ``indices`` one after another: a unit of parallel work with small arguments.

    Returns:
        The packed attempts (see :func:`pack`), and ``search_time_s`` [D], which is not part of a stored set.
    """
    attempts = [generate_demonstration(distribution, action_space, planner, seed, index, physics) for index in indices]
    times = np.array([attempt.search_time_s for attempt in attempts])
    return {**pack(attempts, action_space), "search_time_s": times}
