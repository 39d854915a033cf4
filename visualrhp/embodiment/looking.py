"""Looking at the scene: frames are taken when everything is at rest, and interpreted until the view is clear."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

from visualrhp.embodiment.robot_cell import ArmState, CameraFrame, GripperState
from visualrhp.embodiment.watchdog import WatchedCell
from visualrhp.errors import PerceptionError
from visualrhp.parameters import Count, Positive, parameters
from visualrhp.scene.scene import Scene
from visualrhp.types import State

RobotMask = Callable[[ArmState, GripperState], npt.NDArray[np.bool_]]

_BLOCK = 8
"""Side of the blocks whose mean colour is compared between two frames [px]."""
_NOTHING = np.zeros((0, 0, 3), np.uint8)


class SeenScene(Protocol):
    """What the loop needs of a view: :class:`visualrhp.embodiment.perception.View`."""

    @property
    def scene(self) -> Scene:
        """The desired object first, the others in an order that stays."""
        ...

    @property
    def state(self) -> State:
        """Poses of the gripper and the objects."""
        ...

    # Optional: ``is_settled: bool``, False if another look might change what is there.


class Perceiver(Protocol):
    """Interprets frames: :class:`visualrhp.embodiment.perception.Perception`, or
    :class:`visualrhp.embodiment.true_state.TruePerception`.

    Attributes of an implementation that has no camera: ``needs_camera = False``.
    """

    def perceive(self, frame: CameraFrame, arm: ArmState, gripper: GripperState, closed: bool) -> SeenScene:
        """Find scene and state; ``closed`` is the commanded state of the gripper. Raises PerceptionError."""
        ...


@parameters
class LookLimits:
    """When a look at the scene counts. SI units.

    Attributes:
        still_interval_s: between two frames that are compared to see whether the scene is at rest.
        still_difference: of the mean of a colour channel over a block of 8 x 8 pixels, above which something moves.
        still_distance: by which a true position changes in this time, above which something moves [m].
        max_unrest_s: for which objects may go on moving after the robot has come to rest.
        max_looks: at a scene that is not as expected, until two looks in succession agree.
        same_position: distance of an object between two views that agree [m].
        max_displacement: of an object by one action; more is looked at again [m].
        max_hidden: looks in succession in which the arm hides the desired object, before it moves aside.
        max_withheld: actions in succession that are withheld since the scene changed, before the robot is stopped.
    """

    still_interval_s: Positive = 0.1
    still_difference: Positive = 5.0
    still_distance: Positive = 5e-4
    max_unrest_s: Positive = 4.0
    max_looks: Count = 8
    same_position: Positive = 0.012
    max_displacement: Positive = 0.25
    max_hidden: Count = 3
    max_withheld: Count = 3


@dataclass(frozen=True)
class Sight:
    """A view, and the robot when it was taken.

    Attributes:
        view: what was seen.
        time_s: when its frame was exposed [s].
        arm, gripper: at rest, before the exposure.
        host_time_s: when its frame had arrived, on the clock of this machine [s].
    """

    view: SeenScene
    time_s: float
    arm: ArmState
    gripper: GripperState
    host_time_s: float


@dataclass
class StepLatency:
    """Times of one action and of the view before it. Wall clock, but where the cell's clock is named.

    Attributes:
        num_looks: frames that were interpreted.
        rest_s: from the end of the motion to the frame that was used, on the cell's clock.
        perception_s: of interpreting the frames.
        model_s: of giving the scene to the planner's model.
        path_s: of computing and checking the motion.
        view_age_s: from the exposure to the start of the motion, on the cell's clock.
        motion_s: of the motion until rest, on the cell's clock.
        is_withheld: whether the scene had changed, so that the robot did not move.
    """

    num_looks: int = 0
    rest_s: float = 0.0
    perception_s: float = 0.0
    model_s: float = 0.0
    path_s: float = 0.0
    view_age_s: float = 0.0
    motion_s: float = 0.0
    is_withheld: bool = False


class Looker:
    """Looks at the scene of a cell.

    Args:
        cell: the cell.
        perception: interprets its frames.
        limits: see :class:`LookLimits`.
        robot_mask: returns the pixels [H, W] that may show the robot; there, nothing is taken for a motion of objects.
        host_clock: of this machine [s], against which the clock of a real cell is held; None for a simulated one,
            whose time passes only when it is waited for.
    """

    def __init__(
        self,
        cell: WatchedCell,
        perception: Perceiver,
        limits: LookLimits | None = None,
        robot_mask: RobotMask | None = None,
        host_clock: Callable[[], float] | None = None,
    ) -> None:
        self.limits = limits or LookLimits()
        self._cell = cell
        self._perception = perception
        self._robot_mask = robot_mask
        self._host_clock = host_clock or (lambda: 0.0)

    def look(self, expected: Sight | None, closed: bool, latency: StepLatency) -> Sight:
        """Look until the scene is as expected after the last view, or until two looks in succession agree.

        Args:
            expected: the last view; None if there is none.
            closed: the commanded state of the gripper.
            latency: to which the times are added.

        Raises:
            PerceptionError: there is no usable frame, or no clear view.
            CellFault: the robot does not come to rest, or reports something impossible.
        """
        sight, problem = None, ""
        for _ in range(self.limits.max_looks):
            again = self._look_once(closed, latency)
            if isinstance(again, PerceptionError):
                sight, problem = None, str(again)
                continue
            agrees = sight is not None and self.agree(sight.view, again.view)
            is_settled = getattr(again.view, "is_settled", True)
            if is_settled and (agrees or (expected is not None and self._is_possible(expected.view, again.view))):
                return again
            if is_settled:  # it is another scene than before
                expected = None
            sight, problem = again, "what is detected changes from frame to frame"
        raise PerceptionError(f"{self.limits.max_looks} looks in succession give no clear view: {problem}")

    def _look_once(self, closed: bool, latency: StepLatency) -> Sight | PerceptionError:
        """Wait until everything is at rest, and interpret a frame that was exposed afterwards; or why it cannot be."""
        begun = self._cell.now()
        arm, gripper = self._cell.rest()
        if self.needs_camera:
            frame = self._still_frame(arm, gripper)
            host_time_s = self._host_clock()
            try:
                view = self._perceive(frame, arm, gripper, closed, latency)
            except PerceptionError as error:
                return error
        else:
            frame, view = self._still_truth(arm, gripper, closed, latency)
            host_time_s = self._host_clock()
        latency.rest_s += frame.time_s - begun
        return Sight(view, frame.time_s, arm, gripper, host_time_s)

    def age(self, sight: Sight) -> float:
        """Time since the exposure of a view [s], on the cell's clock or on this machine's, whichever is longer."""
        return max(self._cell.now() - sight.time_s, self._host_clock() - sight.host_time_s)

    def _perceive(
        self, frame: CameraFrame, arm: ArmState, gripper: GripperState, closed: bool, latency: StepLatency
    ) -> SeenScene:
        started = time.perf_counter()
        try:
            view = self._perception.perceive(frame, arm, gripper, closed)
            vector = view.state.vector
        except PerceptionError:
            raise
        except Exception as error:
            raise PerceptionError(f"the frame cannot be interpreted: {type(error).__name__}: {error!s:.300}") from error
        finally:
            latency.perception_s += time.perf_counter() - started
            latency.num_looks += 1
        if view.state.num_objects != view.scene.num_objects or not np.isfinite(vector).all():
            raise PerceptionError("the view has another number of poses than of objects, or poses that are not finite")
        return view

    def _still_frame(self, arm: ArmState, gripper: GripperState) -> CameraFrame:
        """A frame that was exposed after the robot came to rest, and that shows objects at rest."""
        limits = self.limits
        self._cell.wait(self._cell.limits.control_period_s)
        frame = self._cell.frame_after(max(arm.time_s, gripper.time_s))
        looked_at = 1.0
        if self._robot_mask is not None:
            robot = self._robot_mask(arm, gripper).astype(np.uint8)
            looked_at = (_blocks(np.repeat(255 * robot[..., None], 3, axis=2)) == 0.0).astype(np.float32)
        end = self._cell.now() + limits.max_unrest_s
        while True:
            self._cell.wait(max(0.0, frame.time_s + limits.still_interval_s - self._cell.now()))
            again = self._cell.frame_after(frame.time_s)
            change = float((looked_at * np.abs(_blocks(again.image) - _blocks(frame.image))).max())
            if change <= limits.still_difference:
                return again
            if self._cell.now() > end:
                raise PerceptionError(f"something still moves {limits.max_unrest_s:g} s after the robot came to rest")
            frame = again

    def _still_truth(
        self, arm: ArmState, gripper: GripperState, closed: bool, latency: StepLatency
    ) -> tuple[CameraFrame, SeenScene]:
        robot = arm, gripper, closed, latency
        limits = self.limits
        end = self._cell.now() + limits.max_unrest_s
        before = self._perceive(CameraFrame(_NOTHING, self._cell.now()), *robot).state.object_positions
        while True:
            frame = CameraFrame(_NOTHING, self._cell.wait(limits.still_interval_s))
            view = self._perceive(frame, *robot)
            after = view.state.object_positions
            if after.shape == before.shape and np.abs(after - before).max() <= limits.still_distance:
                return frame, view
            if self._cell.now() > end:  # it may be falling for ever, beyond the edges
                return frame, view
            before = after

    @property
    def places_hidden(self) -> bool:
        """Whether the perception itself puts hidden objects where they are predicted."""
        return getattr(self._perception, "places_hidden", False)

    @property
    def needs_camera(self) -> bool:
        """Whether the perception looks at images."""
        return getattr(self._perception, "needs_camera", True)

    def expect(self, view: SeenScene, predicted: State) -> None:
        """Tell a perception that keeps tracks (``expect``) where they should be in the next image: {id: pose [3]}."""
        expect, tracks = getattr(self._perception, "expect", None), getattr(view, "tracks", None)
        if expect is not None and tracks is not None:
            expect({track.id: pose for track, pose in zip(tracks, predicted.object_poses, strict=True)})

    def agree(self, one: SeenScene, other: SeenScene) -> bool:
        """Whether two views show the same scene."""
        return self._largest_displacement(one, other) <= self.limits.same_position

    def _is_possible(self, before: SeenScene, after: SeenScene) -> bool:
        """Whether one action may have led from one view to the other."""
        return self._largest_displacement(before, after) <= self.limits.max_displacement

    @staticmethod
    def _largest_displacement(one: SeenScene, other: SeenScene) -> float:
        if one.state.num_objects != other.state.num_objects:
            return np.inf
        return float(np.hypot(*(one.state.object_positions - other.state.object_positions).T).max())


def _blocks(image: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
    """Mean colour of blocks of an image, [H // 8, W // 8, 3]: noise is averaged out."""
    height, width = (side // _BLOCK for side in image.shape[:2])
    whole = image[: height * _BLOCK, : width * _BLOCK]
    return cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32)
