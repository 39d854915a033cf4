"""YAML and JSON texts as plain values, with the line and column of each, so that faults can be shown where they are.

A text is read in bounded time: :data:`MAX_BYTES` and :data:`MAX_VALUES` limit what it holds. YAML's syntax is read by
libyaml, and plain values by the rules of YAML 1.2 (a number may be 1e-3, and ``no`` is a string).
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from visualrhp.errors import SceneError
from visualrhp.scene.start import field_path

MAX_BYTES = 1_000_000
"""Largest size of a scene file."""

MAX_VALUES = 100_000
"""Largest number of values in a YAML file, each list and each number counted. JSON is read faster."""

MAX_MESSAGE = 1900
"""Largest number of characters in an error message."""

MOST_FAULTS = 12
"""Largest number of faults that are shown before the last one."""

_MAX_DEPTH = 16
_MOST_OF_A_LINE = 300
_NULL = ("", "~", "null", "Null", "NULL")
_BOOL = {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}
_INTEGER = re.compile(r"[-+]?(?:0b[01_]+|0o[0-7_]+|0x[0-9a-fA-F_]+|[0-9_]*[0-9][0-9_]*)")
_FLOAT = re.compile(
    r"[-+]?[0-9][0-9_]*\.[0-9_]*(?:[eE][-+]?[0-9]+)?|[-+]?[0-9][0-9_]*[eE][-+]?[0-9]+"
    r"|[-+]?\.[0-9_]+(?:[eE][-+][0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)"
)
_TAGS = {f"tag:yaml.org,2002:{name}": name for name in ("str", "int", "float", "bool", "null", "seq", "map")} | {
    "!": "str"
}

Where = tuple[str | int, ...]
"""The path of a field: ("objects", 2, "pose")."""


class Fault(NamedTuple):
    """What is wrong with a field.

    Attributes:
        where: its path.
        message: the problem and what would be right.
        at_key: whether the place is the name of the field, and not its value.
    """

    where: Where
    message: str
    at_key: bool = False


@dataclass(slots=True)
class _Node:
    """A scalar, sequence or mapping (whose children are a key, its value, the next key ...), and where it starts."""

    kind: str
    mark: Any
    tag: str | None = None
    is_plain: bool = False
    text: str = ""
    children: list[_Node] | None = None


def fault_lines(faults: Sequence[str]) -> str:
    """The first faults and the last, one a line, in at most :data:`MAX_MESSAGE` characters."""
    if len(faults) == 1:
        return shortened(faults[0], MAX_MESSAGE)
    last = shortened(faults[-1], 700)
    lines, room = [], MAX_MESSAGE - len(last) - 40
    for line in faults[: min(len(faults) - 1, MOST_FAULTS)]:
        line = shortened(line, 700)
        room -= len(line) + 1
        if room < 0:
            break
        lines.append(line)
    rest = len(faults) - 1 - len(lines)
    return "\n".join([*lines, *([f"... and {rest} more faults, and"] if rest else []), last])


def worded(number: int, total: int) -> bool:
    """Whether fault ``number`` of a ``total`` can be among those that :func:`fault_lines` shows."""
    return number < MOST_FAULTS or number == total - 1


def shortened(text: str, most: int = _MOST_OF_A_LINE) -> str:
    """The text, or its beginning and end if it has more than ``most`` characters."""
    return text if len(text) <= most else f"{text[: most - 33]} ... {text[-28:]}"


class SceneDocument:
    """The plain values of a YAML or JSON text, and their places.

    Args:
        source: the file from which the text is; its suffix tells the format.
        text: the text.

    Attributes:
        content: the values.

    Raises:
        SceneError: it is not YAML or JSON of plain values, a key occurs twice, or it is too large; see :meth:`refuse`.
    """

    def __init__(self, source: Path, text: str) -> None:
        self._name = shortened(str(source), 200)
        self._text = text
        self._is_json = source.suffix == ".json"
        self._root: _Node | None = None
        self._values: dict[int, Any] = {}
        if len(text) > MAX_BYTES:
            raise SceneError(f"{self._name}: has more than {MAX_BYTES} characters; it should be a scene file")
        self.content: Any = self._json() if self._is_json else self._value(self._compose(), ())

    def _json(self) -> Any:
        try:
            return json.loads(self._text, object_pairs_hook=_unique)
        except json.JSONDecodeError as error:
            raise SceneError(f"{self._name}:{error.lineno}:{error.colno}: is not JSON: {error.msg}") from error
        except _DuplicateKey as error:
            self._value(self._compose(), ())  # which names the place
            raise SceneError(f"{self._name}: the key {shortened(str(error), 60)} occurs twice; remove one") from error
        except (RecursionError, ValueError) as error:
            raise SceneError(f"{self._name}: is not JSON of a scene: {shortened(str(error))}") from error

    def _compose(self) -> _Node:
        """The nodes of the text, read once."""
        import yaml

        if self._root is not None:
            return self._root
        # Tabs are white space in JSON, but not in YAML, as which its places are found.
        text = self._text.replace("\t", " ") if self._is_json else self._text
        try:
            self._root = self._node_of(yaml.parse(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader)))
        except yaml.MarkedYAMLError as error:
            problem = shortened(error.problem or error.context or "")
            self._not_plain(error.problem_mark or error.context_mark, problem, error)
        except (yaml.YAMLError, RecursionError, ValueError) as error:
            self._not_plain(None, shortened(str(error)), error)
        if self._root is None:
            raise SceneError(f"{self._name}: is empty; it should be a scene file")
        return self._root

    def _not_plain(self, mark: Any, problem: str, cause: Exception | None = None) -> NoReturn:
        place = f":{mark.line + 1}:{mark.column + 1}" if mark else ""
        raise SceneError(f"{self._name}{place}: is not a YAML file of plain values: {problem}") from cause

    def _node_of(self, events: Any) -> _Node | None:
        """Build the nodes from libyaml's events, without recursion."""
        root = _Node("sequence", None, children=[])
        open_nodes, anchors, count = [root], {}, 0
        for event in events:
            kind = type(event).__name__
            if kind.endswith("EndEvent"):
                if kind in ("SequenceEndEvent", "MappingEndEvent"):
                    open_nodes.pop()
                continue
            if kind in ("StreamStartEvent", "DocumentStartEvent"):
                if root.children:
                    self._not_plain(event.start_mark, "there is a second document")
                continue
            count += 1
            if count > MAX_VALUES:
                self._not_plain(
                    event.start_mark,
                    f"there are more than {MAX_VALUES} values; JSON may have more, and ObjectShape.from_contour("
                    "points, tolerance) reduces the vertices of outlines",
                )
            if kind == "AliasEvent":
                node = anchors.get(event.anchor)
                if node is None:
                    self._not_plain(event.start_mark, f"found undefined alias {shortened(event.anchor, 60)!r}")
                    continue
            else:
                node = _node(kind, event)
                if event.anchor is not None:
                    anchors[event.anchor] = node
            parent = open_nodes[-1]
            assert parent.children is not None
            parent.children.append(node)
            if kind not in ("AliasEvent", "ScalarEvent"):
                if len(open_nodes) > 4 * _MAX_DEPTH:
                    self._not_plain(event.start_mark, "it is nested too deeply")
                open_nodes.append(node)
        return root.children[0] if root.children else None

    def _value(self, node: _Node, where: Where) -> Any:
        """The plain value of a node, built once for all its aliases.

        Duplicate keys, keys that are not plain values, and recursive aliases are rejected.
        """
        if id(node) in self._values:
            return self._values[id(node)]
        if len(where) > _MAX_DEPTH:
            self._refuse_at(node, where[:3], "is nested too deeply for a scene")
        if node.tag is not None and node.tag not in _TAGS:
            self._not_plain(node.mark, f"the tag {shortened(node.tag, 100)!r} stands for no plain value")
        value: Any
        if node.kind == "sequence":
            value = [self._value(child, (*where, index)) for index, child in enumerate(node.children or ())]
        elif node.kind == "mapping":
            value = {}
            for key, child in _pairs(node):
                if key.kind != "scalar":
                    self._refuse_at(key, where, "has a key that is not the name of a field")
                if key.text in value:
                    self._refuse_at(key, (*where, key.text), "occurs twice; remove one")
                value[key.text] = self._value(child, (*where, key.text))
        else:
            try:
                value = _scalar(node)
            except ValueError as error:
                self._not_plain(node.mark, shortened(str(error), 100), error)
        self._values[id(node)] = value
        return value

    def refuse(self, faults: Sequence[Fault]) -> None:
        """Raise an error with the line and column of the first faults, if there are any."""
        lines = [self._line(fault) if worded(number, len(faults)) else "" for number, fault in enumerate(faults)]
        if lines:
            raise SceneError(fault_lines(lines))

    def _line(self, fault: Fault) -> str:
        try:
            mark = self._node(fault).mark
            place = f"{self._name}:{mark.line + 1}:{mark.column + 1}"
        except SceneError:  # JSON that is no YAML
            place = self._name
        return f"{place}: {shortened(field_path(fault.where), 100) or 'the scene'}: {shortened(fault.message)}"

    def _refuse_at(self, node: _Node, where: Where, message: str) -> NoReturn:
        place = f"{self._name}:{node.mark.line + 1}:{node.mark.column + 1}"
        raise SceneError(f"{place}: {shortened(field_path(where), 100) or 'the scene'}: {message}")

    def _node(self, fault: Fault) -> _Node:
        """The node of a field, or the innermost node around it in the file; that of its name if the fault is there."""
        node = self._compose()
        for number, key in enumerate(fault.where):
            found = _child(node, key)
            if found is None:
                break
            is_last = number == len(fault.where) - 1
            node = found[0] if is_last and fault.at_key else found[1]
        return node


