"""From a composed configuration to typed dataclasses, with errors that name the key and say what would be right.

OmegaConf's structured configs know no ranges, tuples, literals or alternatives chosen by a tag, and their messages
speak of classes instead of keys. This does, for plain dataclasses:

- every field is required, and every key has to be a field;
- ``int``, ``float`` (an ``int`` will do), ``bool``, ``str``, ``Literal``, ``T | None``, ``dict[str, T]``,
  ``tuple[T, ...]``, ``tuple[T, T]``, ``Any``, dataclasses;
- ``Annotated[T, Range(...)]`` bounds a number, or every number of a tuple;
- a union of dataclasses, told apart by their first field, a ``Literal`` with one value.
"""

from __future__ import annotations

import difflib
import math
import types
import typing
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

T = TypeVar("T")


@dataclass(frozen=True)
class Range:
    """Bounds of a number; ``above`` and ``below`` are exclusive."""

    at_least: float | None = None
    above: float | None = None
    at_most: float | None = None
    below: float | None = None

    def __contains__(self, value: float) -> bool:
        return (
            (self.at_least is None or value >= self.at_least)
            and (self.above is None or value > self.above)
            and (self.at_most is None or value <= self.at_most)
            and (self.below is None or value < self.below)
        )

    def __str__(self) -> str:
        parts = [
            f"{phrase} {bound:g}"
            for phrase, bound in (
                ("at least", self.at_least),
                ("above", self.above),
                ("at most", self.at_most),
                ("below", self.below),
            )
            if bound is not None
        ]
        return " and ".join(parts)


Positive = Annotated[float, Range(above=0)]
NonNegative = Annotated[float, Range(at_least=0)]
Fraction = Annotated[float, Range(at_least=0, at_most=1)]
Count = Annotated[int, Range(at_least=1)]
Index = Annotated[int, Range(at_least=0)]


def decode(schema: type[T], content: Any, key: str = "") -> T:
    """Build ``schema`` from plain ``content`` (dicts, lists, scalars); ``key`` is where the content is, for messages.

    Raises:
        ConfigError: a key is unknown or absent, or a value has the wrong type or is out of range.
    """
    return typing.cast(T, _decode(schema, content, key))


def one_of(options: Iterable[object]) -> str:
    """'a', 'a or b', 'a, b or c'."""
    *head, last = [str(option) for option in options] or ["nothing"]
    return f"{', '.join(head)} or {last}" if head else last


def suggestion(name: str, options: Iterable[str]) -> str:
    """A sentence that names the closest of ``options``, or lists them all when none is close."""
    options = sorted(options)
    close = difflib.get_close_matches(name, options, n=1)
    return f"Did you mean {close[0]}?" if close else f"Choose from {', '.join(options) or 'nothing'}."


def _error(message: str) -> Exception:
    from visualrhp.errors import ConfigError  # imported late: `--help` needs nothing of the library

    return ConfigError(message)


def _join(key: str, name: str) -> str:
    return f"{key}.{name}" if key else name


def _decode(schema: Any, content: Any, key: str, described: Any = None) -> Any:
    """``described`` is what a message about the type says instead of ``schema``, which is a part of it."""
    origin = get_origin(schema)
    if origin is Annotated:
        inner, bounds = get_args(schema)
        value = _decode(inner, content, key, described or schema)
        for number in value if isinstance(value, tuple) else (value,):
            if number is not None and number not in bounds:
                raise _error(f"{key}={_show(content)} is out of range: it should be {_describe(schema)}.")
        return value
    if origin in (Union, types.UnionType):
        return _decode_union(schema, content, key)
    if is_dataclass(schema):
        return _decode_dataclass(typing.cast(type, schema), content, key)
    if origin is tuple:
        return _decode_tuple(schema, content, key)
    if origin is dict:
        if not isinstance(content, Mapping):
            raise _wrong_type(schema, content, key)
        return {
            str(name): _decode(get_args(schema)[1], value, _join(key, str(name))) for name, value in content.items()
        }
    if origin is Literal:
        if content not in get_args(schema):
            raise _error(f"{key}={_show(content)} is not known: it should be {one_of(get_args(schema))}.")
        return content
    return _decode_scalar(schema, content, key, described or schema)


