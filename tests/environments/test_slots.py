"""The slots of a batched environment: their arrays in one block of memory, and the episodes behind them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from visualrhp.environments.slots import SlotArrays, Slots, TaskFamily
from visualrhp.execution.world import SimulatedWorld
from visualrhp.observation import make_observation
from visualrhp.scene.sampling import SceneDistribution, sample_task_instance
from visualrhp.simulation import Physics, TransitionModel, make_action_space
from visualrhp.streams import Split
from visualrhp.types import ActionSpaceName, Outcome

NUM_SLOTS = 5


def family_of(action_space: ActionSpaceName) -> TaskFamily:
    distribution = SceneDistribution(num_objects=(1, 3))
    return TaskFamily(distribution, Split.REINFORCEMENT, action_space, make_observation("image"))


def arrays_of(family: TaskFamily) -> SlotArrays:
    return SlotArrays.over(family, NUM_SLOTS, bytearray(SlotArrays.num_bytes(family, NUM_SLOTS)))


@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_arrays_share_the_memory_and_do_not_overlap(action_space: ActionSpaceName) -> None:
    family = family_of(action_space)
    memory = bytearray(SlotArrays.num_bytes(family, NUM_SLOTS))
    arrays, others = (vars(SlotArrays.over(family, NUM_SLOTS, memory)) for _ in range(2))
    spans = []
    for name, array in arrays.items():
        assert len(array) == NUM_SLOTS and not array.any(), name
        start = array.__array_interface__["data"][0]
        spans.append((start, start + array.nbytes))
        array[...] = 1
        np.testing.assert_array_equal(others[name], array)
    spans.sort()
    assert all(stop <= start for (_, stop), (start, _) in itertools.pairwise(spans))
    assert all(start % 64 == spans[0][0] % 64 for start, _ in spans)
    assert arrays["action"].shape == ((NUM_SLOTS,) if action_space == "discrete" else (NUM_SLOTS, 4))
    assert arrays["state"].shape == (NUM_SLOTS, 5 + 3 * 3)


def test_a_share_writes_only_its_rows_and_equals_the_whole() -> None:
    family = family_of("discrete")
    whole, shared = arrays_of(family), arrays_of(family)
    everything = Slots(family, whole, range(NUM_SLOTS))
    everything.start(4, range(NUM_SLOTS), range(10, 10 + NUM_SLOTS))
    share = Slots(family, shared, range(2, 4))
    share.start(4, [2, 3], [12, 13])
    for arrays in (whole, shared):
        arrays.is_active[:] = True
        arrays.action[:] = [0, 4, 2, 6, 1]
    everything.act()
    share.act()
    for name, array in vars(whole).items():
        if name not in ("action", "is_active"):
            np.testing.assert_array_equal(vars(shared)[name][2:4], array[2:4], err_msg=name)
            assert not vars(shared)[name][[0, 1, 4]].any(), name


def test_the_rows_are_the_episodes() -> None:
    family = family_of("discrete")
    arrays = arrays_of(family)
    slots = Slots(family, arrays, range(NUM_SLOTS))
    slots.start(0, range(NUM_SLOTS), range(NUM_SLOTS))
    arrays.is_active[:] = [True, False, True, True, False]
    arrays.action[:] = 0
    slots.act()
    assert arrays.num_actions.tolist() == [1, 0, 1, 1, 0]
    for slot, episode in enumerate(slots.episodes):
        assert arrays.state_of(slot) == episode.state
        assert arrays.num_objects[slot] == episode.scene.num_objects
        np.testing.assert_array_equal(arrays.observation[slot], family.observe(episode.scene, episode.state))
        padding = arrays.state[slot, episode.state.vector.size :]
        assert not padding.any()
        assert (arrays.reward[slot] != 0.0) == bool(arrays.num_actions[slot])
    world = slots.episodes[0].world
    assert isinstance(world, SimulatedWorld)
    instance = family.instance(0, 0)
    assert world.model.simulate(instance.state, 0).next_state == arrays.state_of(0)


def test_resumed_slots_continue_bit_exactly() -> None:
    family = family_of("discrete")
    arrays, again = arrays_of(family), arrays_of(family)
    slots, resumed = (Slots(family, block, range(NUM_SLOTS)) for block in (arrays, again))
    slots.start(7, range(NUM_SLOTS), range(NUM_SLOTS))
    for block in (arrays, again):
        block.is_active[:] = True
        block.action[:] = [0, 1, 2, 3, 4]
    slots.act()
    resumed.resume(7, arrays.instance.tolist(), arrays.num_actions.tolist(), arrays.state.copy())
    assert [episode.num_actions for episode in resumed.episodes] == [1] * NUM_SLOTS
    slots.act()
    resumed.act()
    assert [again.state_of(slot) for slot in range(NUM_SLOTS)] == [episode.state for episode in slots.episodes]
    np.testing.assert_array_equal(again.num_actions, arrays.num_actions)


def test_tasks_are_those_of_the_split_with_the_physics_of_the_family() -> None:
    physics = Physics(motion_steps=20)
    observe = make_observation("image")
    family = TaskFamily(SceneDistribution(num_objects=(1, 3)), Split.TUNING, "discrete", observe, physics)
    instance = sample_task_instance(family.distribution, 4, Split.TUNING, 9)
    episode = family.start(family.instance(4, 9))
    assert episode.state == instance.state
    episode.act(0)
    slow, usual = (
        TransitionModel(instance.scene, make_action_space("discrete"), value).simulate(instance.state, 0).next_state
        for value in (physics, Physics())
    )
    assert episode.state == slow != usual


def test_flags_tell_how_an_episode_ended_until_the_next_one_begins() -> None:
    """Always forward, instances 0 to 4 of seed 0 end in every way: success, drop, action limit."""
    family = family_of("discrete")
    arrays = arrays_of(family)
    slots = Slots(family, arrays, range(NUM_SLOTS))
    slots.start(0, range(NUM_SLOTS), range(NUM_SLOTS))
    arrays.is_active[:] = True
    while arrays.is_active.any():
        slots.act()
        arrays.is_active[:] = [episode.outcome is None for episode in slots.episodes]
    outcomes = [episode.outcome for episode in slots.episodes]
    assert set(outcomes) == {Outcome.SUCCESS, Outcome.DROPPED, Outcome.OUT_OF_ACTIONS}
    assert arrays.is_goal.tolist() == [outcome is Outcome.SUCCESS for outcome in outcomes]
    assert arrays.is_dropped.tolist() == [outcome is Outcome.DROPPED for outcome in outcomes]
    assert arrays.truncated.tolist() == [outcome is Outcome.OUT_OF_ACTIONS for outcome in outcomes]
    np.testing.assert_array_equal(arrays.terminated, ~arrays.truncated)
    np.testing.assert_array_equal(arrays.reward, np.where(arrays.is_dropped, -50.0, -1.0))
    assert arrays.num_actions.tolist() == [episode.num_actions for episode in slots.episodes]
    slots.start(0, range(NUM_SLOTS), range(NUM_SLOTS))
    for name in ("terminated", "truncated", "is_goal", "is_dropped", "num_actions", "reward"):
        assert not vars(arrays)[name].any(), name


def test_an_inactive_share_and_an_empty_start_change_nothing() -> None:
    family = family_of("discrete")
    arrays = arrays_of(family)
    share = Slots(family, arrays, range(2, 4))
    share.start(1, [2, 3], [5, 6])
    before = {name: array.copy() for name, array in vars(arrays).items()}
    share.act()
    share.start(1, [], [])
    for name, array in vars(arrays).items():
        np.testing.assert_array_equal(array, before[name], err_msg=name)
    arrays.is_active[3] = True
    share.act()
    assert arrays.num_actions.tolist() == [0, 0, 0, 1, 0]
    assert [episode.num_actions for episode in share.episodes] == [0, 1]


def test_a_resumed_share_has_its_own_instances() -> None:
    family = family_of("discrete")
    whole, shared = arrays_of(family), arrays_of(family)
    instances = [10, 11, 12, 13, 14]
    Slots(family, whole, range(NUM_SLOTS)).start(4, range(NUM_SLOTS), instances)
    Slots(family, shared, range(2, 4)).resume(4, instances, [0, 0, 3, 1, 0], whole.state)
    assert shared.instance.tolist() == [0, 0, 12, 13, 0]
    assert shared.num_actions.tolist() == [0, 0, 3, 1, 0]
    np.testing.assert_array_equal(shared.observation[2:4], whole.observation[2:4])


def test_an_episode_keeps_its_actions_when_the_next_ones_are_written() -> None:
    family = family_of("continuous")
    arrays = arrays_of(family)
    slots = Slots(family, arrays, range(NUM_SLOTS))
    slots.start(0, range(NUM_SLOTS), range(NUM_SLOTS))
    arrays.is_active[:] = True
    for forward in (0.5, -0.5):
        arrays.action[:] = [forward, 0.0, 0.0, 1.0]
        slots.act()
        assert [episode.state.gripper_closed for episode in slots.episodes] == arrays.gripper_closed.tolist()
    for episode in slots.episodes:
        np.testing.assert_array_equal(episode.episode.actions, [[0.5, 0.0, 0.0, 1.0], [-0.5, 0.0, 0.0, 1.0]])


def test_the_commanded_gripper_state_is_shown() -> None:
    family = family_of("discrete")
    arrays = arrays_of(family)
    slots = Slots(family, arrays, range(NUM_SLOTS))
    slots.start(0, range(NUM_SLOTS), range(NUM_SLOTS))
    assert not arrays.gripper_closed.any()
    arrays.is_active[:] = True
    arrays.action[:] = [6, 7, 6, 0, 6]  # close, open, close, forward, close
    slots.act()
    assert arrays.gripper_closed.tolist() == [True, False, True, False, True]
