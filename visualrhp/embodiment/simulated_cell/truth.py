"""The true scene and state of a simulated cell, as the planner's model would have them without a camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely

from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.outlines import planner_outline
from visualrhp.embodiment.robot_model import CELL_GRIPPER
from visualrhp.embodiment.simulated_cell.task import TABLE_SIDE, CellTask
from visualrhp.scene.scene import ObjectShape, Scene, square_edges
from visualrhp.types import FloatArray, State

FALLEN_BELOW: Final = -0.005
"""An object whose middle is below this height [m] has fallen off the table."""

_OUTSIDE: Final = 0.02  # how far outside the edges a fallen object counts at least [m]


@dataclass(frozen=True)
class GroundTruth:
    """What is true of a cell.

    Attributes:
        scene: the target, and objects with outlines as seen vertically from above in their present orientation, in
            world axes (their angles in the state are 0), with nominal density and friction.
        state: gripper pose by the arm's joints, opening of the fingers, and centres of the outlines. The position of an
            object that fell off the table is outside the edges, even if it rolled below the table.
        outlines: of every object, exact to 0.3 mm [V, 2], in the world frame.
        kinds: of every object.
        is_lying: whether it lies on its side.
        is_fallen: whether it fell off the table.
    """

    scene: Scene
    state: State
    outlines: tuple[FloatArray, ...]
    kinds: tuple[Kind, ...]
    is_lying: tuple[bool, ...]
    is_fallen: tuple[bool, ...]


def ground_truth(
    task: CellTask,
    positions: FloatArray,
    rotations: FloatArray,
    gripper_pose: FloatArray,
    opening: float,
    is_closed: bool,
) -> GroundTruth:
    """The true scene and state.

    Args:
        task: what the cell contains.
        positions: [m, 3] of the body frames [m], world frame.
        rotations: [m, 3, 3] of the body frames.
        gripper_pose: [3] of the gripper frame.
        opening: of the fingers [m].
        is_closed: whether the gripper was commanded to close.
    """
    outlines, shapes, poses, fallen = [], [], [], []
    for thing, position, rotation in zip(task.objects, positions, rotations, strict=True):
        outline = thing.solid.silhouette(rotation) + position[:2]
        shape, centre = ObjectShape.located(planner_outline(shapely.Polygon(outline)))
        is_fallen = bool(position[2] < FALLEN_BELOW)
        shift = _outside(centre) - centre if is_fallen else np.zeros(2)
        outlines.append(outline + shift)
        shapes.append(shape)
        poses.append([*(centre + shift), 0.0])
        fallen.append(is_fallen)
    opening = min(max(opening, 0.0), CELL_GRIPPER.stroke)
    return GroundTruth(
        Scene(task.target, tuple(shapes), square_edges(TABLE_SIDE), CELL_GRIPPER),
        State.create(gripper_pose, opening, is_closed, poses),
        tuple(outlines),
        tuple(thing.kind for thing in task.objects),
        tuple(thing.lies(rotation) for thing, rotation in zip(task.objects, rotations, strict=True)),
        tuple(fallen),
    )


def _outside(position: FloatArray) -> FloatArray:
    """``position`` [2], or if it is within the table's edges, the nearest one outside."""
    limit = 0.5 * TABLE_SIDE + _OUTSIDE
    if np.abs(position).max() >= limit:
        return position
    axis = int(np.abs(position).argmax())
    moved = position.copy()
    moved[axis] = np.copysign(limit, position[axis])
    return moved
