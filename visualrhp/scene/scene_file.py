"""Task instances in YAML or JSON files, for user-defined scenes (docs/scenes.md describes every field).

A file is read in three passes: syntax (with line and column of every value), fields against the schema of
:mod:`visualrhp.scene.scene_schema`, and geometry. Each pass reports all errors that it finds, with line and field.

An object's outline may be drawn in any frame, and its pose is the pose of that frame. An outline whose centre of mass
is at the origin of its frame, as in :class:`ObjectShape`, is read without change.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from visualrhp.errors import SceneError
from visualrhp.files import write_text
from visualrhp.scene import geometry
from visualrhp.scene.gripper import Gripper
from visualrhp.scene.polygons import polygon_fault
from visualrhp.scene.scene import CENTRE_TOLERANCE, ObjectShape, Scene, TargetRegion, TaskInstance
from visualrhp.scene.start import field_path, start_faults
from visualrhp.types import FloatArray, State

if TYPE_CHECKING:
    from visualrhp.scene.scene_schema import ObjectFields, SceneFields

_SUFFIXES = (".yaml", ".yml", ".json")
_HEADER = (
    "# Task instance of visualrhp. SI units, radians; world frame: x right, y up. The desired object comes first.\n"
)
_START_DISTANCE = 0.03
_MAX_DEPTH = 16

_Path = tuple[str | int, ...]
_Node = Any  # of ruamel.yaml, which is imported lazily so that `import visualrhp.scene` stays fast


class _Fault(NamedTuple):
    where: _Path
    message: str
    node: _Node | None = None


def load_task_instance(path: str | os.PathLike[str]) -> TaskInstance:
    """Read a scene and its initial state from a YAML or JSON file, by its suffix.

    Raises:
        SceneError: the file cannot be read, is not YAML or JSON, does not follow the schema, or cannot be simulated (a
            degenerate polygon, an overlapping start, an object off the surface). Each line of the
            message starts with file, line, column and field.
    """
    source = Path(path)
    document = _Document(source, _read(source))
    fields = _validated(document)
    instance = _task_instance(document, fields)
    document.refuse([_Fault(*fault) for fault in start_faults(instance.scene, instance.state)])
    return instance


def save_task_instance(path: str | os.PathLike[str], instance: TaskInstance) -> None:
    """Write a scene and its initial state to a YAML or JSON file, by its suffix, atomically.

    Loading the file returns an instance that equals ``instance`` exactly.

    Raises:
        SceneError: the instance could not be loaded again (overlapping start, a value outside the ranges of a scene
            file), or the suffix is not supported.
    """
    destination = Path(path)
    _check_suffix(destination)
    content = _content(instance)
    faults = [*_schema_faults(content)[1], *(_Fault(*fault) for fault in start_faults(instance.scene, instance.state))]
    if faults:
        lines = [f"{field_path(fault.where)}: {fault.message}" for fault in faults]
        raise SceneError("\n".join([f"{destination}: not written, since it could not be read again", *lines]))
    write_text(destination, json.dumps(content, indent=2) + "\n" if destination.suffix == ".json" else _yaml(content))


def scene_file_schema() -> dict[str, Any]:
    """The JSON Schema of scene files, for editors and other programs. It does not check the geometry."""
    from visualrhp.scene.scene_schema import SceneFields

    schema = SceneFields.model_json_schema(by_alias=True)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": "Scene of visualrhp"}


def _check_suffix(path: Path) -> None:
    if path.suffix not in _SUFFIXES:
        raise SceneError(f"{path}: a scene file is YAML or JSON and ends with one of {', '.join(_SUFFIXES)}")


def _read(source: Path) -> str:
    _check_suffix(source)
    try:
        return source.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise SceneError(f"{source}: cannot be read ({error.strerror}); it should be a scene file") from error
    except UnicodeDecodeError as error:
        raise SceneError(f"{source}: is not text in UTF-8 ({error}); it should be a scene file") from error


class _Document:
    """The nodes of a YAML or JSON text, with their positions."""

    def __init__(self, source: Path, text: str) -> None:
        from ruamel.yaml import YAML
        from ruamel.yaml.error import MarkedYAMLError, YAMLError

        self._source = source
        self._values: dict[int, Any] = {}
        if source.suffix == ".json":
            self._check_json(text)
            text = text.replace("\t", " ")  # tabs are white space in JSON, but not in YAML, whose parser reads both
        loader = YAML(typ="safe", pure=True)  # builds only numbers, strings, lists and mappings
        try:
            self._root = loader.compose(text)
            if self._root is None:
                raise SceneError(f"{source}: is empty; it should be a scene file")
            self.content = self._value(self._root, loader.constructor, ())
        except MarkedYAMLError as error:
            mark = error.problem_mark or error.context_mark
            place = f":{mark.line + 1}:{mark.column + 1}" if mark else ""
            problem = error.problem or error.context
            raise SceneError(f"{source}{place}: is not a YAML file of plain values: {problem}") from error
        except (YAMLError, RecursionError, ValueError) as error:
            raise SceneError(f"{source}: is not a YAML file of plain values: {error}") from error

    def _check_json(self, text: str) -> None:
        try:
            json.loads(text)
        except json.JSONDecodeError as error:
            raise SceneError(f"{self._source}:{error.lineno}:{error.colno}: is not JSON: {error.msg}") from error
        except (RecursionError, ValueError) as error:
            raise SceneError(f"{self._source}: is not JSON of a scene: {error}") from error

    def _value(self, node: _Node, constructor: Any, where: _Path) -> Any:
        """The plain value of a node, built once for all its aliases.

        Duplicate keys, keys that are not plain values, and recursive aliases are rejected.
        """
        if id(node) in self._values:
            return self._values[id(node)]
        if len(where) > _MAX_DEPTH:
            self.refuse([_Fault(where[:3], "is nested too deeply for a scene", node)])
        if node.id == "sequence":
            value = [self._value(child, constructor, (*where, index)) for index, child in enumerate(node.value)]
        elif node.id == "mapping":
            value = {}
            for key, child in node.value:
                if key.id != "scalar":
                    self.refuse([_Fault(where, "has a key that is not the name of a field", key)])
                name = str(key.value)
                if name in value:
                    self.refuse([_Fault((*where, name), "occurs twice; remove one", key)])
                value[name] = self._value(child, constructor, (*where, name))
        else:
            value = constructor.construct_object(node)
        self._values[id(node)] = value
        return value

    def refuse(self, faults: Sequence[_Fault]) -> None:
        """Raise an error with the line and column of each fault, if there are any."""
        lines = []
        for fault in faults:
            mark = (fault.node or self._node(fault.where)).start_mark
            place = f"{self._source}:{mark.line + 1}:{mark.column + 1}"
            lines.append(f"{place}: {field_path(fault.where) or 'the scene'}: {fault.message}")
        if lines:
            raise SceneError("\n".join(lines))

    def _node(self, where: _Path) -> _Node:
        """The node at a path, or the innermost node around it in the file; the key node for an unknown field."""
        node = self._root
        for key in where:
            children = dict(_children(node))
            if key not in children:
                break
            node = children[key]
        return node

    def key_node(self, where: _Path) -> _Node:
        """The key of the mapping that holds the value at a path."""
        parent = self._node(where[:-1])
        return next(key for key, _ in parent.value if key.value == where[-1])


def _children(node: _Node) -> Iterator[tuple[str | int, _Node]]:
    if node.id == "sequence":
        yield from enumerate(node.value)
    elif node.id == "mapping":
        yield from ((str(key.value), child) for key, child in node.value)


def _validated(document: _Document) -> SceneFields:
    fields, faults = _schema_faults(document.content)
    document.refuse(
        [f._replace(node=document.key_node(f.where)) if f.message.startswith(_UNKNOWN) else f for f in faults]
    )
    assert fields is not None
    return fields


_UNKNOWN = "is not a field"


def _schema_faults(content: Any) -> tuple[SceneFields | None, list[_Fault]]:
    """The fields, or their faults."""
    from pydantic import ValidationError

    from visualrhp.scene.scene_schema import SceneFields

    try:
        return SceneFields.model_validate(content), []
    except ValidationError as error:
        return None, [_schema_fault(detail) for detail in error.errors(include_url=False, include_context=False)]


def _schema_fault(detail: Any) -> _Fault:
    """Rephrase one of pydantic's errors: the problem and the expected value."""
    where: _Path = detail["loc"]
    known = _fields_of(where[:-1])
    if detail["type"] == "extra_forbidden":
        similar = get_close_matches(str(where[-1]), known, n=1)
        hint = f"did you mean {similar[0]}?" if similar else f"there are {', '.join(known)}"
        return _Fault(where, f"{_UNKNOWN}; {hint}")
    right = _description(where)
    match detail["type"]:
        case "missing" if isinstance(where[-1], str):
            return _Fault(where, f"is missing; expected: {right}")
        case "missing":
            return _Fault(where[:-1], f"has too few numbers; expected: {right}")
        case "too_short" | "too_long":
            message = f"has {len(detail['input'])} entries"
        case "model_type":
            message = f"should be a mapping, not {_shown(detail['input'])}"
        case "less_than_equal" | "greater_than_equal" if where[-2:] == ("pose", 2):
            message = f"is {_shown(detail['input'])}; angles are in radians, from -2 pi to 2 pi"
        case _:
            message = detail["msg"].replace("Input should be", "should be") + f", not {_shown(detail['input'])}"
    return _Fault(where, f"{message}; expected: {right}")


