"""Self-validating parameters: frozen dataclasses with ranges on their fields, and errors that name the key.

A parameter has one schema, the dataclass of its algorithm. ``conf/`` gives the values; the pipelines compose them and
validate them against the same dataclass (:func:`validated`)::

    @parameters
    class Budget:
        num_trials: Count = 40
        learning_rate: Positive = 1e-4

    Budget(num_trials=0)  # ConfigError: num_trials=0 is out of range: it should be an integer, at least 1.

Conditions on several fields are checked in ``__post_init__``, which raises ``ValueError(f"{name}={value}...")``; the
path of the dataclass in the configuration is prepended to the message.
"""

from __future__ import annotations

import dataclasses
import difflib
import functools
import json
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Annotated, Any, Literal, TypeVar, dataclass_transform, get_args, get_origin

import annotated_types
from pydantic import BeforeValidator, ConfigDict, Field, SkipValidation, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass as pydantic_dataclass
from pydantic.fields import FieldInfo

from visualrhp.errors import ConfigError

T = TypeVar("T")

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Discount = Annotated[float, Field(gt=0, le=1)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1)]
Index = Annotated[int, Field(ge=0)]

_MOST_SHOWN = 60
_LONGEST = 1900
_Key = tuple[int | str, ...]


def _pair(value: Any) -> Any:
    return (value, value) if isinstance(value, int | float) and not isinstance(value, bool) else value


AsTuple = Field(strict=False)
"""For ``Annotated[tuple[...], AsTuple]``: a list is accepted for a tuple."""

AsRange = BeforeValidator(_pair)
"""For ``Annotated[tuple[T, T], AsRange, AsTuple]``: a single number stands for the range [number, number]."""


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field, Field))
def parameters(cls: type[T] | None = None, *, kw_only: bool = False) -> Any:
    """Turn a class into a frozen dataclass whose fields are validated when it is constructed.

    An ``int`` is accepted for a ``float``; nothing else is converted.

    Args:
        cls: the class; None when the decorator is called with options.
        kw_only: whether its fields are keyword-only; inherited fields are not affected.

    Raises (the class, when it is constructed):
        ConfigError: an argument is unknown or missing, or a value has the wrong type or is out of range.
    """
    if cls is None:
        return functools.partial(parameters, kw_only=kw_only)
    config = ConfigDict(strict=True, extra="forbid", arbitrary_types_allowed=True)
    made: Any = pydantic_dataclass(frozen=True, config=config, kw_only=kw_only)(cls)
    initialize = made.__init__

    @functools.wraps(initialize)
    def __init__(self: Any, *args: Any, **kwargs: Any) -> None:
        try:
            initialize(self, *args, **kwargs)
        except ValidationError as error:
            raise ConfigError(_sentence(error, type(self), _named(type(self), args, kwargs))) from error

    made.__init__ = __init__
    return made


def validated(schema: Any, content: Any) -> Any:
    """Build ``schema``, a class made by :func:`parameters` or a type of such classes, from plain ``content``.

    Every key is required: default values apply only when the dataclass is constructed directly.

    Raises:
        ConfigError: a key is unknown or missing, or a value has the wrong type or is out of range.
    """
    try:
        # In JSON mode, which is equally strict about scalars, an object can be a dataclass and an array a tuple.
        value = _adapter(schema).validate_json(json.dumps(content))
    except ValidationError as error:
        raise ConfigError(_sentence(error, schema, content)) from error
    except (TypeError, ValueError, RecursionError) as error:
        raise ConfigError(
            f"The configuration holds something that is no plain value ({error!s:.200}): it should consist of groups "
            "of keys, lists, numbers, strings, true, false and null."
        ) from error
    missing = _missing_key(value, content, ())
    if missing is not None:
        raise ConfigError(f"The key {missing} is missing: it should be {_describe_at(schema, missing.split('.'))}.")
    return value


def one_of(options: Iterable[object]) -> str:
    """'a', 'a or b', 'a, b or c'."""
    *head, last = [str(option) for option in options] or ["nothing"]
    return f"{', '.join(head)} or {last}" if head else last


def suggestion(name: str, options: Iterable[str]) -> str:
    """A sentence that names the closest of ``options``, or lists them all when none is close."""
    options = sorted(options)
    close = difflib.get_close_matches(name[:_MOST_SHOWN], options, n=1)
    return f"Did you mean {close[0]}?" if close else f"Choose from {', '.join(options) or 'nothing'}."


# ------------------------------------------------------------------------------------------------------------- messages
@functools.lru_cache(maxsize=64)
def _adapter(schema: Any) -> TypeAdapter[Any]:
    return TypeAdapter(schema)


