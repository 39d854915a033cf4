"""Task instances in YAML or JSON files, for user-defined scenes (docs/scenes.md describes every field).

A file is read in three passes: syntax (with line and column of every value), fields against the schema of
:mod:`visualrhp.scene.scene_schema`, and geometry. Each pass reports all errors that it finds, with line and field.

An object's outline may be drawn in any frame, and its pose is the pose of that frame. An outline whose centre of mass
is at the origin of its frame, as in :class:`ObjectShape`, is read without change.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import asdict, replace
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from visualrhp.errors import SceneError
from visualrhp.files import write_text
from visualrhp.scene import geometry
from visualrhp.scene.contours import MAX_VERTICES
from visualrhp.scene.gripper import Gripper
from visualrhp.scene.polygons import polygon_fault
from visualrhp.scene.scene import CENTRE_TOLERANCE, ObjectShape, Scene, TargetRegion, TaskInstance
from visualrhp.scene.scene_document import (
    MAX_BYTES,
    MOST_FAULTS,
    Fault,
    SceneDocument,
    Where,
    fault_lines,
    shortened,
    worded,
)
from visualrhp.scene.start import field_path, start_faults
from visualrhp.types import FloatArray, State

if TYPE_CHECKING:
    from visualrhp.scene.scene_schema import ObjectFields, SceneFields

MAX_OBJECTS = 500
"""Largest number of objects in a scene file."""

_SUFFIXES = (".yaml", ".yml", ".json")
_HEADER = (
    "# Task instance of visualrhp. SI units, radians; world frame: x right, y up. The desired object comes first.\n"
)
_START_DISTANCE = 0.03
_MAX_VERTICES = 20_000  # of all outlines of a scene file together


def load_task_instance(path: str | os.PathLike[str]) -> TaskInstance:
    """Read a scene and its initial state from a YAML or JSON file, by its suffix.

    Raises:
        SceneError: the file cannot be read, is not YAML or JSON, does not follow the schema, or cannot be simulated (a
            degenerate polygon, an overlapping start, an object off the surface). Each line of the message starts with
            file, line, column and field; of many faults, the first are shown.
    """
    source = Path(path)
    document = SceneDocument(source, _read(source))
    fields = _validated(document)
    instance = _task_instance(document, fields)
    document.refuse([Fault(*fault) for fault in start_faults(instance.scene, instance.state)])
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
    faults = [*_schema_faults(content)[1], *(Fault(*fault) for fault in start_faults(instance.scene, instance.state))]
    start = f"{shortened(str(destination), 200)}: not written, since it could not be read again"
    if faults:
        lines = [f"{field_path(fault.where)}: {shortened(fault.message)}" for fault in faults]
        raise SceneError(fault_lines([start, *lines]))
    text = json.dumps(content, indent=2) + "\n" if destination.suffix == ".json" else _yaml(content)
    if len(text) > MAX_BYTES:
        raise SceneError(f"{start}: it would have {len(text)} characters, and at most {MAX_BYTES} are read")
    if destination.suffix != ".json":
        SceneDocument(destination, text)  # which has not too many values for YAML
    write_text(destination, text)


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
    name = shortened(str(source), 200)
    try:
        if source.exists() and not source.is_file():
            raise SceneError(f"{name}: is a folder or a device; it should be a scene file")
        with source.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
        if len(data) > MAX_BYTES:
            raise SceneError(
                f"{name}: has more than {MAX_BYTES} bytes; it should be a scene file, whose outlines have under 100 "
                "vertices each (ObjectShape.from_contour reduces their number)"
            )
        return data.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except (OSError, ValueError) as error:
        if isinstance(error, UnicodeDecodeError):
            raise SceneError(f"{name}: is not text in UTF-8 ({error}); it should be a scene file") from error
        reason = (error.strerror if isinstance(error, OSError) else None) or error
        raise SceneError(f"{name}: cannot be read ({reason}); it should be a scene file") from error


def _validated(document: SceneDocument) -> SceneFields:
    document.refuse(list(_size_faults(document.content)))
    fields, faults = _schema_faults(document.content)
    document.refuse(faults)
    assert fields is not None
    return fields


def _size_faults(content: Any) -> Iterator[Fault]:
    """What would take long to check: a text with aliases can hold more values than it has characters."""
    if not isinstance(content, dict):
        return
    objects = content.get("objects")
    objects = objects if isinstance(objects, list) else []
    if len(objects) > MAX_OBJECTS:
        yield Fault(("objects",), f"has {len(objects)} entries; at most {MAX_OBJECTS} objects are possible")
        return
    polygons = [(("edges",), content.get("edges"))]
    polygons += [
        (("objects", number, "outline"), entry.get("outline"))
        for number, entry in enumerate(objects)
        if isinstance(entry, dict)
    ]
    lengths = [(where, len(polygon)) for where, polygon in polygons if isinstance(polygon, list)]
    total = sum(length for _, length in lengths)
    for where, length in lengths:
        if length > MAX_VERTICES:
            yield Fault(
                where,
                f"has {length} vertices; at most {MAX_VERTICES} are possible, and under 100 are fast to simulate: "
                "ObjectShape.from_contour(points, tolerance) reduces their number",
            )
            return
    if total > _MAX_VERTICES:
        yield Fault(("objects",), f"has {total} vertices in all outlines; at most {_MAX_VERTICES} are possible")


_UNKNOWN = "is not a field"


def _schema_faults(content: Any) -> tuple[SceneFields | None, list[Fault]]:
    """The fields, or their faults; only the first are put into words."""
    from pydantic import ValidationError

    from visualrhp.scene.scene_schema import SceneFields

    try:
        return SceneFields.model_validate(content), []
    except ValidationError as error:
        details = error.errors(include_url=False, include_context=False)
        return None, [
            _schema_fault(detail) if worded(number, len(details)) else Fault(detail["loc"], "is wrong, too")
            for number, detail in enumerate(details)
        ]


def _schema_fault(detail: Any) -> Fault:
    """Rephrase one of pydantic's errors: the problem and the expected value."""
    where: Where = detail["loc"]
    known = _fields_of(where[:-1])
    if detail["type"] == "extra_forbidden":
        similar = get_close_matches(str(where[-1])[:60], known, n=1)
        hint = f"did you mean {similar[0]}?" if similar else f"there are {', '.join(known)}"
        return Fault(where, f"{_UNKNOWN}; {hint}", at_key=True)
    right = _description(where)
    match detail["type"]:
        case "missing" if isinstance(where[-1], str):
            return Fault(where, f"is missing; expected: {right}")
        case "missing":
            return Fault(where[:-1], f"has too few numbers; expected: {right}")
        case "too_short" | "too_long":
            message = f"has {len(detail['input'])} entries"
        case "model_type":
            message = f"should be a mapping, not {_shown(detail['input'])}"
        case "less_than_equal" | "greater_than_equal" if where[-2:] == ("pose", 2):
            message = f"is {_shown(detail['input'])}; angles are in radians, from -2 pi to 2 pi"
        case _:
            message = detail["msg"].replace("Input should be", "should be") + f", not {_shown(detail['input'])}"
    return Fault(where, f"{message}; expected: {right}")


