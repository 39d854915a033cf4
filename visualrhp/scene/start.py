"""Validation of initial states that come from outside the library."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import shapely

from visualrhp.errors import SceneError
from visualrhp.scene import geometry
from visualrhp.scene.polygons import MAX_COORDINATE
from visualrhp.scene.scene import Scene
from visualrhp.types import Column, State

MAX_START_OVERLAP = 2e-3
"""Largest penetration of two bodies at the start [m], which jams between the fingers can cause."""


_MOST_SHOWN = 8
_MOST_OVERLAPS = 100


class StartFault(NamedTuple):
    """A defect of an initial state.

    Attributes:
        where: path of the field in a scene file, such as ("objects", 2, "pose").
        message: the problem and the expected value.
    """

    where: tuple[str | int, ...]
    message: str


def check_start(scene: Scene, state: State) -> None:
    """Check that ``scene`` can be simulated from ``state``.

    A state that the simulator returned passes, unless it dropped an object.

    Raises:
        SceneError: the number of objects is not that of the scene, a number is not finite, the commanded gripper state
            is neither 0 nor 1, the opening is outside [0, stroke], an object's centre is outside the edges, or two
            bodies (including the gripper) penetrate each other by more than :data:`MAX_START_OVERLAP`. The
            message has one line for each of the first faults.
    """
    faults = list(start_faults(scene, state))
    if faults:
        lines = [f"{field_path(fault.where)}: {fault.message}" for fault in faults[:_MOST_SHOWN]]
        if len(faults) > _MOST_SHOWN:
            lines.append(f"... and {len(faults) - _MOST_SHOWN} more faults")
        raise SceneError("\n".join(lines))


def start_faults(scene: Scene, state: State) -> Iterator[StartFault]:
    """The faults that :func:`check_start` reports; of many overlaps, the first."""
    if state.num_objects != scene.num_objects:
        yield StartFault(("objects",), f"the state has {state.num_objects} objects and the scene {scene.num_objects}")
        return
    named = [(("start", "pose"), state.gripper_pose)]
    named += [(("objects", number, "pose"), pose) for number, pose in enumerate(state.object_poses)]
    lost = [
        StartFault(where, f"is {pose.tolist()}; a pose is three finite numbers, the place within {MAX_COORDINATE:g} m")
        for where, pose in named
        if not (np.isfinite(pose).all() and np.abs(pose[:2]).max() <= MAX_COORDINATE)
    ]
    yield from lost
    closed, fault = float(state.vector[Column.CLOSED]), scene.gripper.opening_fault(state.gripper_opening)
    if closed not in (0.0, 1.0):
        yield StartFault(("start", "closed"), f"is {closed}; it is 1 (closed) or 0 (open)")
    if fault is not None:
        yield StartFault(("start", "opening"), fault)
    elif not lost:
        yield from _misplaced(scene, state)
        yield from _overlapping(scene, state)


def _misplaced(scene: Scene, state: State) -> Iterator[StartFault]:
    on_surface = geometry.contains_each(scene.edges, state.object_positions)
    for number, (x, y) in enumerate(state.object_positions.tolist()):
        if not on_surface[number]:
            message = f"puts the centre of mass of objects[{number}] at ({x:.4g}, {y:.4g}), which is not on the surface"
            yield StartFault(("objects", number, "pose"), message)


def _overlapping(scene: Scene, state: State) -> Iterator[StartFault]:
    """Pairs of bodies that overlap even when the border of each is moved inwards by half the tolerance."""
    placed = zip(scene.objects, state.object_poses, strict=True)
    outlines = [geometry.to_world(shape.outline, pose) for shape, pose in placed]
    outlines += scene.gripper.outlines(state.gripper_pose, state.gripper_opening)
    bodies = np.array([shapely.Polygon(outline) for outline in outlines])
    count = scene.num_objects
    names = [f"objects[{number}]" for number in range(count)] + ["the palm", "the left finger", "the right finger"]
    pairs = shapely.STRtree(bodies).query(bodies, predicate="intersects").T
    pairs = pairs[(pairs[:, 0] < pairs[:, 1]) & (pairs[:, 0] < count)]  # parts of the gripper may touch each other
    cores, involved = bodies.copy(), np.unique(pairs)
    cores[involved] = shapely.buffer(bodies[involved], -0.5 * MAX_START_OVERLAP)
    pairs = pairs[shapely.intersects(cores[pairs[:, 0]], cores[pairs[:, 1]])]
    for a, b in sorted(pairs.tolist())[:_MOST_OVERLAPS]:
        x, y = shapely.get_coordinates(shapely.centroid(shapely.intersection(bodies[a], bodies[b])))[0]
        message = (
            f"objects[{a}] and {names[b]} overlap around ({x:.3f}, {y:.3f}) by more than "
            f"{1e3 * MAX_START_OVERLAP:g} mm; move them apart"
        )
        yield StartFault(("objects", b if b < count else a, "pose"), message)


def field_path(where: tuple[str | int, ...]) -> str:
    """The path of a field as written in messages: objects[2].pose."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in where).lstrip(".")
