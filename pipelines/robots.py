"""Construction of robot cells and of what perceives them, from their configuration."""

from __future__ import annotations

import functools
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from visualrhp.errors import ConfigError

if TYPE_CHECKING:
    from pipelines.config import EvaluateExecutionConfig, RobotConfig, SegmenterConfig, UrRtdeCellConfig
    from visualrhp.embodiment.camera import Camera
    from visualrhp.embodiment.desired import DesiredObject
    from visualrhp.embodiment.dry_run import DryRunWorld
    from visualrhp.embodiment.kinematics import ArmKinematics
    from visualrhp.embodiment.looking import Perceiver, RobotMask
    from visualrhp.embodiment.planar_world import PlanarWorld
    from visualrhp.embodiment.planned_model import ReachableModel
    from visualrhp.embodiment.robot_cell import RobotCell
    from visualrhp.embodiment.robot_model import Mounting
    from visualrhp.embodiment.robot_world import RobotWorld
    from visualrhp.embodiment.segmentation.detection import Segmenter
    from visualrhp.embodiment.simulated_cell.cell import SimulatedCell
    from visualrhp.embodiment.ur_rtde_cell import UrRtdeCell
    from visualrhp.scene.scene import Scene
    from visualrhp.simulation.action_spaces import ActionSpace
    from visualrhp.types import FloatArray, State


@dataclass
class Robot:
    """A cell with what perceives and moves it.

    Attributes:
        cell: as the protocol.
        kinematics: of its arm.
        perception: interprets its frames.
        simulated: the cell, if it is simulated, which knows what is true.
        robot_mask: returns the pixels that may show the robot; None without a camera.
        desired: index of the desired object among those of a simulated cell.
    """

    cell: RobotCell
    kinematics: ArmKinematics
    perception: Perceiver
    simulated: SimulatedCell | None = None
    robot_mask: RobotMask | None = None
    desired: int = 0

    def true_end(self) -> dict[str, Any] | None:
        """What is true at the end of an episode in a simulated cell; None for a real one.

        Whether the desired object is in the target region, and which objects have fallen off the table.
        """
        if self.simulated is None:
            return None
        truth = self.simulated.truth()
        position = truth.state.object_positions[self.desired]
        distance = float(np.hypot(*(position - truth.scene.target.position)))
        fallen = [number for number, is_fallen in enumerate(truth.is_fallen) if is_fallen]
        is_reached = distance <= truth.scene.target.radius and not fallen
        return {"success": is_reached, "distance_to_target": distance, "fallen": fallen}


def open_robot(config: RobotConfig, index: int, *, read_only: bool = False, render: bool = False) -> Robot:
    """Open the cell of ``config``; a simulated one is that of its scenario, or of task ``index``.

    Args:
        config: of the robot.
        index: of the task.
        read_only: whether a real cell takes no commands.
        render: whether a simulated cell can be rendered even if nothing looks at it.

    Raises:
        ConfigError: the robot's packages are not installed, or the desired object is not in the simulated cell.
        DataError, CheckpointError: the calibration or the segmenter's file is missing or damaged.
        CellFault: a real cell cannot be reached.
    """
    if config.cell.name == "simulated":
        return _simulated(config, index, render)
    from visualrhp.embodiment.camera import Camera
    from visualrhp.embodiment.desired import DesiredObject
    from visualrhp.embodiment.kinematics import ArmKinematics

    assert config.desired is not None
    camera = Camera.load(config.cell.calibration)
    kinematics = ArmKinematics(config.cell.mounting, motion=config.safety.tool)
    segmenter = build_segmenter(config.segmenter)
    cell = _open_ur_rtde(config.cell, read_only)
    desired = DesiredObject(config.desired, config.desired_which, config.desired_place)
    perception = _perception(camera, segmenter, kinematics, desired)
    return Robot(cell, kinematics, perception, robot_mask=_robot_mask(camera, config.cell.mounting))


