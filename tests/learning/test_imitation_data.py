"""State-action pairs of demonstrations: their order, targets, storage, and mirror images."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.learning.motionless import CARTESIAN, IMAGE, data_of, demonstration
from visualrhp.errors import DataError
from visualrhp.learning.imitation_data import ImitationData
from visualrhp.observation import Observation
from visualrhp.simulation.action_spaces import make_action_space


def test_returns_are_eq_4() -> None:
    """Three actions of reward -1: -1 - g - g^2, -1 - g, -1."""
    data = ImitationData.from_demonstrations([demonstration(0, 3)], CARTESIAN, discount=0.9)
    np.testing.assert_allclose(data.returns.numpy(), [-2.71, -1.9, -1.0], rtol=1e-6)
    assert data.steps_to_go.tolist() == [3, 2, 1]


def test_pairs_are_states_with_their_actions() -> None:
    pairs = [demonstration(i, 3 + i) for i in range(2)]
    data = ImitationData.from_demonstrations(pairs, IMAGE)
    assert len(data) == 7
    assert data.demonstration.tolist() == [0, 0, 0, 1, 1, 1, 1]
    task, episode = pairs[1]
    batch = data[torch.tensor([4, 0])]
    np.testing.assert_array_equal(batch.observation[0], IMAGE(task.scene, episode.states[1]))
    assert batch.action[0].item() == episode.actions[1]
    assert batch.gripper_closed[0].item() == episode.states[1].gripper_closed
    assert batch.observation.dtype is torch.uint8
    assert batch.steps_to_go.tolist() == [3, 3]
    assert batch.action.dtype is batch.steps_to_go.dtype is torch.int64
    closed = [state.gripper_closed for _, episode in pairs for state in episode.states[:-1]]
    assert data.gripper_closed.tolist() == closed


def test_label_images_are_kept_packed() -> None:
    """Less than a fifth of the bytes, so that a million pairs train in little memory."""
    data = data_of("discrete", IMAGE, count=20)
    assert data.observations.nbytes < 0.2 * len(data) * 64 * 64


def test_no_demonstrations_are_an_error() -> None:
    with pytest.raises(DataError, match="no demonstrations"):
        ImitationData.from_demonstrations([], IMAGE)


def test_whole_demonstrations_are_held_out() -> None:
    data = data_of("discrete", CARTESIAN, count=10)
    training, held_out = data.split(0.3, torch.Generator().manual_seed(0))
    assert len(torch.unique(data.demonstration[held_out])) == 3
    assert not set(data.demonstration[training].tolist()) & set(data.demonstration[held_out].tolist())
    assert sorted([*training.tolist(), *held_out.tolist()]) == list(range(len(data)))


@pytest.mark.parametrize("observe", [IMAGE, CARTESIAN], ids=["image", "cartesian"])
@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_mirrored_pairs_are_those_of_the_mirrored_scene(action_space: str, observe: Observation) -> None:
    pairs = data_of(action_space, observe)
    every = torch.arange(len(pairs))
    plain, rows = pairs[every], every % 2 == 0
    mirrored = pairs.batch(every, rows)
    assert torch.equal(mirrored.observation[~rows], plain.observation[~rows])
    assert torch.equal(mirrored.action[~rows], plain.action[~rows])
    expected = observe.mirror(plain.observation[rows].numpy())
    np.testing.assert_array_equal(mirrored.observation[rows].numpy(), expected)
    assert not torch.equal(mirrored.observation[rows], plain.observation[rows])
    space = make_action_space(action_space)  # pyright: ignore[reportArgumentType]
    actions = [space.mirror(a if a.ndim else int(a)) for a in plain.action[rows].numpy()]
    np.testing.assert_allclose(mirrored.action[rows].numpy(), np.array(actions), rtol=1e-6)


@pytest.mark.parametrize("observe", [IMAGE, CARTESIAN], ids=["image", "cartesian"])
@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_resident_pairs_are_the_same(action_space: str, observe: Observation) -> None:
    """On the CPU, too, where nothing but the test asks for it."""
    pairs = data_of(action_space, observe)
    resident = pairs.resident(torch.device("cpu"))
    assert resident.unpacked is not None and len(resident) == len(pairs)
    rows = torch.tensor([3, 0, 5])
    for mirror in (None, torch.tensor([True, False, True])):
        for one, other in zip(
            vars(pairs.batch(rows, mirror)).values(), vars(resident.batch(rows, mirror)).values(), strict=True
        ):
            assert (one is None and other is None) or torch.equal(one, other)
    seeds = (torch.Generator().manual_seed(0), torch.Generator().manual_seed(0))
    for one, other in zip(pairs.split(0.3, seeds[0]), resident.split(0.3, seeds[1]), strict=True):
        assert torch.equal(one, other)


def test_the_held_out_demonstrations_depend_on_the_generator() -> None:
    data = data_of("discrete", CARTESIAN, count=10)

    def held_out(seed: int, fraction: float = 0.3) -> list[int]:
        _, rows = data.split(fraction, torch.Generator().manual_seed(seed))
        return torch.unique(data.demonstration[rows]).tolist()

    assert held_out(0) == held_out(0)
    assert len({tuple(held_out(seed)) for seed in range(5)}) > 1
    assert [len(held_out(0, fraction)) for fraction in (0.0, 0.04, 0.28, 0.5)] == [0, 0, 3, 5]  # rounded


def test_continuous_actions_are_stored_as_the_network_reads_them() -> None:
    _, episode = demonstration(0, 3, "continuous")
    data = ImitationData.from_demonstrations([demonstration(0, 3, "continuous")], CARTESIAN)
    assert data.action.dtype is data.returns.dtype is torch.float32
    np.testing.assert_array_equal(data.action.numpy(), np.array(episode.actions, dtype=np.float32))
