"""Fields of a scene file, their types and ranges. A separate module, since pydantic loads slowly."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, Strict

from visualrhp.scene.gripper import MAX_STROKE, Gripper
from visualrhp.scene.polygons import MAX_COORDINATE
from visualrhp.scene.scene import MAX_DENSITY, MAX_FRICTION, ObjectShape, TargetRegion, square_edges

Coordinate = Annotated[float, Field(ge=-MAX_COORDINATE, le=MAX_COORDINATE, allow_inf_nan=False)]
Angle = Annotated[float, Field(ge=-2.0 * math.pi, le=2.0 * math.pi, allow_inf_nan=False)]
Length = Annotated[float, Field(gt=0.0, le=MAX_COORDINATE, allow_inf_nan=False)]
Point = Annotated[tuple[Coordinate, Coordinate], Strict(False)]
Pose = Annotated[tuple[Coordinate, Coordinate, Angle], Strict(False)]
Polygon = Annotated[list[Point], Field(min_length=3)]

_GRIPPER = Gripper()


class Fields(BaseModel):
    """A mapping in a scene file, without additional keys or quoted numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class TargetFields(Fields):
    """The disc into which the desired object is to be moved."""

    position: Point = Field(description="centre (x, y) [m], on the surface")
    radius: Length = Field(TargetRegion.radius, description="radius [m]")


class StartFields(Fields):
    """The gripper at the start."""

    pose: Pose | None = Field(
        None,
        description="gripper frame (x [m], y [m], theta [rad]); by default 3 cm inwards from the "
        "middle of the first edge, heading inwards",
    )
    opening: Annotated[float, Field(ge=0.0, le=MAX_STROKE, allow_inf_nan=False)] | None = Field(
        None, description="between the fingers [m]; by default the stroke, or 0 if closed"
    )
    closed: bool = Field(False, description="whether the gripper was last commanded to close: true or false")


class ObjectFields(Fields):
    """A rigid object."""

    outline: Polygon = Field(
        description="vertices (x, y) [m] in a frame of the object, counter-clockwise, a simple polygon, the "
        "first vertex not repeated"
    )
    pose: Pose = Field(
        (0.0, 0.0, 0.0), description="frame of the outline (x [m], y [m], theta [rad]) in the world frame"
    )
    density: Annotated[float, Field(gt=0.0, le=MAX_DENSITY, allow_inf_nan=False)] = Field(
        ObjectShape.density, description="mass per area [kg/m^2]"
    )
    friction: Annotated[float, Field(gt=0.0, le=MAX_FRICTION, allow_inf_nan=False)] = Field(
        ObjectShape.friction, description="Coulomb coefficient"
    )
    turning_resistance: Annotated[float, Field(gt=0.0, le=10.0, allow_inf_nan=False)] = Field(
        ObjectShape.turning_resistance,
        description="torque with which the surface resists turning, relative to that of uniform pressure",
    )


class GripperFields(Fields):
    """Geometry of palm and fingers, by default that of a Robotiq 2F-85."""

    stroke: Annotated[float, Field(gt=0.0, le=MAX_STROKE, allow_inf_nan=False)] = Field(
        _GRIPPER.stroke, description="largest opening [m]"
    )
    finger_reach: Length = Field(_GRIPPER.finger_reach, description="x of the fingertips in the gripper frame [m]")
    finger_length: Length = Field(_GRIPPER.finger_length, description="from the palm to the fingertips [m]")
    finger_thickness: Length = Field(_GRIPPER.finger_thickness, description="lateral [m]")
    palm_length: Length = Field(_GRIPPER.palm_length, description="longitudinal [m]")
    palm_front_width: Length = Field(_GRIPPER.palm_front_width, description="width of the palm at the fingers [m]")
    palm_back_width: Length = Field(_GRIPPER.palm_back_width, description="width of the palm at the wrist [m]")


class SceneFields(Fields):
    """A scene and the state from which a task starts. SI units, radians, world frame: x right, y up."""

    schema_: str | None = Field(None, alias="$schema", description="where editors find the schema; ignored")
    description: str | None = Field(None, description="what the scene shows; ignored")
    edges: Polygon = Field(
        [(x, y) for x, y in square_edges(0.5).tolist()],
        description="vertices (x, y) [m] of the surface in the world frame, counter-clockwise, a simple polygon",
    )
    target: TargetFields = Field(description="target region: position and radius")
    start: StartFields = Field(StartFields(), description="gripper at the start: pose, opening, closed")  # pyright: ignore[reportCallIssue]
    gripper: GripperFields = Field(GripperFields(), description="geometry of the gripper")  # pyright: ignore[reportCallIssue]
    objects: Annotated[list[ObjectFields], Field(min_length=1)] = Field(
        description="the desired object first, then the obstacles"
    )