def _open_ur_rtde(config: UrRtdeCellConfig, read_only: bool) -> UrRtdeCell:
    from pipelines.planners import parameters_of
    from visualrhp.embodiment.ur_rtde_cell import UrRtdeCell, UrRtdeParameters

    return UrRtdeCell(UrRtdeParameters(**parameters_of(config, UrRtdeParameters)), read_only=read_only)


def _simulated(config: RobotConfig, index: int, render: bool) -> Robot:
    from visualrhp.embodiment.kinematics import ArmKinematics
    from visualrhp.embodiment.simulated_cell.cell import SimulatedCell
    from visualrhp.embodiment.simulated_cell.sampling import sample_cell
    from visualrhp.embodiment.simulated_cell.scenarios import scenario
    from visualrhp.embodiment.true_state import TruePerception, TrueSegmenter
    from visualrhp.streams import Split

    assert config.cell.name == "simulated"
    name = getattr(config, "scenario", None)
    task = sample_cell(config.cell, config.seed, Split.EVALUATION, index) if name is None else scenario(name)
    kinematics = ArmKinematics(task.mounting, motion=config.safety.tool)
    has_camera = config.segmenter.name != "true_state"
    network = build_segmenter(config.segmenter) if config.segmenter.name not in ("true_masks", "true_state") else None
    cell = SimulatedCell(task, render=has_camera or render)
    try:
        desired, named = _desired_of(config, cell)
        if not has_camera:
            perception: Perceiver = TruePerception(lambda: _scene_and_state(cell), desired)
        else:
            segmenter = network or TrueSegmenter(cell.detections)
            perception = _perception(cell.camera, segmenter, kinematics, named)
    except Exception:
        cell.close()
        raise
    robot_mask = _robot_mask(cell.camera, task.mounting) if has_camera else None
    return Robot(cell, kinematics, perception, cell, robot_mask, desired)


def _scene_and_state(cell: SimulatedCell):
    truth = cell.truth()
    return truth.scene, truth.state


def _desired_of(config: RobotConfig, cell: SimulatedCell) -> tuple[int, DesiredObject]:
    """Index of the desired object in the cell's task, and how it is named; that of a task by its kind and its place.

    Raises:
        ConfigError: there is no such object.
    """
    from visualrhp.embodiment.desired import DesiredObject

    truth, mounting = cell.truth(), cell.task.mounting
    places = truth.state.object_positions
    if config.desired is None:
        x, y = np.round(places[0], 2).tolist()
        return 0, DesiredObject(truth.kinds[0], place=(x, y))
    distances = np.hypot(*(places - (config.desired_place or (mounting.x, mounting.y))).T)
    kind = config.desired
    ranked = sorted((number for number, each in enumerate(truth.kinds) if each is kind), key=lambda n: distances[n])
    if config.desired_which >= len(ranked):
        present = ", ".join(sorted(truth.kinds))
        raise ConfigError(
            f"desired={config.desired} desired_which={config.desired_which}: the cell has {present}; "
            "choose one of these, or another index."
        )
    named = DesiredObject(kind, config.desired_which, config.desired_place)
    return ranked[config.desired_which], named


def _perception(camera: Camera, segmenter: Segmenter, kinematics: ArmKinematics, desired: DesiredObject) -> Perceiver:
    from visualrhp.embodiment.perception import Perception

    return Perception(camera, segmenter, kinematics, desired)


def _robot_mask(camera: Camera, mounting: Mounting) -> RobotMask:
    from visualrhp.embodiment.arm_silhouette import arm_mask

    return lambda arm, gripper: arm_mask(camera, arm.positions, gripper.opening, mounting)


def build_segmenter(config: SegmenterConfig) -> Segmenter:
    """The segmenter of ``config``, which is none of a simulated cell's truth.

    Raises:
        ConfigError: a package that it needs is not installed.
        CheckpointError, DataError: its file is missing or damaged.
    """
    match config.name:
        case "mask_rcnn":
            from visualrhp.embodiment.segmentation.mask_rcnn import MaskRCNNSegmenter

            return MaskRCNNSegmenter(Path(config.file or ""))
        case "yolo":
            from visualrhp.embodiment.segmentation.yolo import YoloSegmenter

            return YoloSegmenter(Path(config.file or ""))
        case _:
            from visualrhp.embodiment.segmentation.onnx_segmenter import OnnxSegmenter

            return OnnxSegmenter(config.file)


