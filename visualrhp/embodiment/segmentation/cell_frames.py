"""Frames of the simulated cell, with labels: from random cells, in which the arm moves about between the frames."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt
import shapely

from visualrhp.embodiment.kinematics import ArmKinematics
from visualrhp.embodiment.robot_cell import JointTrajectory
from visualrhp.embodiment.robot_model import CELL_GRIPPER
from visualrhp.embodiment.segmentation.classes import BACKGROUND, class_of
from visualrhp.embodiment.segmentation.configs import FrameSampling
from visualrhp.embodiment.segmentation.frames import FIRST_INSTANCE, LabelledFrames, Region, join, labelled_frame
from visualrhp.embodiment.segmentation.scores import SeenObject
from visualrhp.embodiment.simulated_cell.cell import MIN_VISIBLE_PIXELS, ROBOT, SimulatedCell
from visualrhp.embodiment.simulated_cell.sampling import CellDistribution, sample_cell
from visualrhp.embodiment.simulated_cell.task import TABLE_SIDE, CellTask
from visualrhp.errors import SimulationError, UnreachableError
from visualrhp.scene.scene import TargetRegion
from visualrhp.simulation.action_spaces import MAX_ROTATION, MAX_TRANSLATION, GripperMotion
from visualrhp.streams import Split, Stream, generator_for

REQUIRED_SHARE: Final = 0.5
WHOLE_SHARE: Final = 0.95
"""Visible pixels, as a share of those of the object's outline on the table, which are a little fewer than all of it."""

_MOST_TOUCHING: Final = 3
"""Pixels of an object beside those of the robot, from which the robot may hide a part of it."""

_ATTEMPTS: Final = 20
"""Motions that are drawn until the arm can make one."""

_ROBOT_LABEL: Final = 1


def generate_frames(
    cells: Iterable[int], distribution: CellDistribution, sampling: FrameSampling, seed: int, split: Split
) -> LabelledFrames:
    """The frames of the cells with these indices; a function of the arguments.

    Raises:
        ConfigError: no cell was found, the robot's packages are not installed, or there is no OpenGL library.
    """
    parts = []
    for index in cells:
        generator = generator_for(seed, split, index, Stream.FRAMES)
        for cell in visits(index, distribution, sampling, seed, split):
            image = cell.frame().image
            instances, classes = labels_of(cell)
            region = Region.centred(*image.shape[:2])
            parts.append(labelled_frame(image, instances, classes, region, generator))
    return join(parts)


def visits(
    index: int, distribution: CellDistribution, sampling: FrameSampling, seed: int, split: Split
) -> Iterator[SimulatedCell]:
    """Yield a cell each time that a frame is to be taken; it is closed at the end.

    If the physics diverges, which happens when bodies are wedged, the frames so far are all.
    """
    generator = generator_for(seed, split, index, Stream.FRAMES)
    task = sample_cell(distribution, seed, split, index)
    if generator.random() < sampling.on_target:
        task = _with_object_on_target(task, generator)
    cell = SimulatedCell(task)
    kinematics = ArmKinematics(cell.task.mounting)
    try:
        for number in range(sampling.frames_per_cell):
            if number:
                _move_about(cell, kinematics, sampling, generator)
            yield cell
    except SimulationError:
        return
    finally:
        cell.close()


def labels_of(cell: SimulatedCell) -> tuple[npt.NDArray[np.uint8], list[int]]:
    """(label of each pixel, class of each object), as in :func:`labelled_frame`."""
    mask = cell.instance_mask()
    truth = cell.truth()
    instances = np.where(mask >= 0, mask + FIRST_INSTANCE, 0)
    instances[mask == ROBOT] = _ROBOT_LABEL
    rows = zip(truth.kinds, truth.is_lying, truth.is_fallen, strict=True)
    return instances.astype(np.uint8), [BACKGROUND if fallen else class_of(kind, lies) for kind, lies, fallen in rows]


def seen_objects(cell: SimulatedCell) -> list[SeenObject]:
    """The objects on the table that the camera sees.

    An object must be found if at least :data:`REQUIRED_SHARE` of its area is seen. Its outline is compared if all of it
    is seen: :data:`WHOLE_SHARE` of its area, none of it beside the robot or at the border of the image.
    """
    mask, truth = cell.instance_mask(), cell.truth()
    beside = np.ones(mask.shape, np.uint8)
    beside[1:-1, 1:-1] = mask[1:-1, 1:-1] == ROBOT
    beside = cv2.dilate(beside, np.ones((3, 3), np.uint8)) > 0
    found = []
    for number, outline in enumerate(truth.outlines):
        visible = mask == number
        if truth.is_fallen[number] or np.count_nonzero(visible) < MIN_VISIBLE_PIXELS:
            continue
        polygon = shapely.Polygon(outline)
        share = np.count_nonzero(visible) / max(1.0, _pixels_of(cell, polygon))
        found.append(
            SeenObject(
                truth.kinds[number],
                truth.is_lying[number],
                visible,
                polygon,
                is_required=bool(share >= REQUIRED_SHARE),
                is_whole=bool(share >= WHOLE_SHARE and np.count_nonzero(visible & beside) <= _MOST_TOUCHING),
            )
        )
    return found


def _pixels_of(cell: SimulatedCell, outline: shapely.Polygon) -> float:
    """Number of pixels of an outline on the table."""
    ring = shapely.get_coordinates(outline.exterior)
    points = np.column_stack([ring, np.zeros(len(ring))])
    return float(shapely.Polygon(cell.camera.project(points)).area)


def _with_object_on_target(task: CellTask, generator: np.random.Generator) -> CellTask:
    """The same cell with its target region below one of its objects, within the edges."""
    radius = task.target.radius
    place = task.poses[int(generator.integers(len(task.objects))), :2]
    limit = 0.5 * TABLE_SIDE - radius
    position = np.clip(place + generator.normal(0.0, 0.5 * radius, 2), -limit, limit)
    return replace(task, target=TargetRegion(position, radius))


def _move_about(
    cell: SimulatedCell, kinematics: ArmKinematics, sampling: FrameSampling, generator: np.random.Generator
) -> None:
    for _ in range(int(generator.integers(1, sampling.motions + 1))):
        if generator.random() < sampling.grasp:
            cell.move_gripper(float(generator.choice([0.0, CELL_GRIPPER.stroke])))
        trajectory = _random_path(cell, kinematics, generator)
        if trajectory is not None:
            cell.follow(trajectory)
            cell.wait(trajectory.duration)
    cell.stop()
    cell.wait(sampling.settle_s)


def _random_path(
    cell: SimulatedCell, kinematics: ArmKinematics, generator: np.random.Generator
) -> JointTrajectory | None:
    """A random motion that the arm can make; forwards more often than backwards, since that is where objects are."""
    joints = cell.arm().positions
    for _ in range(_ATTEMPTS):
        motion = GripperMotion(
            forward=float(generator.uniform(-0.5, 1.0)) * MAX_TRANSLATION,
            left=float(generator.uniform(-1.0, 1.0)) * MAX_TRANSLATION,
            rotation=float(generator.uniform(-1.0, 1.0)) * MAX_ROTATION,
        )
        try:
            return kinematics.path(joints, motion)
        except UnreachableError:
            continue
    return None