def _decode_scalar(schema: Any, content: Any, key: str, described: Any) -> Any:
    if schema is Any:
        return content
    if schema is float and isinstance(content, int) and not isinstance(content, bool):
        content = float(content)
    if not isinstance(content, schema) or (schema is int and isinstance(content, bool)):
        raise _wrong_type(described, content, key)
    if schema is float and not math.isfinite(typing.cast(float, content)):
        raise _error(f"{key}={content} is out of range: it should be a finite number.")
    return content


def _decode_union(schema: Any, content: Any, key: str) -> Any:
    options = get_args(schema)
    if content is None and type(None) in options:
        return None
    options = [option for option in options if option is not type(None)]
    if len(options) == 1:
        return _decode(options[0], content, key, described=schema)
    if not all(is_dataclass(option) for option in options):
        for option in options:
            if _looks_like(option, content):
                return _decode(option, content, key)
        raise _wrong_type(schema, content, key)
    tag, by_value = _tagged(options)
    if not isinstance(content, Mapping) or tag not in content:
        raise _error(f"{key} should be a group with the key {tag} ({one_of(by_value)}).")
    if content[tag] not in by_value:
        raise _error(f"{_join(key, tag)}={_show(content[tag])} is not known: it should be {one_of(by_value)}.")
    return _decode(by_value[content[tag]], content, key)


def _tagged(options: Iterable[Any]) -> tuple[str, dict[str, Any]]:
    """Name of the first field of the dataclasses, and the dataclass for each of its values."""
    by_value: dict[str, Any] = {}
    tags = set()
    for option in options:
        name = fields(option)[0].name
        tags.add(name)
        for value in get_args(typing.get_type_hints(option)[name]):
            by_value[value] = option
    (tag,) = tags
    return tag, by_value


def _looks_like(schema: Any, content: Any) -> bool:
    if get_origin(schema) is Annotated:
        schema = get_args(schema)[0]
    if get_origin(schema) is tuple:
        return isinstance(content, list | tuple)
    if get_origin(schema) is Literal:
        return content in get_args(schema)
    return isinstance(content, schema) and not isinstance(content, bool)


def _decode_dataclass(schema: type, content: Any, key: str) -> Any:
    if not isinstance(content, Mapping):
        raise _error(f"{key}={_show(content)} should be a group of keys: {', '.join(f.name for f in fields(schema))}.")
    types_by_name = typing.get_type_hints(schema, include_extras=True)
    names = [field.name for field in fields(schema)]
    for name in content:
        if name not in names:
            raise _error(f"There is no key {_join(key, str(name))}. {suggestion(str(name), names)}")
    for name in names:
        if name not in content:
            raise _error(f"The key {_join(key, name)} is missing: it should be {_describe(types_by_name[name])}.")
    return schema(**{name: _decode(types_by_name[name], content[name], _join(key, name)) for name in names})


def _decode_tuple(schema: Any, content: Any, key: str) -> Any:
    items = get_args(schema)
    if not isinstance(content, list | tuple):
        raise _wrong_type(schema, content, key)
    if items[-1] is Ellipsis:
        items = (items[0],) * len(content)
    if len(items) != len(content):
        raise _wrong_type(schema, content, key)
    return tuple(
        _decode(item, value, f"{key}[{i}]") for i, (item, value) in enumerate(zip(items, content, strict=True))
    )


def _wrong_type(schema: Any, content: Any, key: str) -> Exception:
    return _error(f"{key}={_show(content)} has the wrong type: it should be {_describe(schema)}.")


def _show(content: Any) -> str:
    text = str(content) if content is not None else "null"
    return text if len(text) <= 60 else f"{text[:57]}..."


def _describe(schema: Any) -> str:
    """A type in words."""
    origin, arguments = get_origin(schema), get_args(schema)
    if origin is Annotated:
        return f"{_describe(arguments[0])}, {arguments[1]}"
    if origin is Literal:
        return one_of(arguments)
    if origin in (Union, types.UnionType):
        return one_of(_describe(argument) for argument in arguments)
    if origin is tuple:
        if arguments[-1] is Ellipsis:
            return f"a list, each item {_describe(arguments[0])}"
        return f"a list of {len(arguments)}, each item {_describe(arguments[0])}"
    if origin is dict:
        return "a group of keys"
    names = {int: "a whole number", float: "a number", bool: "true or false", str: "a text", type(None): "null"}
    return names.get(schema, "a group of keys")
