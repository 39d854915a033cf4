"""Perception of the robot cell: an image and joints to scene and state, by its parts.

The segmentation network beside all the other parts together, which are given the true masks.
"""

from __future__ import annotations

from tests.benchmarks.timing import Effort, Stopwatch, numbered, show_time, show_title, side_by_side, timed
from visualrhp.embodiment.desired import DesiredObject
from visualrhp.embodiment.kinematics import ArmKinematics
from visualrhp.embodiment.perception import FrameChecks, Perception, PerceptionParameters
from visualrhp.embodiment.robot_cell import CameraFrame
from visualrhp.embodiment.segmentation.detection import Segmenter
from visualrhp.embodiment.segmentation.onnx_segmenter import OnnxSegmenter
from visualrhp.embodiment.simulated_cell.cell import SimulatedCell
from visualrhp.embodiment.simulated_cell.sampling import CellDistribution, sample_cell
from visualrhp.embodiment.true_state import TrueSegmenter
from visualrhp.streams import Split

SETTINGS = PerceptionParameters(frames=FrameChecks(refuse_repeated=False))


def _perceiving(cell: SimulatedCell, segmenter: Segmenter, views: int) -> Stopwatch:
    """The mean CPU time of a view after the first one [s]."""
    desired = DesiredObject(cell.task.objects[0].kind)
    perception = Perception(cell.camera, segmenter, ArmKinematics(), desired, settings=SETTINGS)
    image, arm, gripper = cell.frame().image, cell.arm(), cell.gripper()
    number = 0

    def view() -> None:
        nonlocal number
        number += 1
        perception.perceive(CameraFrame(image, float(number)), arm, gripper, False)

    view()  # it searches for the target

    return timed(view, views)


def run(effort: Effort) -> None:
    show_title("Perception of the robot cell (CPU time)")
    network = OnnxSegmenter()
    for num_objects in (1, 4, 7):
        cell = SimulatedCell(sample_cell(CellDistribution(num_objects=(num_objects,) * 2), 0, Split.TUNING, 0))
        detections, image = cell.detections(), cell.frame().image
        times = side_by_side(
            [
                timed(lambda image=image: network.segment(image), effort.motions),
                _perceiving(cell, TrueSegmenter(lambda found=detections: found), effort.motions),
            ],
            effort.repetitions,
        )
        for name, measured in zip(("segmentation", "all but segmentation"), times, strict=True):
            show_time(f"{name}, {numbered(num_objects, 'object')}", measured)
        cell.close()
