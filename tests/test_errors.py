"""The error tree: one base class, documented, and every error survives the way between processes."""

from __future__ import annotations

import inspect
import pickle

import pytest

from visualrhp import errors
from visualrhp.errors import VisualRHPError

ERRORS = [kind for _, kind in inspect.getmembers(errors, inspect.isclass)]


@pytest.mark.parametrize("kind", ERRORS)
def test_every_error_has_the_base_class_and_a_description(kind: type[Exception]) -> None:
    assert issubclass(kind, VisualRHPError)
    assert kind.__doc__


@pytest.mark.parametrize("kind", ERRORS)
def test_errors_of_workers_keep_their_type_and_message(kind: type[Exception]) -> None:
    copy = pickle.loads(pickle.dumps(kind("lr=0: it should be positive")))
    assert type(copy) is kind and str(copy) == "lr=0: it should be positive"


def test_no_error_is_caught_as_another() -> None:
    """But a motion that the arm cannot make is an action that cannot be taken."""
    refined = {errors.UnreachableError: errors.ActionError}
    for kind in set(ERRORS) - {VisualRHPError}:
        caught = {other for other in ERRORS if issubclass(kind, other)}
        assert caught == {kind, VisualRHPError} | ({refined[kind]} if kind in refined else set())
