"""The fields of a scene file: defaults, ranges and types, and what the schema says about them."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import pytest
from pydantic import ValidationError

from visualrhp.scene import Gripper, ObjectShape, scene_file_schema
from visualrhp.scene.gripper import MAX_STROKE
from visualrhp.scene.scene_schema import GripperFields, SceneFields

OUTLINE = [[0, 0], [0.04, 0], [0.04, 0.04]]


def content(**fields: Any) -> dict[str, Any]:
    """The least that a scene file holds, with ``fields`` instead."""
    return {"target": {"position": [0.1, 0.1]}, "objects": [{"outline": OUTLINE}]} | fields


def an_object(**fields: Any) -> dict[str, Any]:
    return content(objects=[{"outline": OUTLINE} | fields])


def test_defaults_are_those_of_the_classes() -> None:
    fields = SceneFields.model_validate(content())
    assert fields.gripper.model_dump() == asdict(Gripper())
    assert (fields.objects[0].density, fields.objects[0].friction) == (ObjectShape.density, ObjectShape.friction)
    assert fields.objects[0].pose == (0.0, 0.0, 0.0)
    assert (fields.start.pose, fields.start.opening, fields.start.closed) == (None, None, False)


def test_integers_are_numbers_and_lists_are_points() -> None:
    fields = SceneFields.model_validate(an_object(pose=[0, 1, 2], density=2))
    assert fields.objects[0].pose == (0.0, 1.0, 2.0) and fields.objects[0].density == 2.0
    assert fields.objects[0].outline == [(0.0, 0.0), (0.04, 0.0), (0.04, 0.04)]


@pytest.mark.parametrize(
    ("given", "place"),
    [
        (content(targets={}), ("targets",)),
        (content(target={}), ("target", "position")),
        (content(target={"position": [0.1, 0.1], "radius": 0.0}), ("target", "radius")),
        (content(target={"position": [0.1, 0.1, 0.1]}), ("target", "position")),
        (content(target={"position": [0.1, "0.1"]}), ("target", "position", 1)),
        (content(start={"closed": 1}), ("start", "closed")),
        (content(start={"opening": -1e-9}), ("start", "opening")),
        (content(start={"opening": MAX_STROKE + 1e-9}), ("start", "opening")),
        (content(start={"pose": [0.0, 0.0, 6.3]}), ("start", "pose", 2)),
        (content(start={"pose": [0.0, 0.0, -6.3]}), ("start", "pose", 2)),
        (content(start={"pose": [0.0, 0.0, math.nan]}), ("start", "pose", 2)),
        (content(gripper={"stroke": MAX_STROKE + 1e-9}), ("gripper", "stroke")),
        (content(gripper={"palm_length": 0.0}), ("gripper", "palm_length")),
        (content(edges=[[0, 0], [1, 0]]), ("edges",)),
        (content(objects=[]), ("objects",)),
        (an_object(outline=OUTLINE[:2]), ("objects", 0, "outline")),
        (an_object(outline=[[0, 0], [100.1, 0], [1, 1]]), ("objects", 0, "outline", 1, 0)),
        (an_object(pose=[0.0, 0.0]), ("objects", 0, "pose", 2)),
        (an_object(density=0.0), ("objects", 0, "density")),
        (an_object(density=1e5), ("objects", 0, "density")),
        (an_object(friction=10.1), ("objects", 0, "friction")),
        (an_object(friction=True), ("objects", 0, "friction")),
        (an_object(mass=1.0), ("objects", 0, "mass")),
    ],
)
def test_a_fault_is_found_where_it_is(given: dict[str, Any], place: tuple[str | int, ...]) -> None:
    with pytest.raises(ValidationError) as caught:
        SceneFields.model_validate(given)
    assert [error["loc"] for error in caught.value.errors()] == [place]


def test_the_limits_themselves_are_allowed() -> None:
    SceneFields.model_validate(content(start={"opening": MAX_STROKE, "pose": [100.0, -100.0, 2.0 * math.pi]}))
    SceneFields.model_validate(content(start={"opening": 0.0}, gripper={"stroke": MAX_STROKE}))
    SceneFields.model_validate(an_object(density=1e4, friction=10.0))


def test_a_schema_and_a_description_are_ignored() -> None:
    given = content(description="a box") | {"$schema": "scene.schema.json"}
    plain = SceneFields.model_validate(content()).model_dump(exclude={"schema_", "description"})
    assert SceneFields.model_validate(given).model_dump(exclude={"schema_", "description"}) == plain


def test_fields_come_back_from_their_json() -> None:
    fields = SceneFields.model_validate(an_object(pose=[1 / 3, -1e-17, 2.5]))
    assert SceneFields.model_validate_json(fields.model_dump_json(by_alias=True)) == fields


def test_the_gripper_has_a_field_for_every_length() -> None:
    assert list(GripperFields.model_fields) == list(Gripper.__slots__)


def test_every_field_is_described_and_no_other_is_allowed() -> None:
    schema = scene_file_schema()
    for group in (schema, *schema["$defs"].values()):
        assert group["additionalProperties"] is False
        assert all(field["description"] for field in group["properties"].values())
    lengths = schema["$defs"]["GripperFields"]["properties"].values()
    assert all("[m]" in field["description"] for field in lengths)