def _shown(value: Any) -> str:
    """Format a value of a file for a message."""
    if isinstance(value, list):
        return f"a list of {len(value)}"
    if isinstance(value, dict):
        return f"a mapping of {len(value)}"
    text = json.dumps(value, default=str)
    return text if len(text) <= 40 else f"{text[:37]}..."


def _fields_of(where: _Path) -> dict[str, str]:
    """Names and descriptions of the fields of the mapping at a path."""
    from visualrhp.scene import scene_schema

    models = {
        "target": scene_schema.TargetFields,
        "start": scene_schema.StartFields,
        "gripper": scene_schema.GripperFields,
        "objects": scene_schema.ObjectFields,
    }
    model = models.get(str(where[0]), scene_schema.SceneFields) if where else scene_schema.SceneFields
    return {field.alias or name: field.description or "" for name, field in model.model_fields.items()}


def _description(where: _Path) -> str:
    """The description of the innermost named field of a path."""
    names = [index for index, key in enumerate(where) if isinstance(key, str)]
    if not names:
        return "a mapping with target, objects and other fields"
    return _fields_of(where[: names[-1]]).get(str(where[names[-1]]), "a mapping of fields")


def _task_instance(document: _Document, fields: SceneFields) -> TaskInstance:
    polygons = [(("edges",), fields.edges, False)]
    polygons += [(("objects", number, "outline"), entry.outline, True) for number, entry in enumerate(fields.objects)]
    faults = []
    for where, vertices, solid in polygons:
        fault = polygon_fault(np.array(vertices, dtype=np.float64), solid)
        if fault is not None:
            faults.append(_Fault(where if fault.vertex is None else (*where, fault.vertex), fault.message))
    document.refuse(faults)
    edges = np.array(fields.edges, dtype=np.float64)
    position = np.array(fields.target.position, dtype=np.float64)
    if not geometry.contains(edges, *position):
        document.refuse([_Fault(("target", "position"), f"{position.tolist()} is not on the surface, within edges")])
    gripper = Gripper(**fields.gripper.model_dump())
    shapes, poses = zip(*(_placed_object(entry) for entry in fields.objects), strict=True)
    start = fields.start
    opening = start.opening if start.opening is not None else 0.0 if start.closed else gripper.stroke
    fault = gripper.opening_fault(opening)
    if fault is not None:
        document.refuse([_Fault(("start", "opening"), fault)])
    gripper_pose = _default_gripper_pose(edges) if start.pose is None else start.pose
    state = State.create(gripper_pose, opening, start.closed, poses)
    return TaskInstance(Scene(TargetRegion(position, fields.target.radius), shapes, edges, gripper), state)