def _named(schema: type, args: Sequence[Any], kwargs: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of a constructor by name."""
    return {**dict(zip((entry.name for entry in dataclasses.fields(schema)), args, strict=False)), **kwargs}  # pyright: ignore[reportArgumentType]


def _sentence(error: ValidationError, schema: Any, content: Any) -> str:
    """A sentence on the first error: the key, the problem, and the expected value; at most 1,900 characters."""
    sentence = _whole_sentence(error, schema, content)
    return sentence if len(sentence) <= _LONGEST else f"{sentence[: _LONGEST - 200]} ... {sentence[-190:]}"


def _whole_sentence(error: ValidationError, schema: Any, content: Any) -> str:
    detail = error.errors(include_url=False)[0]
    location = detail["loc"]
    if location and isinstance(location[0], int) and dataclasses.is_dataclass(schema):  # a positional argument
        location = (dataclasses.fields(schema)[location[0]].name, *location[1:])
    key = _key_of(location, content, detail["type"])
    name = _join(key)
    kind, context, shown = detail["type"], detail.get("ctx", {}), show(detail["input"])
    right = _describe_at(schema, key)
    match kind:
        case "missing" if isinstance(location[-1], int):  # of a list
            return f"{_join(key[:-1])}={shown} has the wrong type: it should be {_describe_at(schema, key[:-1])}."
        case "missing" | "missing_argument" | "missing_keyword_only_argument" | "missing_positional_only_argument":
            return f"The key {name} is missing: it should be {right}."
        case "unexpected_keyword_argument" | "extra_forbidden" | "unexpected_positional_argument":
            return f"There is no key {name}. {suggestion(str(key[-1]), _keys_at(schema, key[:-1], content))}"
        case "union_tag_not_found":
            tag = str(context["discriminator"]).strip("'")
            return f"{name} should be a group with the key {tag} ({one_of(_tags_at(schema, key))})."
        case "union_tag_invalid":
            tag = str(context["discriminator"]).strip("'")
            return f"{_join((*key, tag))}={context['tag']} is not known: it should be {one_of(_tags_at(schema, key))}."
        case "value_error":
            message = str(context["error"])
            return f"{name}.{message}" if name else message
        case "literal_error" | "enum":
            return f"{name}={shown} is not known: it should be {right}."
        case "dataclass_type" | "dataclass_exact_type" | "model_attributes_type" | "model_type":
            return f"{name}={shown} should be a group of keys: {', '.join(_keys_at(schema, key, content))}."
        case "dict_type" if tags := _tags_at(schema, key):
            return f"{name}={shown} should be a group with a key that selects one of its kinds ({one_of(tags)})."
        case "finite_number":
            return f"{name}={shown} is out of range: it should be a finite number."
        case _ if kind.startswith(("greater_than", "less_than")):
            return f"{name}={shown} is out of range: it should be {right}."
        case _:
            return f"{name}={shown} has the wrong type: it should be {right}."


def _key_of(location: _Key, content: Any, kind: str) -> _Key:
    """The keys of the configuration in pydantic's location, which also contains members of unions."""
    key: list[int | str] = []
    for number, part in enumerate(location):
        is_last = number == len(location) - 1
        if isinstance(content, Mapping):
            if part in content:
                content = content[part]
            elif not (is_last and kind.startswith(("missing", "extra", "unexpected"))):
                continue
        elif isinstance(content, Sequence) and not isinstance(content, str):
            if not isinstance(part, int):
                continue
            content = content[part] if part < len(content) else None
        elif dataclasses.is_dataclass(content) and hasattr(content, str(part)):
            content = getattr(content, str(part))
        else:
            continue
        key.append(part)
    return tuple(key)


def _missing_key(value: Any, content: Any, place: _Key) -> str | None:
    """The first field of ``value`` that ``content`` lacks."""
    if not dataclasses.is_dataclass(value) or not isinstance(content, Mapping):
        return None
    for entry in dataclasses.fields(value):
        if not entry.init:
            continue
        if entry.name not in content:
            return _join((*place, entry.name))
        found = _missing_key(getattr(value, entry.name), content[entry.name], (*place, entry.name))
        if found is not None:
            return found
    return None


def _join(key: Iterable[int | str]) -> str:
    """('a', 'b', 0) -> 'a.b[0]'."""
    text = ""
    for part in key:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def show(content: Any) -> str:
    """Format a value for a message."""
    try:
        text = "null" if content is None else str(list(content)) if isinstance(content, tuple) else str(content)
    except ValueError:  # an integer of thousands of digits
        text = "a very large number"
    return text if len(text) <= _MOST_SHOWN else f"{text[: _MOST_SHOWN - 3]}..."


# ------------------------------------------------------------------------------------------------ descriptions of types
def _describe_at(schema: Any, key: Iterable[int | str]) -> str:
    annotation = _annotation_at(schema, key)
    return "a group of keys" if annotation is None else _describe(annotation)


def _annotation_at(schema: Any, key: Iterable[int | str]) -> Any:
    """The type expected at a key; None if it is unknown."""
    annotation = schema
    for part in key:
        bare = _bare(annotation)
        options = [option for option in map(_bare, _options(bare)) if dataclasses.is_dataclass(option)]
        if options:
            hints = {name: hint for option in options for name, hint in _hints(option).items()}
            annotation = hints.get(str(part))
        elif get_origin(bare) is dict:
            annotation = get_args(bare)[1]
        elif get_origin(bare) is tuple and isinstance(part, int):
            items = get_args(bare)
            annotation = items[0] if items[-1] is Ellipsis else items[part] if part < len(items) else None
        else:
            annotation = None
        if annotation is None:
            return None
    return annotation


@functools.lru_cache(maxsize=128)
def _hints(schema: Any) -> dict[str, Any]:
    return typing.get_type_hints(schema, include_extras=True)


def _bare(annotation: Any) -> Any:
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    return annotation


def _options(annotation: Any) -> tuple[Any, ...]:
    return get_args(annotation) if get_origin(annotation) in (typing.Union, types.UnionType) else (annotation,)


def _keys_at(schema: Any, key: _Key, content: Any) -> list[str]:
    """The keys of the group at a key; if there are several groups, of the one that the tag in ``content`` selects."""
    options = [o for o in map(_bare, _options(_bare(_annotation_at(schema, key)))) if dataclasses.is_dataclass(o)]
    for part in key:
        content = getattr(content, str(part)) if dataclasses.is_dataclass(content) else content[part]
    if len(options) > 1 and isinstance(content, Mapping):
        tagged = [
            option
            for option in options
            if any(content.get(name) in get_args(hint) for name, hint in _hints(option).items() if _is_tag(hint))
        ]
        options = tagged or options
    return list(dict.fromkeys(entry.name for option in options for entry in dataclasses.fields(option)))


def _is_tag(annotation: Any) -> bool:
    return get_origin(annotation) is Literal and len(get_args(annotation)) == 1


def _tags_at(schema: Any, key: _Key) -> list[str]:
    """The values of the tag that distinguishes the groups at a key."""
    options = [o for o in map(_bare, _options(_bare(_annotation_at(schema, key)))) if dataclasses.is_dataclass(o)]
    return [get_args(hint)[0] for option in options for hint in _hints(option).values() if _is_tag(hint)]


def _describe(annotation: Any) -> str:
    """Describe a type: 'an integer, at least 1'."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        bounds = " and ".join(_bounds(arguments[1:]))
        return f"{_describe(arguments[0])}, {bounds}" if bounds else _describe(arguments[0])
    if origin is Literal:
        return one_of(
            {True: "true", False: "false"}.get(option, option) if isinstance(option, bool) else option
            for option in arguments
        )
    if origin in (typing.Union, types.UnionType):
        return one_of(_describe(argument) for argument in arguments)
    if origin is tuple:
        if arguments[-1] is Ellipsis:
            return f"a list, each item {_describe(arguments[0])}"
        return f"a list of {len(arguments)}, each item {_describe(arguments[0])}"
    names: dict[Any, str] = {int: "an integer", float: "a number", bool: "true or false", str: "a string"}
    names |= {type(None): "null", Callable: "a function"}
    return names.get(annotation, "a group of keys")


def _bounds(metadata: Iterable[Any]) -> Iterable[str]:
    for entry in metadata:
        for bound in entry.metadata if isinstance(entry, FieldInfo) else [entry]:
            match bound:
                case annotated_types.Gt(gt=value):
                    yield f"above {value:g}"
                case annotated_types.Ge(ge=value):
                    yield f"at least {value:g}"
                case annotated_types.Lt(lt=value):
                    yield f"below {value:g}"
                case annotated_types.Le(le=value):
                    yield f"at most {value:g}"


__all__ = [
    "AsRange",
    "AsTuple",
    "Count",
    "Discount",
    "Field",
    "Fraction",
    "Index",
    "NonNegative",
    "Positive",
    "SkipValidation",
    "one_of",
    "parameters",
    "show",
    "suggestion",
    "validated",
]
