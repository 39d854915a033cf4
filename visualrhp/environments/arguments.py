"""Checks of the arguments that callers give to the environments."""

from __future__ import annotations

import reprlib
from typing import Any

import numpy as np

from visualrhp.errors import ConfigError
from visualrhp.streams import Split

MAX_INDEX = 2**63 - 1
"""Largest index of a task instance: the largest that an int64 holds."""

_SHOWN_CHARACTERS = 80
_REPR = reprlib.Repr()
_REPR.maxother = _REPR.maxstring = _REPR.maxlong = _SHOWN_CHARACTERS


def shown(value: object) -> str:
    """``value`` for a message: one line of at most 80 characters, whatever it is."""
    try:
        text = " ".join(_REPR.repr(value).split())
    except Exception:  # an integer of thousands of digits, or an object whose __repr__ fails
        text = f"a {type(value).__name__}"
    return text if len(text) <= _SHOWN_CHARACTERS else f"{text[: _SHOWN_CHARACTERS - 3]}..."


def is_integer(value: object) -> bool:
    """Whether ``value`` is an integer of Python or NumPy, but no boolean and no time difference."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, (bool, np.timedelta64))


def checked_integer(name: str, meaning: str, value: Any, least: int, most: int | None = None) -> int:
    """The argument ``name`` as an int.

    Args:
        name: of the argument.
        meaning: what it is, for the message.
        value: as given.
        least: smallest valid value.
        most: largest valid value; None for any.

    Raises:
        ConfigError: it is not an integer, or out of range.
    """
    if not is_integer(value) or value < least or (most is not None and value > most):
        bounds = f"at least {least}" if most is None else f"from {least} to {most}"
        raise ConfigError(f"{name} is {meaning}, an integer, {bounds}, not {shown(value)}")
    return int(value)


def checked_seed(seed: Any) -> int:
    """The seed of the task instances as an int.

    Raises:
        ConfigError: it is not an integer, or negative.
    """
    return checked_integer("seed", "the seed of the task instances", seed, 0)


def checked_name(name: str, value: Any) -> Any:
    """The argument ``name``, which names one of several choices.

    Raises:
        ConfigError: it is not a string.
    """
    if not isinstance(value, str):
        raise ConfigError(f"{name} is a name in quotes, not {shown(value)}")
    return value


def checked_split(split: Any) -> Split:
    """The stream of task instances.

    Raises:
        ConfigError: there is no such stream.
    """
    if is_integer(split) and int(split) in list(Split):
        return Split(int(split))
    known = ", ".join(f"{member.value} ({member.name.lower()})" for member in Split)
    raise ConfigError(f"split is {shown(split)}; choose one of {known}")