def make_world(config: RobotConfig, robot: Robot, space: ActionSpace) -> RobotWorld:
    """The world of ``robot``. The clock of a real cell is held against that of this machine."""
    from visualrhp.embodiment.robot_world import RobotWorld
    from visualrhp.embodiment.survey import survey_motions

    safety = config.safety
    return RobotWorld(
        robot.cell,
        robot.perception,
        robot.kinematics,
        space,
        watchdog=safety.watchdog,
        motion=safety.motion,
        look=safety.look,
        robot_mask=robot.robot_mask,
        host_clock=None if robot.simulated is not None else time.monotonic,
        survey=functools.partial(survey_motions, robot.kinematics) if safety.survey else None,
    )


def make_dry_run(config: RobotConfig, robot: Robot, space: ActionSpace) -> DryRunWorld:
    """The world of a dry run of ``robot``; motions are imagined by the planner's model."""
    from visualrhp.embodiment.dry_run import DryRunWorld
    from visualrhp.simulation.transition_model import TransitionModel

    def imagine(scene, state: State, action) -> State:
        return TransitionModel(scene, space, config.physics).advance(state, action)

    safety = config.safety
    return DryRunWorld(
        robot.cell,
        robot.perception,
        robot.kinematics,
        space,
        imagine,
        watchdog=safety.watchdog,
        motion=safety.motion,
        look=safety.look,
        robot_mask=robot.robot_mask,
    )


def make_planar_world(config: EvaluateExecutionConfig, robot: Robot, space: ActionSpace) -> PlanarWorld:
    """The task of ``robot``'s simulated cell in the planner's simulator, as ``config.world`` says."""
    from visualrhp.embodiment.planar_world import PlanarWorld

    assert robot.simulated is not None
    truth, things = robot.simulated.truth(), robot.simulated.task.objects
    with_arm, with_friction = config.world in ("arm", "friction"), config.world == "friction"
    return PlanarWorld(
        truth.scene,
        truth.state,
        space,
        config.physics,
        frictions=[thing.friction for thing in things] if with_friction else None,
        masses=[thing.mass for thing in things] if with_friction else None,
        kinematics=robot.kinematics if with_arm else None,
        joints=robot.cell.arm().positions,
    )


def make_model(
    config: RobotConfig, robot: Robot, world: RobotWorld | DryRunWorld | PlanarWorld, space: ActionSpace
) -> ReachableModel:
    """The planner's model of what ``world`` sees: it plans with what the arm can reach, and follows the scene."""
    from visualrhp.embodiment.planar_world import PlanarWorld
    from visualrhp.embodiment.planned_model import ReachableModel
    from visualrhp.embodiment.robot_world import RobotWorld
    from visualrhp.simulation import MAX_EPISODE_ACTIONS

    def joints() -> FloatArray | None:
        return world.joints if isinstance(world, PlanarWorld) else robot.cell.arm().positions

    scene, _ = world.observe()
    reach = None if joints() is None else robot.kinematics.reach
    model = ReachableModel(scene, space, reach, config.physics, config.safety.edge_margin)

    def follow(scene: Scene) -> None:
        patience = 1.0 - (len(world.latencies) - 1) / (0.5 * MAX_EPISODE_ACTIONS)
        model.edge_margin = config.safety.edge_margin * max(0.0, patience)  # bolder, before the actions run out
        positions = joints()
        model.follow(scene, None if positions is None else robot.kinematics.turning_range(positions))

    follow(scene)
    if isinstance(world, RobotWorld | PlanarWorld):
        world.followers.append(follow)
    if isinstance(world, RobotWorld):
        world.imagine = lambda state, action: model.transition_model.advance(state, action)
    return model