def _placed_object(entry: ObjectFields) -> tuple[ObjectShape, FloatArray]:
    """An object's shape, and the pose [3] of its centre of mass in the world frame."""
    outline, pose = np.array(entry.outline, dtype=np.float64), np.array(entry.pose, dtype=np.float64)
    if np.abs(geometry.centroid(outline)).max() <= CENTRE_TOLERANCE:
        return ObjectShape(outline, entry.density, entry.friction, entry.turning_resistance), pose
    shape, centre = ObjectShape.located(outline, entry.density, entry.friction)
    shape = replace(shape, turning_resistance=entry.turning_resistance)
    return shape, np.array([*geometry.to_world(centre, pose), pose[2]])


def _default_gripper_pose(edges: FloatArray) -> FloatArray:
    """[3] inwards from the middle of the first edge, heading inwards."""
    along = (edges[1] - edges[0]) / np.hypot(*(edges[1] - edges[0]))
    inward = np.array([-along[1], along[0]])  # counter-clockwise edges have the surface on their left
    return np.array([*(0.5 * (edges[0] + edges[1]) + _START_DISTANCE * inward), np.arctan2(inward[1], inward[0])])


def _content(instance: TaskInstance) -> dict[str, Any]:
    """The instance as the plain values of a scene file, with all fields."""
    scene, state = instance.scene, instance.state
    return {
        "edges": scene.edges.tolist(),
        "target": {"position": scene.target.position.tolist(), "radius": float(scene.target.radius)},
        "start": {
            "pose": state.gripper_pose.tolist(),
            "opening": state.gripper_opening,
            "closed": state.gripper_closed,
        },
        "gripper": {name: float(value) for name, value in asdict(scene.gripper).items()},
        "objects": [
            {
                "outline": shape.outline.tolist(),
                "pose": pose.tolist(),
                "density": float(shape.density),
                "friction": float(shape.friction),
                "turning_resistance": float(shape.turning_resistance),
            }
            for shape, pose in zip(scene.objects, state.object_poses, strict=True)
        ],
    }


def _yaml(content: dict[str, Any]) -> str:
    from io import StringIO

    from ruamel.yaml import YAML

    writer = YAML(typ="safe", pure=True)
    writer.default_flow_style = None  # points and poses on one line each
    writer.sort_base_mapping_type_on_output = False  # pyright: ignore[reportAttributeAccessIssue]
    writer.width = 120
    text = StringIO()
    writer.dump(content, text)
    return _HEADER + text.getvalue()
