"""The configuration of the execution phase: cells, segmenters, limits of the robot, and its pipelines."""

from __future__ import annotations

from typing import Annotated, Literal

from pipelines.config.common import PipelineConfig, Seed
from pipelines.config.groups import PlannerConfig
from pipelines.config.stages import check_name
from visualrhp.embodiment.desired import Place
from visualrhp.embodiment.kinds import Kind
from visualrhp.embodiment.looking import LookLimits
from visualrhp.embodiment.motion import MotionLimits
from visualrhp.embodiment.robot_model import Mounting
from visualrhp.embodiment.simulated_cell.sampling import CellDistribution
from visualrhp.embodiment.simulated_cell.scenarios import SCENARIOS
from visualrhp.embodiment.trajectories import MotionParameters
from visualrhp.embodiment.ur_rtde_cell import UrRtdeParameters
from visualrhp.embodiment.watchdog import WatchdogLimits
from visualrhp.parameters import Count, Field, Index, NonNegative, parameters
from visualrhp.simulation.physics import Physics


@parameters(kw_only=True)
class SimulatedCellConfig(CellDistribution):
    """Group ``cell``: random cells in MuJoCo."""

    name: Literal["simulated"]


@parameters(kw_only=True)
class UrRtdeCellConfig(UrRtdeParameters):
    """Group ``cell``: a UR5e, a Robotiq 2F-85 and a camera.

    Attributes:
        calibration: file of the calibrated camera, made by ``python -m pipelines.calibrate_camera``.
        mounting: where the base of the arm stands.
    """

    name: Literal["ur_rtde"]
    calibration: str
    mounting: Mounting


CellConfig = Annotated[SimulatedCellConfig | UrRtdeCellConfig, Field(discriminator="name")]


@parameters
class SegmenterConfig:
    """Group ``segmenter``: what finds the objects in an image.

    Attributes:
        name: ``network`` (ours), ``mask_rcnn`` (torchvision's, COCO classes), ``yolo`` (any YOLO segmentation in ONNX),
            ``true_masks`` (of a simulated cell), or ``true_state`` (of a simulated cell: no camera at all).
        file: of its weights; null for the released network.
    """

    name: Literal["network", "mask_rcnn", "yolo", "true_masks", "true_state"]
    file: str | None

    def __post_init__(self) -> None:
        if self.name in ("mask_rcnn", "yolo") and not self.file:
            raise ValueError(
                f"file is missing: segmenter={self.name} needs the file of its weights, such as "
                "segmenter.file=/data/weights.onnx."
            )


@parameters
class SafetyConfig:
    """Group ``safety``: the limits of the robot.

    Attributes:
        watchdog: of what the devices report.
        motion: of what is commanded.
        look: of when a view counts.
        survey: whether the arm moves out of the camera's sight before the first action.
        tool: how fast the tool moves.
        edge_margin: at the edges, into which no object should be pushed (:class:`ReachableModel`) [m]; it shrinks to
            nothing in the first half of the actions that an episode may have.
    """

    watchdog: WatchdogLimits
    motion: MotionLimits
    look: LookLimits
    survey: bool
    tool: MotionParameters
    edge_margin: NonNegative


@parameters
class RobotConfig(PipelineConfig):
    """What the pipelines of the execution phase share.

    Attributes:
        heuristics: folder with the networks of all planners; null for those of the planner.
        desired: kind of the desired object; null for that of a simulated cell's task.
        desired_which: of several of its kind, the one that is the n-th closest to the robot's base, from 0.
        desired_place: (x, y) of a point on it [m]; only objects there count. Null to name it without a place.
        physics: of the planner's model.
    """

    cell: CellConfig
    segmenter: SegmenterConfig
    safety: SafetyConfig
    physics: Physics
    planner: PlannerConfig
    heuristics: str | None
    desired: Kind | None
    desired_which: Index
    desired_place: Place | None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_name(self.planner)
        if self.cell.name != "simulated":
            if self.desired is None:
                raise ValueError("desired is missing: name the kind of the desired object, such as desired=orange.")
            if self.segmenter.name in ("true_masks", "true_state"):
                raise ValueError(
                    f"segmenter={self.segmenter.name} is of simulated cells only: choose released, mask_rcnn or yolo."
                )
        elif self.desired is None and (self.desired_which or self.desired_place is not None):
            raise ValueError(
                "desired_which and desired_place are for a desired kind, such as desired=orange desired_which=1."
            )


@parameters
class ExecutionVideoConfig:
    """Appearance of the video of an episode of a robot (:class:`visualrhp.embodiment.film.FilmRecorder`).

    Attributes:
        size_px: height and width of each of its pictures.
        fps: frames per second, of the cell's clock and of the video.
        decision_s: for which every decision is shown [s].
        hold_s: for which the end is shown [s].
    """

    size_px: Annotated[int, Field(ge=64, le=2048)]
    fps: Annotated[int, Field(ge=1, le=60)]
    decision_s: NonNegative
    hold_s: NonNegative


@parameters
class ExecuteConfig(RobotConfig):
    """``python -m pipelines.execute``: one episode of a robot.

    Attributes:
        index: of the task of a simulated cell.
        scenario: a named set-up of the simulated cell instead of a random task
            (:data:`visualrhp.embodiment.simulated_cell.scenarios.SCENARIOS`); null for none.
        dry_run: whether every motion is computed, checked and shown, and none is commanded.
        video: appearance of the video.
    """

    index: Seed
    scenario: str | None
    dry_run: bool
    video: ExecutionVideoConfig

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.scenario is not None and self.scenario not in SCENARIOS:
            raise ValueError(f"scenario={self.scenario!r:.60}: choose one of {', '.join(SCENARIOS)}.")
        if self.scenario is not None and self.cell.name != "simulated":
            raise ValueError("scenario is for cell=simulated.")


@parameters
class ReportExecutionConfig(PipelineConfig):
    """``python -m pipelines.report_execution``.

    Attributes:
        evaluations: folder in which ``evaluate_execution`` wrote, at any depth.
        method: which is compared with the others.
    """

    evaluations: str
    method: str


@parameters
class EvaluateExecutionConfig(RobotConfig):
    """``python -m pipelines.evaluate_execution``: episodes of a robot in simulated cells.

    Attributes:
        num_episodes: number of cells, the same for every method.
        world: in which the episodes run: the ``cell``; or the planner's simulator with the cell's tasks, to tell what
            each step costs (:class:`visualrhp.embodiment.planar_world.PlanarWorld`): ``simulator``; with what the arm
            can reach, too, ``arm``; and with the cell's friction and masses, too, ``friction``.
    """

    num_episodes: Count
    world: Literal["cell", "simulator", "arm", "friction"]

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.cell.name != "simulated":
            raise ValueError("cell=simulated is needed: tasks of real cells are not sampled.")
        if self.desired is not None:
            raise ValueError("desired must be null: every task has its desired object.")
        if self.world != "cell" and self.segmenter.name != "true_state":
            raise ValueError(f"world={self.world} needs segmenter=true_state: there is no camera in it.")
