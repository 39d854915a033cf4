"""Snapshots: what they hold, and that others, or damaged ones, are refused before anything changes."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest
import torch

from tests.environments.rollouts import FEW, random_policy, run
from visualrhp.environments.batched import BatchedClutterEnv
from visualrhp.environments.snapshots import checked_states
from visualrhp.errors import CheckpointError, ConfigError
from visualrhp.scene.sampling import SceneDistribution
from visualrhp.simulation.physics import Physics
from visualrhp.streams import Split

OPEN = 7


def make(**arguments: Any) -> BatchedClutterEnv:
    defaults = {"distribution": FEW, "action_space": "discrete", "num_envs": 3, "seed": 1, "num_workers": 0}
    return BatchedClutterEnv(**defaults | arguments)


@pytest.fixture
def snapshot() -> dict[str, torch.Tensor]:
    env = make()
    run(env, random_policy(0, env), 5)
    return env.snapshot()


OTHERS = [
    ({"seed": 99}, r"seed=1, and this one has 99"),
    ({"seed": 2**80}, r"seed=1, and"),
    ({"split": Split.EVALUATION}, r"split=1, and this one has 3"),
    ({"action_space": "continuous"}, r"action_space='discrete', and this one has 'continuous'"),
    ({"distribution": SceneDistribution((3, 3))}, r"distribution.num_objects=\[1, 3\], and this one has \[3, 3\]"),
    ({"distribution": SceneDistribution((1, 3), friction=0.4)}, r"distribution.friction=0.3, and this one has 0.4"),
    ({"physics": Physics(gravity=9.0)}, r"physics.gravity=9.81, and this one has 9.0"),
    ({"num_envs": 2}, r"another number of environments"),
    ({"distribution": SceneDistribution((1, 4))}, r"another number of environments or objects"),
]


@pytest.mark.parametrize(("arguments", "message"), OTHERS, ids=str)
def test_a_snapshot_of_another_environment_is_refused(
    snapshot: dict[str, torch.Tensor], arguments: dict[str, Any], message: str
) -> None:
    env = make(**arguments)
    with pytest.raises(CheckpointError, match=message):
        env.restore(snapshot)
    assert env.backend is None  # nothing has changed
    env.reset()
    states, instances = env.states, env.instances
    with pytest.raises(CheckpointError, match=message):
        env.restore(snapshot)
    assert env.states == states and env.instances == instances
    env.reset()
    assert env.instances == [index + env.num_envs for index in instances]


def test_observations_are_a_part_of_the_arguments() -> None:
    fixed = SceneDistribution(num_objects=(3, 3))
    images, features = (make(distribution=fixed, observation=name) for name in ("image", "cartesian"))
    images.reset()
    with pytest.raises(CheckpointError, match="observation='image observations"):
        features.restore(images.snapshot())


def text(content: str) -> torch.Tensor:
    return torch.from_numpy(np.frombuffer(content.encode(), np.uint8).copy())


@pytest.mark.parametrize("key", ["state", "instance", "num_actions", "next_index", "ended", "arguments"])
@pytest.mark.parametrize(
    "value", ["missing", None, 3, torch.zeros(()), torch.zeros(7, 7), torch.ones(3, dtype=torch.bool)]
)
def test_a_damaged_entry_is_refused(snapshot: dict[str, torch.Tensor], key: str, value: Any) -> None:
    damaged = {**snapshot, key: value}
    if isinstance(value, str):
        del damaged[key]
    with pytest.raises(CheckpointError, match=r"damaged|another number"):
        make().restore(damaged)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("instance", torch.tensor([-1, 0, 1])),
        ("next_index", torch.tensor([3, 4, -5])),
        ("num_actions", torch.tensor([0, -1, 0])),
        ("instance", torch.tensor([0.0, 1.0, 2.0])),
        ("ended", torch.tensor([0, 9, 0])),
        ("state", torch.full((3, 14), torch.nan, dtype=torch.float64)),
        ("state", torch.full((3, 14), 0.5, dtype=torch.float64)),
        ("arguments", text("no JSON")),
        ("arguments", text("[]")),
        ("arguments", text('{"seeds": ["x"]}')),
        ("arguments", text('{"seeds": []}')),
    ],
)
def test_impossible_content_is_refused(snapshot: dict[str, torch.Tensor], key: str, value: torch.Tensor) -> None:
    with pytest.raises(CheckpointError, match="snapshot"):
        make().restore({**snapshot, key: value})


@pytest.mark.parametrize("content", [None, "abc", [], 3], ids=repr)
def test_what_is_no_snapshot_is_refused(content: Any) -> None:
    with pytest.raises(CheckpointError, match="dictionary of tensors"):
        make().restore(content)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["copy", "pickle"])
def test_a_new_seed_does_not_change_the_running_episodes(copied: Any) -> None:
    """Tasks of two seeds at once: a snapshot and a copy know which is which."""
    env = make()
    _, current = run(env, random_policy(0, env), 3)
    env.set_seed(2**70)
    current = env.reset(current.set("_reset", torch.tensor([[True], [False], [False]])))
    twin, other = copied(env), make(seed=2**70)
    other.restore(env.snapshot())
    expected, _ = run(env, random_policy(1, env), 60, current.clone())
    for found in (run(each, random_policy(1, each), 60, each.current())[0] for each in (twin, other)):
        assert (expected == found).all()
    assert expected["next", "done"].any()
    assert env.scenes == twin.scenes == other.scenes


def test_ends_of_episodes_are_kept() -> None:
    env = make()
    run(env, lambda td: td.set("action", torch.full((3,), OPEN)), 48)
    last = env.step(env.current().set("action", torch.full((3,), OPEN)))["next"]
    assert last["truncated"].all()
    restored = make().restore(env.snapshot())
    for key in ("done", "terminated", "truncated", "is_goal", "is_dropped", "state", "observation"):
        assert torch.equal(restored[key], last[key]), key


def test_states_are_checked_before_they_are_recalled() -> None:
    indices, rows = checked_states(torch.tensor([0, 5]), torch.zeros(2, 8, dtype=torch.float64, requires_grad=True), 8)
    assert indices == [0, 5] and rows.shape == (2, 8)
    good = torch.zeros(2, 8, dtype=torch.float64)
    for instances, states in [
        (torch.tensor([0]), good),
        (torch.tensor([0, -1]), good),
        (torch.tensor([0.0, 1.0]), good),
        (torch.tensor([[0], [1]]), good),
        (torch.tensor([0, 1]), good[:, :5]),
        (torch.tensor([0, 1]), good.float()),
        (torch.tensor([0, 1]), good / 0.0),
        ([0, 1], good),
        (torch.tensor([0, 1]), None),
    ]:
        with pytest.raises(ConfigError, match=r"\[K\] int64 and 0 or more") as caught:
            checked_states(instances, states, 8)
        assert len(str(caught.value)) < 500
