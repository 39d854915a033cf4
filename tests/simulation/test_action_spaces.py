"""Both action spaces by hand (Sec. 7.1), and their mirror images."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from visualrhp.errors import ActionError, ConfigError
from visualrhp.simulation import ContinuousActionSpace, DiscreteActionSpace, GripperMotion, make_action_space

DISCRETE, CONTINUOUS = DiscreteActionSpace(), ContinuousActionSpace()


@pytest.mark.parametrize(
    ("action", "motion"),
    [
        (0, GripperMotion(forward=0.05)),
        (1, GripperMotion(forward=-0.05)),
        (2, GripperMotion(left=0.05)),
        (3, GripperMotion(left=-0.05)),
        (4, GripperMotion(rotation=math.pi / 6)),
        (5, GripperMotion(rotation=-math.pi / 6)),
        (6, GripperMotion(closed=True)),
        (7, GripperMotion(closed=False)),
    ],
)
def test_discrete_motions(action: int, motion: GripperMotion) -> None:
    assert DISCRETE.motion(action) == motion


def test_continuous_motion_and_clipping() -> None:
    motion = CONTINUOUS.motion(np.array([0.5, -2.0, 1.5, 0.0]))
    assert motion.forward == pytest.approx(0.05)
    assert motion.left == pytest.approx(-0.1)
    assert motion.rotation == pytest.approx(math.radians(50.0))
    assert motion.closed is False
    assert CONTINUOUS.motion(np.array([0.0, 0.0, 0.0, 0.01])).closed is True


@pytest.mark.parametrize("action", [-1, 8, 1.5, np.zeros(4), "close", None])
def test_not_a_discrete_action(action: object) -> None:
    with pytest.raises(ActionError, match="integer from 0 to 7"):
        DISCRETE.motion(action)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("action", [np.zeros(3), np.full(4, np.nan), np.array([0, 0, np.inf, 0]), 2])
def test_not_a_continuous_action(action: object) -> None:
    with pytest.raises(ActionError, match="4 finite numbers"):
        CONTINUOUS.motion(action)  # pyright: ignore[reportArgumentType]


@given(st.integers(0, 2**32))
def test_mirroring_exchanges_left_and_right(seed: int) -> None:
    for space in (DISCRETE, CONTINUOUS):
        action = space.sample(np.random.default_rng(seed))
        motion, mirrored = space.motion(action), space.motion(space.mirror(action))
        assert (mirrored.forward, mirrored.left, mirrored.rotation, mirrored.closed) == (
            motion.forward,
            -motion.left,
            -motion.rotation,
            motion.closed,
        )
        assert np.array_equal(space.mirror(space.mirror(action)), action)


def test_spaces_by_name() -> None:
    assert isinstance(make_action_space("discrete"), DiscreteActionSpace)
    assert isinstance(make_action_space("continuous"), ContinuousActionSpace)
    with pytest.raises(ConfigError, match="discrete, continuous"):
        make_action_space("hybrid")  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    "action",
    [
        *(
            None,
            "abc",
            "1234",
            ["0", "0", "0", "1"],
            [True] * 4,
            [1j] * 4,
            [[1], [2, 3]],
            [None] * 4,
            10**400,
            {},
            b"1234",
        ),
        *(
            np.zeros(3),
            np.zeros((1, 4)),
            np.full(4, np.nan),
            np.ma.masked_all(4),
            np.zeros(4, "datetime64[s]"),
            [0] * 10_000,
        ),
    ],
    ids=range(17),
)
def test_what_is_no_action(action: object) -> None:
    for name in ("continuous", "discrete"):
        with pytest.raises(ActionError) as caught:
            make_action_space(name).motion(action)
        assert len(str(caught.value)) < 500


def test_what_is_an_action() -> None:
    space = make_action_space("continuous")
    expected = space.motion(np.array([0.5, -1.0, 0.25, 1.0]))
    for action in ([0.5, -1, 0.25, 1], (0.5, -1.0, 0.25, 1.0), np.array([0.5, -1.0, 0.25, 1.0], np.float32)):
        assert space.motion(action) == expected
    with pytest.raises(ActionError, match="a discrete action is an integer"):
        make_action_space("discrete").motion(True)
    for name in ("discreet", None, ["discrete"]):
        with pytest.raises(ConfigError, match="choose one of"):
            make_action_space(name)
    with pytest.raises(ActionError, match="consists of numbers"):
        GripperMotion(forward="0.1")
