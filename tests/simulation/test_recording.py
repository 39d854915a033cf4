"""A recorded motion is exactly the simulated one, and bodies do not pass through each other in it."""

from __future__ import annotations

import numpy as np
import pytest

from tests.simulation.soak import overlap
from visualrhp.errors import ConfigError, DataError
from visualrhp.scene import NOISE_LEVELS, SceneDistribution, geometry, sample_task_instance
from visualrhp.simulation import ContinuousActionSpace, Physics, TransitionModel
from visualrhp.simulation.action_spaces import MAX_ROTATION
from visualrhp.simulation.physics import LONGEST_MOTION
from visualrhp.simulation.recording import MotionRecorder, RecordingSimulator
from visualrhp.streams import Split
from visualrhp.types import Column, Episode, State, wrap_angle


def pushes(model: TransitionModel, state: State, count: int, rng: np.random.Generator) -> Episode:
    """An episode of actions towards random objects."""
    states, actions = [state], []
    while len(actions) < count:
        away = state.object_positions[rng.integers(state.num_objects)] - state.gripper_position
        x, y, theta = *away.tolist(), state.gripper_pose[2]
        forward, left = x * np.cos(theta) + y * np.sin(theta), y * np.cos(theta) - x * np.sin(theta)
        actions.append(np.clip([10.0 * forward, 10.0 * left, *rng.uniform(-1.0, 1.0, 2)], -1.0, 1.0))
        state = model.advance(state, actions[-1])
        states.append(state)
    return Episode(tuple(states), tuple(actions), (-1.0,) * count, None)


def world(index: int, num_objects: int = 6) -> tuple[TransitionModel, State]:
    task = sample_task_instance(SceneDistribution(num_objects=num_objects), 0, Split.TUNING, index)
    return TransitionModel(task.scene, ContinuousActionSpace()), task.state


@pytest.mark.parametrize("index", range(4))
def test_a_motion_is_recorded_without_a_change_of_a_bit(index: int) -> None:
    model, state = world(index)
    episode = pushes(model, state, 6, np.random.default_rng(index))
    motions = MotionRecorder(model, 10).record_episode(episode)
    for motion, start, end in zip(motions, episode.states[:-1], episode.states[1:], strict=True):
        assert motion[0] == start and motion[-1] == end
        assert len(motion) >= 1 + 10
    again = MotionRecorder(model, 10)
    for number in (3, 0, 5):  # whatever was recorded before
        assert again.record(episode.states[number], episode.actions[number]) == motions[number]


def test_the_states_are_those_of_every_time_step() -> None:
    """The palm moves with a constant velocity for 50 steps of 0.01 s, then rests."""
    model, state = world(0)
    simulator = RecordingSimulator(model.scene, Physics())
    end = simulator.advance(state, model.action_space.motion(np.array([1.0, -0.5, 0.4, -1.0])))
    recorded = simulator.recorded
    assert recorded[0] == state and recorded[-1] == end
    expected = geometry.to_world(np.outer(np.arange(51) / 50, [0.1, -0.05]), state.gripper_pose)
    assert np.array([one.gripper_position for one in recorded[:51]]) == pytest.approx(expected, abs=1e-9)
    assert all(one.gripper_position == pytest.approx(end.gripper_position, abs=1e-9) for one in recorded[50:])


def test_states_are_equally_spaced_in_time_until_the_world_is_at_rest() -> None:
    model, state = world(0)
    motion = MotionRecorder(model, 5).record(state, np.array([1.0, 0.0, 0.0, -1.0]))
    ahead = np.array([one.gripper_position for one in motion]) - state.gripper_position
    distances = np.hypot(*ahead.T)
    assert distances[1:5] == pytest.approx(np.arange(1, 5) * distances[1], rel=0.15)
    assert distances[-1] == pytest.approx(0.1)
    assert len(MotionRecorder(model, 1).record(state, np.zeros(4))) == 2


def interpolated(start: State, end: State, share: float) -> State:
    """What a film would show that knows only the states at rest."""
    difference = end.vector - start.vector
    for angles in (Column.GRIPPER_THETA, Column.OBJECTS_THETA):
        difference[angles] = wrap_angle(difference[angles])
    return State(start.vector + share * difference)


def test_bodies_overlap_by_no_more_than_the_gripper_moves_in_a_step_while_interpolated_ones_pass() -> None:
    """A contact is found when the bodies are in each other already; from then on the solver pushes them apart."""
    physics = Physics()
    deep = deep_interpolated = 0
    for index in range(4):
        model, state = world(index)
        corners = np.concatenate(model.scene.gripper.outlines((0.0, 0.0, 0.0), model.scene.gripper.stroke))
        reach = LONGEST_MOTION + MAX_ROTATION * np.hypot(*corners.T).max()
        depth = physics.contact_slop + reach / physics.motion_steps  # 6 mm
        episode = pushes(model, state, 6, np.random.default_rng(index))
        recorder = MotionRecorder(model, 8)
        for motion in recorder.record_episode(episode):
            for number, shown in enumerate(motion):
                deep += overlap(model.scene, shown, depth)
                between = interpolated(motion[0], motion[-1], number / (len(motion) - 1))
                deep_interpolated += overlap(model.scene, between, depth)
    assert deep == 0
    assert deep_interpolated >= 5


def test_another_world_and_a_film_without_pictures_are_refused() -> None:
    model, state = world(1)
    episode = pushes(model, state, 4, np.random.default_rng(1))
    other = model.perturbed(NOISE_LEVELS["high"], 0.0, np.random.default_rng(0))
    with pytest.raises(DataError, match=r"action \d of 4 leads to another state"):
        MotionRecorder(other, 3).record_episode(episode)
    with pytest.raises(ConfigError, match="frames_per_action=0"):
        MotionRecorder(model, 0)
