"""States, their columns, angles and episodes, by hand."""

from __future__ import annotations

import copy
import math
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from visualrhp.errors import SceneError
from visualrhp.types import Column, Episode, Outcome, State, Transition, state_dimension, wrap_angle

STATE = State.create([1, 2, 3], 4, True, [[5, 6, 7], [8, 9, 10], [11, 12, 13]])


def test_the_columns_are_the_parts_of_a_state() -> None:
    vector = STATE.vector
    assert vector.tolist() == [1, 2, 3, 4, 1, 5, 6, 7, 8, 9, 10, 11, 12, 13]
    assert vector.size == state_dimension(STATE.num_objects) == 14
    x, y, theta = STATE.gripper_pose
    assert (vector[Column.GRIPPER_X], vector[Column.GRIPPER_Y], vector[Column.GRIPPER_THETA]) == (x, y, theta)
    assert vector[Column.GRIPPER_POSITION].tolist() == [1, 2]
    assert (vector[Column.OPENING], vector[Column.CLOSED]) == (STATE.gripper_opening, STATE.gripper_closed)
    poses = STATE.object_poses
    assert [vector[Column.DESIRED_X], vector[Column.DESIRED_Y]] == vector[Column.DESIRED_POSITION].tolist() == [5, 6]
    for column, entries in enumerate((Column.OBJECTS_X, Column.OBJECTS_Y, Column.OBJECTS_THETA)):
        np.testing.assert_array_equal(vector[entries], poses[:, column])
    np.testing.assert_array_equal(vector[Column.OBSTACLES_X], poses[1:, 0])
    np.testing.assert_array_equal(vector[Column.OBSTACLES_Y], poses[1:, 1])
    np.testing.assert_array_equal(vector[Column.OBJECTS], poses.ravel())


@pytest.mark.parametrize("shape", [(5,), (7,), (9,), (2, 8), ()])
def test_other_shapes_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(SceneError, match=r"\[5 \+ 3 m\]"):
        State(np.zeros(shape))


def test_states_are_finite_read_only_and_compared_bit_for_bit() -> None:
    with pytest.raises(SceneError, match="finite"):
        State.create([0, 0, math.nan], 0.05, False, [[0, 0, 0]])
    with pytest.raises(ValueError, match="read-only"):
        STATE.vector[0] = 0.0
    same = State(STATE.vector.copy())
    assert same == STATE and hash(same) == hash(STATE)
    vector = STATE.vector.copy()
    vector[0] = np.nextafter(vector[0], 2.0)
    assert State(vector) != STATE
    assert State(np.zeros(8)) != State(-np.zeros(8))  # signs of zeros are bits, too
    vector[1] = 99.0  # a state holds a copy
    assert State(vector) != STATE and same == STATE
    assert all(other != STATE for other in (STATE.vector.tolist(), 0, None))


@given(st.floats(-1e3, 1e3))
def test_a_wrapped_angle_points_in_the_same_direction(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -math.pi <= wrapped < math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-9)
    assert wrap_angle(wrapped) == wrapped


def test_angles_at_the_ends_of_the_range() -> None:
    assert wrap_angle(math.pi) == -math.pi
    assert wrap_angle(-math.pi) == -math.pi
    np.testing.assert_allclose(wrap_angle(np.array([1.5 * math.pi, -1.5 * math.pi])), [-0.5 * math.pi, 0.5 * math.pi])


def test_transitions_are_joined_to_an_episode() -> None:
    states = [State(np.full(8, float(number))) for number in range(3)]

    def transition(number: int, is_goal: bool = False, is_dropped: bool = False) -> Transition:
        reward = -50.0 if is_dropped else -1.0
        return Transition(states[number], number, reward, states[number + 1], is_goal, is_dropped)

    running = Episode.from_transitions([transition(0), transition(1)])
    assert (running.states, running.actions, running.rewards) == (tuple(states), (0, 1), (-1.0, -1.0))
    assert running.outcome is None and len(running) == 2
    solved = Episode.from_transitions([transition(0), transition(1, is_goal=True)])
    assert solved.outcome is Outcome.SUCCESS and solved.is_goal and not solved.is_dropped
    dropped = Episode.from_transitions([transition(0, is_dropped=True)])
    assert dropped.outcome is Outcome.DROPPED and dropped.is_dropped and dropped.rewards == (-50.0,)
    both = transition(0, is_goal=True, is_dropped=True)
    assert Episode.from_transitions([both]).outcome is Outcome.DROPPED  # a drop takes precedence
    kinds = [transition(0), transition(0, is_goal=True), transition(0, is_dropped=True), both]
    assert [kind.is_terminal for kind in kinds] == [False, True, True, True]


def test_only_a_goal_and_a_drop_are_terminal() -> None:
    """The return after any other end is not zero: the episode was truncated."""
    assert {outcome for outcome in Outcome if outcome.is_terminal} == {Outcome.SUCCESS, Outcome.DROPPED}


def test_unpickled_and_copied_states_are_read_only_and_the_same() -> None:
    copies = [pickle.loads(pickle.dumps(STATE, protocol)) for protocol in range(pickle.HIGHEST_PROTOCOL + 1)]
    copies += [copy.deepcopy(STATE), copy.copy(STATE), copy.deepcopy([STATE])[0]]
    for state in copies:
        assert state == STATE and hash(state) == hash(STATE)
        assert not state.vector.flags.writeable and state.vector.dtype == np.float64
        with pytest.raises(ValueError, match="read-only"):
            state.object_poses[0, 0] = 0.0


@pytest.mark.parametrize(
    "vector",
    [
        "abcdefgh",
        list("12345678"),
        [[1.0, 2.0], [3.0]],
        np.full(8, 1j),
        np.ones(8, dtype=bool),
        np.full(8, "2020-01-01", "datetime64[D]"),
        [None] * 8,
        {"x": 1},
    ],
    ids=repr,
)
def test_states_are_of_real_numbers(vector: object) -> None:
    with pytest.raises(SceneError, match="real numbers"):
        State(vector)  # pyright: ignore[reportArgumentType]
    with pytest.raises(SceneError, match="real numbers"):
        State.create([0, 0, 0], 0.05, False, vector)  # pyright: ignore[reportArgumentType]


def test_integers_are_numbers_and_messages_are_short() -> None:
    assert State(list(range(8))) == State(np.arange(8.0)) == State(np.arange(8, dtype=">f4"))  # pyright: ignore[reportArgumentType]
    with pytest.raises(SceneError, match="entry 5 of its vector is nan") as caught:
        State.create([0, 0, 0], 0.05, False, np.full((1000, 3), np.nan))
    assert len(str(caught.value)) < 200
    with pytest.raises(SceneError, match="true or false"):
        State.create([0, 0, 0], 0.05, "closed", [[0, 0, 0]])  # pyright: ignore[reportArgumentType]
