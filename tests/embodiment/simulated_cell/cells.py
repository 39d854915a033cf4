"""Objects and cells that the tests share."""

from __future__ import annotations

from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.simulated_cell.cell import SimulatedCell
from visualrhp.embodiment.simulated_cell.objects import CellObject
from visualrhp.embodiment.simulated_cell.solids import bottle, box, cup, fruit
from visualrhp.embodiment.simulated_cell.task import CellTask

APPLE = CellObject(Kind.APPLE, fruit(0.034, 0.9), mass=0.13)
ORANGE = CellObject(Kind.ORANGE, fruit(0.036), mass=0.18)
CUP = CellObject(Kind.CUP, cup(0.09, 0.038), mass=0.15)
BOTTLE = CellObject(Kind.BOTTLE, bottle(0.032, 0.18), mass=0.3)
LYING_BOTTLE = CellObject(Kind.BOTTLE, bottle(0.032, 0.18), is_lying=True, mass=0.3)
BOX = CellObject(Kind.BOX, box(0.035, 0.025, 0.07), mass=0.2)
EVERYTHING = (APPLE, ORANGE, CUP, BOTTLE, LYING_BOTTLE, BOX)


def cell_of(
    *things: tuple[CellObject, tuple[float, float, float]],
    gripper: tuple[float, float, float] = (-0.15, 0.0, 0.0),
    render: bool = False,
) -> SimulatedCell:
    """A cell with objects at (x, y, yaw)."""
    objects, poses = zip(*things, strict=True)
    return SimulatedCell(CellTask(objects, poses, gripper_pose=gripper), render=render)
