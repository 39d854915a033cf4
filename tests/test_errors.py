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
    for kind in set(ERRORS) - {VisualRHPError}:
        assert [other for other in ERRORS if issubclass(kind, other)] == sorted(
            [kind, VisualRHPError], key=ERRORS.index
        )
