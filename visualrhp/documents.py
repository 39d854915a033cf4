"""Reading of files: one validated schema for every document, and one sentence for what is wrong with a file.

A :class:`FileKind` knows what its files hold and what to do about one that cannot be used::

    CARD = FileKind("the card of a set (a JSON file)", "generate the set again")
    card = CARD.read(path, SetCard)  # DataError: <path> is damaged: <reason>; generate the set again.

A schema is a class made by :func:`document`, or any other type that :func:`visualrhp.parameters.validated` takes.
"""

from __future__ import annotations

import dataclasses
import errno
import json
import math
import os
import stat
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar, dataclass_transform, get_args, get_origin

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as pydantic_dataclass

from visualrhp.errors import ConfigError, DataError, VisualRHPError
from visualrhp.parameters import validated

T = TypeVar("T")
AnyPath = str | os.PathLike[str]

Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]

_MOST_BYTES: Final = 1 << 26
_MOST_LEVELS: Final = 100
_MOST_DIGITS: Final = 40
"""Of an integer; the state of a random generator has 128 bits."""
_MOST_SHOWN: Final = 400
"""Characters of a path or a reason in a message."""

_REASONS: Final = {
    errno.ENOTDIR: "does not exist: a part of its path is a file, not a folder",
    errno.ELOOP: "is a link in a loop of links",
    errno.EACCES: "cannot be read: this user has no permission",
    errno.EPERM: "cannot be read: this user has no permission",
    errno.ENAMETOOLONG: "cannot exist: its name is too long",
}


@dataclass_transform(frozen_default=True)
def document(cls: type[T]) -> type[T]:
    """Turn a class into the schema of a document: a frozen dataclass with the keys that are read.

    Every field is a required key. Documents may have other keys, too, and nothing is converted but an integer to a
    float. Conditions on several fields are checked in ``__post_init__``, which raises ``ValueError``.
    """
    config = ConfigDict(strict=True, extra="ignore", arbitrary_types_allowed=True)
    return pydantic_dataclass(frozen=True, config=config)(cls)  # pyright: ignore[reportReturnType]


@dataclass(frozen=True)
class FileKind:
    """A kind of file that is read.

    Attributes:
        what: "it should be ...": what such a file holds, and its format.
        remedy: what to do about one that cannot be used: "delete it, and rerun the command".
        error: class of the errors.
        missing: what the message says of a file that does not exist.
    """

    what: str
    remedy: str
    error: type[VisualRHPError] = DataError
    missing: str = "does not exist"

    # ----------------------------------------------------------------------------------------------------- errors
    def unusable(self, path: AnyPath, reason: str) -> VisualRHPError:
        """The error for a file that is not what it should be: "<path> <reason>; <remedy>."."""
        return self.error(f"{shown_path(path)} {brief(reason)}; {self.remedy}.")

    def damaged(self, path: AnyPath, reason: object) -> VisualRHPError:
        """The error for a damaged file: "<path> is damaged: <reason>; <remedy>."."""
        return self.unusable(path, f"is damaged: {reason}")

    def unreadable(self, path: AnyPath, error: OSError | ValueError) -> VisualRHPError:
        """The error for a file that the system does not open."""
        return self.unusable(path, f"{self._reason(path, error)}; it should be {self.what}")

    def objection(self, path: AnyPath) -> VisualRHPError | None:
        """What keeps a file from being read; None if nothing does."""
        try:
            found = os.stat(path)
        except (OSError, ValueError) as error:  # a path with a null character is a ValueError
            return self.unreadable(path, error)
        if stat.S_ISDIR(found.st_mode):
            return self.unusable(path, f"is a folder; it should be {self.what}")
        if not stat.S_ISREG(found.st_mode):  # reading a pipe or a device may never end
            return self.unusable(path, f"is not a regular file; it should be {self.what}")
        if not os.access(path, os.R_OK):
            return self.unusable(path, f"{_REASONS[errno.EACCES]}; it should be {self.what}")
        if found.st_size == 0:
            return self.unusable(path, f"has 0 bytes, so it is damaged; it should be {self.what}")
        return None

    def require(self, path: AnyPath) -> None:
        """Check that a file exists, is no folder, is not empty, and can be read.

        Raises:
            VisualRHPError: it does not, of the class ``error``.
        """
        if objection := self.objection(path):
            raise objection

    def _reason(self, path: AnyPath, error: OSError | ValueError) -> str:
        if not isinstance(error, OSError):
            return f"is not a path ({error})"
        if error.errno == errno.ENOENT:
            if os.path.islink(path):
                return f"is a link to {shown_path(os.readlink(path))}, which does not exist"
            return self.missing
        return _REASONS.get(error.errno or 0, f"cannot be read ({error.strerror or error})")

    # ---------------------------------------------------------------------------------------------------- reading
    def read_text(self, path: AnyPath) -> str:
        """Read a text file (UTF-8).

        Raises:
            VisualRHPError: it cannot be read, is too large or is not UTF-8, of the class ``error``.
        """
        self.require(path)
        try:
            if (size := os.path.getsize(path)) > _MOST_BYTES:
                raise self.unusable(path, f"has {size / 1e6:.0f} MB, too many; it should be {self.what}")
            return Path(path).read_bytes().decode("utf-8")
        except OSError as error:
            raise self.unreadable(path, error) from error
        except UnicodeDecodeError as error:
            found = error.object[error.start]
            raise self.damaged(path, f"byte {error.start} ({found:#04x}) is not UTF-8 text") from error

    def read_content(self, path: AnyPath) -> Any:
        """Read a JSON file, without a schema.

        Raises:
            VisualRHPError: it cannot be read or is not JSON, of the class ``error``.
        """
        text = self.read_text(path)
        try:
            return parse_json(text)
        except ValueError as error:
            raise self.damaged(path, f"it should be JSON, but {error}") from error

    def read(self, path: AnyPath, schema: Any) -> Any:
        """Read a JSON file, validated by ``schema``.

        Raises:
            VisualRHPError: it cannot be read, is not JSON or does not match the schema, of the class ``error``.
        """
        return self.check(path, schema, self.read_content(path))

    def check(self, path: AnyPath, schema: Any, content: Any) -> Any:
        """Validate ``content``, which was read from a file.

        Returns:
            an object of ``schema``.

        Raises:
            VisualRHPError: it does not match, of the class ``error``.
        """
        try:
            return conform(schema, content)
        except ValueError as error:
            raise self.damaged(path, error) from error