def _shown(value: Any) -> str:
    """Format a value of a file for a message."""
    if isinstance(value, list):
        return f"a list of {len(value)}"
    if isinstance(value, dict):
        return f"a mapping of {len(value)}"
    try:
        text = json.dumps(value[:60] if isinstance(value, str) else value, default=str)
    except ValueError:  # an integer of thousands of digits
        return "a very large number"
    return text if len(text) <= 40 else f"{text[:37]}..."


def _fields_of(where: Where) -> dict[str, str]:
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


def _description(where: Where) -> str:
    """The description of the innermost named field of a path."""
    names = [index for index, key in enumerate(where) if isinstance(key, str)]
    if not names:
        return "a mapping with target, objects and other fields"
    return _fields_of(where[: names[-1]]).get(str(where[names[-1]]), "a mapping of fields")


def _task_instance(document: SceneDocument, fields: SceneFields) -> TaskInstance:
    polygons = [(("edges",), fields.edges, False)]
    polygons += [(("objects", number, "outline"), entry.outline, True) for number, entry in enumerate(fields.objects)]
    faults = []
    for where, vertices, solid in polygons:
        if len(faults) > MOST_FAULTS:
            break
        fault = polygon_fault(np.array(vertices, dtype=np.float64), solid)
        if fault is not None:
            faults.append(Fault(where if fault.vertex is None else (*where, fault.vertex), fault.message))
    document.refuse(faults)
    edges = np.array(fields.edges, dtype=np.float64)
    position = np.array(fields.target.position, dtype=np.float64)
    if not geometry.contains(edges, *position):
        document.refuse([Fault(("target", "position"), f"{position.tolist()} is not on the surface, within edges")])
    gripper = Gripper(**fields.gripper.model_dump())
    shapes, poses = zip(*(_placed_object(entry) for entry in fields.objects), strict=True)
    start = fields.start
    opening = start.opening if start.opening is not None else 0.0 if start.closed else gripper.stroke
    fault = gripper.opening_fault(opening)
    if fault is not None:
        document.refuse([Fault(("start", "opening"), fault)])
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