class _DuplicateKey(ValueError):
    pass


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object, of which no key occurs twice."""
    made = dict(pairs)
    if len(made) < len(pairs):
        seen: set[str] = set()
        raise _DuplicateKey(next(key for key, _ in pairs if key in seen or seen.add(key)))
    return made


def _node(kind: str, event: Any) -> _Node:
    if kind == "ScalarEvent":
        return _Node("scalar", event.start_mark, event.tag, event.implicit[0], event.value)
    made = "sequence" if kind == "SequenceStartEvent" else "mapping"
    return _Node(made, event.start_mark, event.tag, children=[])


def _pairs(node: _Node) -> Iterator[tuple[_Node, _Node]]:
    children = node.children or []
    return zip(children[::2], children[1::2], strict=False)


def _child(node: _Node, key: str | int) -> tuple[_Node, _Node] | None:
    """The node of a key and that of its value; of a sequence, twice that of its item."""
    if node.kind == "sequence" and isinstance(key, int) and key < len(node.children or ()):
        item = (node.children or [])[key]
        return item, item
    if node.kind == "mapping":
        return next(((name, value) for name, value in _pairs(node) if name.text == key), None)
    return None


def _scalar(node: _Node) -> Any:
    """The plain value of a scalar by the core schema of YAML 1.2."""
    text, wanted = node.text, _TAGS.get(node.tag or "")
    if wanted == "str" or (wanted is None and not node.is_plain):
        return text
    if wanted in (None, "null") and text in _NULL:
        return None
    if wanted in (None, "bool") and text in _BOOL:
        return _BOOL[text]
    if wanted in (None, "int") and _INTEGER.fullmatch(text):
        return _integer(text.replace("_", ""))
    if wanted in (None, "float") and (_FLOAT.fullmatch(text) or (wanted and _INTEGER.fullmatch(text))):
        number = text.replace("_", "").lower()
        return float(number.replace(".inf", "inf").replace(".nan", "nan"))
    if wanted is not None:
        raise ValueError(f"{shortened(text, 40)!r} is not of its type, {wanted}")
    return text


def _integer(text: str) -> int:
    bare = text.lstrip("+-")
    base = {"0b": 2, "0o": 8, "0x": 16}.get(bare[:2], 10)
    magnitude = int(bare[2:] if base != 10 else bare, base)
    return -magnitude if text.startswith("-") else magnitude
