"""Checks of actions: a number stays what it is, or is refused with an ActionError."""

from __future__ import annotations

import datetime
import enum
from decimal import Decimal
from typing import Any

import numpy as np
import pytest
import torch

from visualrhp.environments.actions import batch_of_actions, continuous_action, discrete_action
from visualrhp.errors import ActionError


class Move(enum.IntEnum):
    """Indices of discrete actions."""

    BACK = 1


class Failing:
    """Its conversion fails."""

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        raise RuntimeError("no")


class Endless:
    """A sequence that has no end."""

    def __len__(self) -> int:
        return 2**40

    def __getitem__(self, index: int) -> float:
        return 0.0


FOUR = [0.1, -2.0, 0.0, 1.0]
NO_NUMBERS = [
    "abc",
    "1234",
    b"1234",
    ["1", "0", "0", "0"],
    np.array(["1", "0", "0", "0"]),
    [[1.0], [2.0, 3.0]],
    [[1, 2], 3, 4, 5],
    [1j, 0, 0, 0],
    np.full(4, 1j),
    np.complex128(3),
    np.full(4, "2020-01-01", "datetime64[D]"),
    np.full(4, 3, "timedelta64[s]"),
    np.datetime64(3, "s"),
    np.timedelta64(3, "s"),
    datetime.datetime(2020, 1, 1),
    True,
    np.True_,
    [True] * 4,
    [0.5, True, 0.0, 0.0],
    [0.5, np.True_, 0.0, 0.0],
    [0.5, np.array(True), 0.0, 0.0],
    np.ones(4, bool),
    torch.ones(4, dtype=torch.bool),
    torch.ones(4, dtype=torch.complex64),
    torch.empty(4, device="meta"),
    None,
    [None] * 4,
    {},
    {0, 1, 2, 3},
    {0: 1.0, 1: 1.0, 2: 1.0, 3: 1.0},
    object(),
    [Decimal(1)] * 4,
    np.array(FOUR, dtype=object),
    np.zeros(4, np.dtype([("x", float)])),
    np.ma.array(np.zeros(4), mask=np.array([False, True, False, False])),
    np.ma.masked,
    Failing(),
    Endless(),
    range(10**12),
    (number for number in FOUR),
    [10**400, 0, 0, 0],
    10**6000,
    len,
]


@pytest.mark.parametrize("action", NO_NUMBERS, ids=lambda action: str(type(action).__name__))
def test_what_is_no_number_is_no_action(action: object) -> None:
    with pytest.raises(ActionError, match=r"^a continuous action is an array of 4 finite numbers, not ") as caught:
        continuous_action(action)
    assert len(str(caught.value)) < 200
    with pytest.raises(ActionError, match=r"^a discrete action is an integer from 0 to 7, not ") as caught:
        discrete_action(action)
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize(
    "action",
    [
        FOUR,
        tuple(FOUR),
        np.array(FOUR),
        np.array(FOUR, np.float32),
        np.array(FOUR, np.float16),
        np.array(FOUR, ">f8"),
        [0, np.float32(-2.0), np.int8(0), 1],
        np.array([0, -2, 0, 1], np.int8),
        torch.tensor(FOUR),
        torch.tensor(FOUR, dtype=torch.bfloat16),
        torch.tensor(FOUR, requires_grad=True),
        torch.nn.Parameter(torch.tensor(FOUR)) * 1.0,
        [torch.tensor(0.1), torch.tensor(-2.0, requires_grad=True), 0.0, 1.0],
    ],
    ids=str,
)
def test_four_numbers_are_a_continuous_action(action: Any) -> None:
    found = continuous_action(action)
    assert found.dtype == np.float64 and found.shape == (4,)
    assert found[0] in (0.0, pytest.approx(0.1, abs=1e-3)) and found[1:].tolist() == [-2.0, 0.0, 1.0]


def test_a_continuous_action_is_a_copy() -> None:
    action = np.array(FOUR)
    found = continuous_action(action)
    action[0] = 9.0
    assert found.tolist() == FOUR


@pytest.mark.parametrize(
    "action", [0.5, [0.1] * 3, [0.1] * 5, np.zeros((1, 4)), np.zeros((4, 1)), np.zeros(0)], ids=str
)
def test_other_shapes_are_no_continuous_action(action: Any) -> None:
    with pytest.raises(ActionError, match="array of 4"):
        continuous_action(action)