def conform(schema: Any, content: Any) -> Any:
    """Validate ``content``, of the types of JSON; return an object of ``schema``.

    Raises:
        ValueError: it does not match; the message says why.
    """
    expected = _container(schema)
    if expected is not None and not isinstance(content, expected):
        word = "a group of keys (a JSON object)" if expected is dict else "a list (a JSON array)"
        raise ValueError(f"it should be {word}, but is {_described(content)}")
    try:
        return validated(schema, content)
    except ConfigError as error:
        raise ValueError(str(error).removesuffix(".")) from error


def parse_json(text: str, *, allow_nan: bool = False) -> Any:
    """Parse JSON, strictly.

    No key occurs twice in a group, all numbers are finite, texts are valid, and the nesting and the lengths of integers
    are bounded.

    Args:
        text: a JSON document.
        allow_nan: accept ``NaN``, ``Infinity`` and ``-Infinity``, as Python's json writes them.

    Raises:
        ValueError: it is not such a document; the message says why.
    """
    constant = float if allow_nan else _refuse_constant
    try:
        content = json.loads(
            text,
            object_pairs_hook=_group,
            parse_float=_finite,
            parse_int=_integer,
            parse_constant=constant,
        )
    except RecursionError as error:
        raise ValueError(_TOO_DEEP) from error
    if (
        isinstance(content, list | dict)
        and text.count("[") + text.count("{") > _MOST_LEVELS
        and _levels_exceed(content, _MOST_LEVELS)
    ):
        raise ValueError(_TOO_DEEP)
    if "\\u" in text:
        try:
            json.dumps(content, ensure_ascii=False).encode()
        except UnicodeEncodeError as error:
            raise ValueError("a text in it has half of a surrogate pair (\\ud800 to \\udfff)") from error
    return content


def files_named(folder: Path, folders: str, name: str) -> Iterator[Path]:
    """The entries ``name`` in the folders that match the pattern ``folders``, sorted; links that lead nowhere, too."""
    for place in sorted(folder.glob(folders)):
        if os.path.lexists(path := place / name):
            yield path


def shown_path(path: AnyPath) -> str:
    """A path for a message: printable, and of bounded length."""
    text = os.fspath(path)
    text = "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in text)
    half = _MOST_SHOWN // 2
    return text if len(text) <= _MOST_SHOWN else f"{text[:half]}...{text[-half:]}"


def brief(reason: object) -> str:
    """A reason for a message: on one line, without a full stop, and of bounded length."""
    text = " ".join(str(reason).split()).removesuffix(".")
    text = "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in text)
    return text if len(text) <= 2 * _MOST_SHOWN else f"{text[: 2 * _MOST_SHOWN]}..."


# ----------------------------------------------------------------------------------------------------------------- JSON
_TOO_DEEP: Final = f"it is nested in more than {_MOST_LEVELS} levels"


def _group(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    group = dict(pairs)
    if len(group) < len(pairs):
        seen: set[str] = set()
        twice = next(key for key, _ in pairs if key in seen or seen.add(key))
        raise ValueError(f"the key {_described(twice)} occurs twice in a group")
    return group


def _finite(literal: str) -> float:
    value = float(literal)
    if not math.isfinite(value):
        raise ValueError(f"the number {_described(literal)} is too large")
    return value


def _integer(literal: str) -> int:
    if len(literal) > _MOST_DIGITS:
        raise ValueError(f"the integer {_described(literal)} is too large")
    return int(literal)


def _refuse_constant(literal: str) -> float:
    raise ValueError(f"{literal} is not a number in JSON")


def _levels_exceed(content: Any, limit: int) -> bool:
    level = [content]
    for _ in range(limit):
        inner = (item for outer in level for item in (outer.values() if isinstance(outer, dict) else outer))
        level = [item for item in inner if isinstance(item, list | dict)]
    return bool(level)


def _container(schema: Any) -> type | None:
    """The type of JSON's container that a schema describes: dict, list or None for neither."""
    while get_origin(schema) is Annotated:
        schema = get_args(schema)[0]
    if dataclasses.is_dataclass(schema):
        return dict
    return {dict: dict, Mapping: dict, list: list, tuple: list}.get(get_origin(schema) or schema)


def _described(content: Any) -> str:
    text = "null" if content is None else repr(content) if not isinstance(content, list | dict) else ""
    if text:
        return text if len(text) <= 40 else f"{text[:37]}..."
    return "a list" if isinstance(content, list) else "a group of keys"
