"""Well-formed files with a content that is not what it should be: other types, missing keys, values out of range."""

from __future__ import annotations

import io
import json
import os
import pickle
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from visualrhp.evaluation.journal import Journal
from visualrhp.heuristics.tensor_file import read_tensor_file, write_tensor_file

Change = Callable[[Path, bytes, np.random.Generator, Path], Any]
Changes = tuple[list[tuple[str, Change]], set[str]]
"""Changes by name, and the names of those after which the file cannot be used."""

VALUES = (
    None,
    True,
    -1,
    0,
    10**30,
    1e300,
    -0.5,
    "abc",
    "",
    "../../etc/passwd",
    "a\0b",
    "ü" * 5000,
    [],
    {},
    [[1]],
    {"a": 1},
)
"""Values of the types of JSON to put in the place of others."""

WRONG = [[1]]
"""A value that no required key has."""


class _Marked:
    """An object whose pickle makes a file when it is read: nothing that is read may run code."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.path.with_name("code-was-run")),)


def json_changes(required: Sequence[str], is_list: bool = False) -> Changes:
    """Changes of a JSON file; without one of ``required``, or with another type there, it cannot be used."""
    outer = {} if is_list else []
    texts = {
        "another container": json.dumps(outer),
        "null": "null",
        "text": '"text"',
        "number": "3",
        "nested deeply": "[" * 100_000,
        "nested": "[" * 900 + "]" * 900,
        "a key twice": '{"a": 1, "a": 2}',
        "NaN": "NaN",
        "a huge number": '{"a": 1e999}',
        "a long integer": "1" * 10_000,
        "half a surrogate pair": '"\\ud800"',
    }
    changes: list[tuple[str, Change]] = [(name, _writer(text.encode())) for name, text in texts.items()]
    changes.append(("not UTF-8", lambda path, content, *_: path.write_bytes(content[:-2] + b"\xff\xfe" + content[-2:])))
    fatal = {name for name, _ in changes}
    for name, change in _document_changes(required):
        changes.append((name, _on_json(change)))
    return changes, fatal | {name for name, _ in _document_changes(required) if not name.startswith("some")}


def tensor_changes(required: Sequence[str], is_network: bool = False) -> Changes:
    """Changes of the document and the arrays in a tensor file, whose checksum is right."""
    of_documents = list(_document_changes(required))
    of_arrays: dict[str, Callable[[np.ndarray], np.ndarray | None]] = {
        "NaN": lambda values: np.full_like(values, np.nan),
        "infinite": lambda values: np.where(np.arange(values.size).reshape(values.shape) == 0, np.inf, values),
        "integers": lambda values: values.astype(np.int64),
        "booleans": lambda values: values > 0,
        "another shape": lambda values: values[..., None],
        "one less": lambda values: values[:-1],
        "missing": lambda values: None,
    }
    changes: list[tuple[str, Change]] = [(name, _on_document(change)) for name, change in of_documents]
    changes += [(name, _on_arrays(change)) for name, change in of_arrays.items()]
    fatal = {name for name, _ in of_documents if not name.startswith("some")} | set(of_arrays)
    if is_network:
        changes += [
            ("too large", _on_all_arrays(lambda values: np.full_like(values, 1e37))),
            ("double precision, too large", _on_all_arrays(lambda values: np.full(values.shape, 1e300))),
            ("no arrays", _on_all_arrays(lambda values: None)),
        ]
        fatal |= {"too large", "double precision, too large", "no arrays"}
    return changes, fatal


def array_changes(every_is_fatal: bool = False) -> Changes:
    """Changes of the arrays in an npz file."""

    def rewrite(change: Callable[[dict[str, Any], str], Any]) -> Change:
        def apply(path: Path, content: bytes, rng: np.random.Generator, _: Path) -> None:
            arrays = dict(np.load(io.BytesIO(content), allow_pickle=False))
            change(arrays, sorted(arrays)[int(rng.integers(len(arrays)))])
            with path.open("wb") as file:
                np.savez(file, **arrays)

        return apply

    def pickled(path: Path, *_: Any) -> None:
        path.write_bytes(pickle.dumps(_Marked(path)))

    def objects(path: Path, content: bytes, *_: Any) -> None:
        arrays = dict(np.load(io.BytesIO(content), allow_pickle=False))
        with path.open("wb") as file:
            np.savez(file, **{name: np.array([_Marked(path)], dtype=object) for name in arrays})

    def single(path: Path, *_: Any) -> None:
        with path.open("wb") as file:
            np.save(file, np.arange(3))

    changes: list[tuple[str, Change]] = [
        ("a pickle", pickled),
        ("arrays of objects", objects),
        ("an array alone", single),
        ("no arrays", rewrite(lambda arrays, _: arrays.clear())),
        ("a missing array", rewrite(lambda arrays, name: arrays.pop(name))),
        ("texts", rewrite(lambda arrays, name: arrays.update({name: arrays[name].astype(str)}))),
        ("complex numbers", rewrite(lambda arrays, name: arrays.update({name: arrays[name].astype(complex)}))),
        ("a row more", rewrite(lambda arrays, name: arrays.update({name: np.repeat(arrays[name], 3, axis=0)}))),
        ("a number", rewrite(lambda arrays, name: arrays.update({name: np.array(7)}))),
        ("some large numbers", rewrite(lambda arrays, name: arrays.update({name: _large(arrays[name])}))),
    ]
    names = {name for name, _ in changes}
    return changes, names if every_is_fatal else names - {"some large numbers"}


def table_changes(
    read: Callable[[Any], pd.DataFrame], write: Callable[[Path, pd.DataFrame], Any], fatal: Sequence[str] = ()
) -> Changes:
    """Changes of a table."""

    def rewrite(change: Callable[[pd.DataFrame, str], pd.DataFrame]) -> Change:
        def apply(path: Path, content: bytes, rng: np.random.Generator, _: Path) -> None:
            table = read(io.BytesIO(content))
            write(path, change(table, table.columns[int(rng.integers(len(table.columns)))]))

        return apply

    changes: list[tuple[str, Change]] = [
        ("no rows", rewrite(lambda table, _: table.iloc[:0])),
        ("no columns", rewrite(lambda table, _: table[[]])),
        ("drop network", rewrite(lambda table, _: table.drop(columns="network", errors="ignore"))),
        ("some column less", rewrite(lambda table, name: table.drop(columns=name))),
        ("some column of text", rewrite(lambda table, name: table.assign(**{name: "text"}))),
        ("some column of nothing", rewrite(lambda table, name: table.assign(**{name: None}))),
        ("some infinite numbers", rewrite(lambda table, name: table.assign(**{name: np.inf}))),
        ("some negative numbers", rewrite(lambda table, name: table.assign(**{name: -1}))),
        ("some large numbers", rewrite(lambda table, name: table.assign(**{name: 1 << 62}))),
        ("some true values", rewrite(lambda table, name: table.assign(**{name: True}))),
        ("some rows twice", rewrite(lambda table, _: pd.concat([table, table]))),
    ]
    return changes, {"no rows", "no columns", *fatal}


def journal_changes(schema: Any) -> Changes:
    """Lines with right checksums of results that are none."""

    def rewrite(make: Callable[[dict[str, Any], np.random.Generator], Any]) -> Change:
        def apply(path: Path, _: bytes, rng: np.random.Generator, __: Path) -> None:
            result = next(iter(Journal(path, schema).values()))
            Journal(path).append("a/1", make(dict(result), rng))

        return apply

    def without(result: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
        del result[sorted(result)[int(rng.integers(len(result)))]]
        return result

    def wrong(result: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
        return result | {sorted(result)[int(rng.integers(len(result)))]: [["wrong"]]}

    changes: list[tuple[str, Change]] = [
        (f"a result that is {value!r}"[:40], rewrite(lambda result, rng, value=value: value))
        for value in (None, [], {}, 3)
    ]
    changes += [("a result that lacks a key", rewrite(without)), ("a result of another type", rewrite(wrong))]
    for name, line in (
        ("a list", b"[1, 2]"),
        ("null", b"null"),
        ("a group", b'{"a": 1, "b": 2}'),
        ("zeros", b"\0" * 50),
    ):
        changes.append(
            (f"a line that is {name}", lambda path, content, *_, line=line: path.write_bytes(line + b"\n" + content))
        )
    return changes, {name for name, _ in changes}


# ------------------------------------------------------------------------------------------------------------ documents
_OnDocument = Callable[[Any, np.random.Generator], Any]


def _document_changes(required: Sequence[str]) -> Iterator[tuple[str, _OnDocument]]:
    for key in sorted(required):
        yield f"without {key}", lambda content, _, key=key: {name: content[name] for name in content if name != key}
        yield f"{key} of another type", lambda content, _, key=key: content | {key: WRONG}
    for number in range(6):
        yield f"some key less ({number})", lambda content, rng: _altered(content, rng, drop=True)
        yield f"some value of another type ({number})", lambda content, rng: _altered(content, rng, drop=False)


def _altered(content: Any, rng: np.random.Generator, drop: bool) -> Any:
    """A copy with an item less, or another value, somewhere."""
    content = json.loads(json.dumps(content))
    places = list(_places(content))
    container, key = places[int(rng.integers(len(places)))]
    if drop:
        del container[key]
    else:
        container[key] = VALUES[int(rng.integers(len(VALUES)))]
    return content


def _places(content: Any) -> Iterator[tuple[Any, Any]]:
    keys = content if isinstance(content, dict) else range(len(content)) if isinstance(content, list) else ()
    for key in list(keys):
        yield content, key
        yield from _places(content[key])


def _writer(data: bytes) -> Change:
    return lambda path, *_: path.write_bytes(data)


def _on_json(change: _OnDocument) -> Change:
    return lambda path, content, rng, _: path.write_text(json.dumps(change(json.loads(content), rng)))


def _on_document(change: _OnDocument) -> Change:
    def apply(path: Path, _: bytes, rng: np.random.Generator, __: Path) -> None:
        arrays, document = read_tensor_file(path)
        write_tensor_file(path, arrays, change(document, rng))

    return apply


def _on_arrays(change: Callable[[np.ndarray], np.ndarray | None]) -> Change:
    """Change an array of a network, at random."""

    def apply(path: Path, _: bytes, rng: np.random.Generator, __: Path) -> None:
        arrays, document = read_tensor_file(path)
        names = sorted(name for name in arrays if name.endswith(("weight", "bias")))
        name = names[int(rng.integers(len(names)))]
        made: dict[str, Any] = arrays | {name: change(arrays[name])}
        write_tensor_file(path, {key: values for key, values in made.items() if values is not None}, document)

    return apply


def _on_all_arrays(change: Callable[[np.ndarray], np.ndarray | None]) -> Change:
    def apply(path: Path, *_: Any) -> None:
        arrays, document = read_tensor_file(path)
        made: dict[str, Any] = {name: change(values) for name, values in arrays.items()}
        write_tensor_file(path, {key: values for key, values in made.items() if values is not None}, document)

    return apply


def _large(values: np.ndarray) -> np.ndarray:
    return np.full_like(values, True if values.dtype == np.bool_ else 2**40)
