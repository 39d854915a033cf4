"""Demonstrations of random actions without physics, for the tests of imitation."""

from __future__ import annotations

import numpy as np

from visualrhp.learning.imitation_data import ImitationData
from visualrhp.observation import Observation, make_observation
from visualrhp.scene.sampling import SceneDistribution, sample_task_instance
from visualrhp.scene.scene import TaskInstance
from visualrhp.simulation.action_spaces import make_action_space
from visualrhp.streams import Split
from visualrhp.types import Action, Column, Episode, Outcome, State

CARTESIAN = make_observation("cartesian", 2)
IMAGE = make_observation("image")


def demonstration(index: int, length: int, action_space: str = "discrete") -> tuple[TaskInstance, Episode]:
    """A demonstration of random actions; only the gripper moves, at random."""
    task = sample_task_instance(SceneDistribution(num_objects=(2, 2)), 0, Split.TUNING, index)
    rng = np.random.default_rng(index)
    space = make_action_space(action_space)  # pyright: ignore[reportArgumentType]
    states = [task.state]
    for _ in range(length):
        vector = task.state.vector.copy()
        vector[Column.GRIPPER_POSE] += rng.uniform(-0.05, 0.05, 3)
        vector[Column.CLOSED] = rng.integers(2)
        states.append(State(vector))
    actions: list[Action] = [space.sample(rng) for _ in range(length)]
    return task, Episode(tuple(states), tuple(actions), (-1.0,) * length, Outcome.SUCCESS)


def data_of(action_space: str, observe: Observation, count: int = 6) -> ImitationData:
    return ImitationData.from_demonstrations([demonstration(i, 3 + i, action_space) for i in range(count)], observe)