def test_finite_numbers_are_clipped_only_where_they_are_too_large_to_add() -> None:
    assert continuous_action([1e308, 1e308, -1e308, 1e308]).tolist() == [1.0, 1.0, -1.0, 1.0]
    assert continuous_action([7.0, -7.0, 0.5, 0.0]).tolist() == [7.0, -7.0, 0.5, 0.0]
    for number in (np.nan, np.inf, -np.inf):
        with pytest.raises(ActionError, match="finite"):
            continuous_action([0.0, number, 0.0, 0.0])
    with pytest.raises(ActionError, match="finite"):
        continuous_action([np.inf, -np.inf, 0.0, 0.0])
    if np.finfo(np.longdouble).max > np.finfo(np.float64).max:
        with pytest.raises(ActionError, match="finite"):
            continuous_action(np.full(4, np.finfo(np.longdouble).max))


@pytest.mark.parametrize(
    "action", [1, np.int64(1), np.uint8(1), np.array(1), np.array([1]), [1], (1,), torch.tensor(1), Move.BACK], ids=repr
)
def test_an_integer_is_a_discrete_action(action: Any) -> None:
    found = discrete_action(action)
    assert found == 1 and type(found) is int


@pytest.mark.parametrize(
    "action", [-1, 8, 1.0, 1.99, np.float64(3.0), [[1]], [1, 2], torch.tensor(1.0), 2**64], ids=repr
)
def test_other_numbers_are_no_discrete_action(action: Any) -> None:
    with pytest.raises(ActionError, match="integer from 0 to 7"):
        discrete_action(action)


# Batches

WRONG_DISCRETE = [
    (torch.full((2,), 1.99), r"tensor of \[2\] integers, not of \[2\] torch.float32"),
    (torch.full((2,), 3.0, dtype=torch.float64), "float64"),
    (torch.ones(2, dtype=torch.bool), "bool"),
    (torch.ones(2, dtype=torch.complex64), "complex64"),
    (torch.ones(2, 1, dtype=torch.int64), r"\[2, 1\]"),
    (torch.tensor(1), r"not of \[\]"),
    (torch.tensor([0, 8]), r"from 0 to 7, not 8 \(slot 1\)"),
    (torch.tensor([-1, 0]), r"not -1 \(slot 0\)"),
]
NO_TENSORS = [None, "abc", 3, torch.ones(2, device="meta")]
WRONG_CONTINUOUS = [
    (torch.full((2, 1), 0.5), r"tensor of \[2, 4\] numbers, not of \[2, 1\]"),
    (torch.full((2,), 0.5), r"\[2\]"),
    (torch.full((1, 4), 0.5), r"\[1, 4\]"),
    (torch.full((4,), 0.5), r"\[4\]"),
    (torch.ones(2, 4, dtype=torch.bool), "bool"),
    (torch.ones(2, 4, dtype=torch.complex64), "complex64"),
    (torch.tensor([[0.0] * 4, [0.0, np.nan, 0.0, 0.0]]), r"finite numbers, not \[0.0, nan, 0.0, 0.0\] \(slot 1\)"),
    (torch.full((2, 4), torch.inf), r"slot 0"),
]


@pytest.mark.parametrize(
    ("is_discrete", "actions", "message"),
    [(True, *case) for case in WRONG_DISCRETE]
    + [(False, *case) for case in WRONG_CONTINUOUS]
    + [
        (flag, wrong, "should be a tensor")
        for flag in (True, False)
        for wrong in (None, "abc", 3, torch.ones(2, device="meta"))
    ],
    ids=str,
)
def test_a_batch_of_other_shapes_types_or_numbers_is_refused(is_discrete: bool, actions: Any, message: str) -> None:
    with pytest.raises(ActionError, match=message):
        batch_of_actions(actions, is_discrete, 2)


def test_a_batch_of_actions() -> None:
    for dtype in (torch.int64, torch.int8, torch.uint8):
        assert batch_of_actions(torch.tensor([0, 7], dtype=dtype), True, 2).tolist() == [0, 7]
    numbers = torch.tensor([[0.5, -3.0, 1e30, 0.0], [1.0, 0.25, -1.0, -0.5]], requires_grad=True)
    expected = [[0.5, -1.0, 1.0, 0.0], [1.0, 0.25, -1.0, -0.5]]
    for actions in (numbers, numbers.double(), numbers.bfloat16() * 1):
        found = batch_of_actions(actions, False, 2)
        assert found.dtype == np.float64 and found.tolist() == expected
    assert batch_of_actions(torch.tensor([[1, 0, 0, -5]]), False, 1).tolist() == [[1.0, 0.0, 0.0, -1.0]]
