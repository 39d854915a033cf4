"""The world of a robot cell: seen through its camera, and moved through the joints of its arm (paper, Fig. 2, bottom).

:class:`RobotWorld` is a :class:`~visualrhp.execution.world.World`, so that episodes, metrics and reports are those of
the simulator. One action is: *look* (wait for rest, take a frame that was exposed afterwards, check it, interpret it),
decide (:func:`~visualrhp.execution.run_episode`), *act* (check that the view is still true, compute the path of the
joints, check every limit, move, watch).

Safety. A *blind motion* is one that rests on an old view: on a frame that was exposed before the robot's last motion
ended, that is older than ``WatchdogLimits.max_view_age_s`` when the motion starts, or after which the cell has shown
something else. There is none: a view is used up by the motion that it led to; a view that grew old while the planner
thought is compared with a new one, and the motion is withheld if they differ. Every fault stops the robot, and the
world then refuses all further actions.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from visualrhp.embodiment.looking import Looker, LookLimits, Perceiver, RobotMask, Sight, StepLatency
from visualrhp.embodiment.motion import Kinematics, MotionLimits, check_trajectory, execute
from visualrhp.embodiment.prediction import is_desired_hidden, seems_reached, with_hidden_predicted
from visualrhp.embodiment.robot_cell import ArmLimits, JointTrajectory, RobotCell
from visualrhp.embodiment.robot_model import CELL_GRIPPER, GRIPPER_HEIGHT
from visualrhp.embodiment.survey import backwards
from visualrhp.embodiment.watchdog import WatchdogLimits, WatchedCell
from visualrhp.errors import ActionError, CellFault, PerceptionError, UnreachableError, VisualRHPError
from visualrhp.execution.world import World
from visualrhp.scene.scene import Scene
from visualrhp.simulation import rules
from visualrhp.simulation.action_spaces import ActionSpace, GripperMotion
from visualrhp.types import Action, FloatArray, State

_EMPTY = 3e-3
"""Opening of closed fingers [m] above which something is between them."""

SurveyMotions = Callable[[FloatArray], Sequence[JointTrajectory]]


class RobotWorld(World):
    """A robot cell as a world.

    Args:
        cell: the cell.
        perception: interprets its frames.
        kinematics: of its arm.
        action_space: of the actions.
        closed: the commanded state of the gripper at the start.
        arm_limits: of the arm.
        watchdog, motion, look: limits.
        robot_mask, host_clock: see :class:`~visualrhp.embodiment.looking.Looker`.
        survey: returns the motions out of the camera's sight, from joint positions [6]
            (:func:`~visualrhp.embodiment.survey.survey_motions`). They precede the first view, and the view of a goal,
            or of a desired object that was hidden for ``LookLimits.max_hidden`` looks; the arm then returns the way it
            came, but from a goal. None to see only what the arm does not hide.

    Attributes:
        imagine: the state after an action, by the planner's model: a function of (state, action) in the scene of the
            last view. With it, objects that the arm hides are where it expects them; None to leave them where they were
            seen last.
        followers: called with the scene after every look, such as ``ReachableModel.follow``.
        latencies: of the actions so far; the last one is of the action to come.
        sight: the view on which the next action rests; None after a motion, until the next look.
        last_sight: the last view.
        last_trajectory: of the last motion of the arm.
        fault: why the robot was stopped; None if it was not.
    """

    def __init__(
        self,
        cell: RobotCell,
        perception: Perceiver,
        kinematics: Kinematics,
        action_space: ActionSpace,
        *,
        closed: bool = False,
        arm_limits: ArmLimits | None = None,
        watchdog: WatchdogLimits | None = None,
        motion: MotionLimits | None = None,
        look: LookLimits | None = None,
        robot_mask: RobotMask | None = None,
        host_clock: Callable[[], float] | None = None,
        survey: SurveyMotions | None = None,
    ) -> None:
        self.imagine: Callable[[State, Action], State] | None = None
        self.followers: list[Callable[[Scene], None]] = []
        self.latencies: list[StepLatency] = [StepLatency()]
        self.sight: Sight | None = None
        self.last_sight: Sight | None = None
        self.last_trajectory: JointTrajectory | None = None
        self.fault: str | None = None
        self._cell = WatchedCell(cell, CELL_GRIPPER.stroke, watchdog, arm_limits)
        self._looker = Looker(self._cell, perception, look, robot_mask, host_clock)
        self._kinematics = kinematics
        self._space = action_space
        self._closed = closed
        self._motion_limits = motion or MotionLimits()
        self._survey_motions = survey
        self._num_withheld = self._num_hidden = 0
        self._predicted: State | None = None

    # -------------------------------------------------------------------------------------------------------- observe
    def observe(self) -> tuple[Scene, State]:
        with self._stopping_on_faults():
            if self.sight is None or not self._is_current(self.sight):
                self._renew()
            assert self.sight is not None
            return self.sight.view.scene, self.sight.view.state

    def _renew(self) -> None:
        """Look, and tell the followers."""
        latency = self.latencies[-1]
        motions = self._survey_motions if self._looker.needs_camera else None
        aside = self._survey(motions, latency) if motions is not None and self.last_sight is None else None
        if aside is not None and _is_goal(aside):
            sight = aside
        else:
            sight = self._looker.look(self.last_sight, self._closed, latency)
            self._num_hidden = self._num_hidden + 1 if is_desired_hidden(sight.view) else 0
            is_lost = self._num_hidden >= self._looker.limits.max_hidden
            if motions is not None and (is_lost or seems_reached(sight.view)):
                sight = self._from_aside(motions, latency)
        if self._predicted is not None and self.last_sight is not None and not self._looker.places_hidden:
            view = with_hidden_predicted(sight.view, self.last_sight.view, self._predicted)
            sight = replace(sight, view=view)
        self.sight = self.last_sight = sight
        started = time.perf_counter()
        for follow in self.followers:
            follow(self.sight.view.scene)
        latency.model_s += time.perf_counter() - started

    def _from_aside(self, motions: SurveyMotions, latency: StepLatency) -> Sight:
        """Look without the arm; then look again, unless the goal is reached."""
        self._num_hidden = 0
        aside = self._survey(motions, latency)
        if aside is not None and _is_goal(aside):
            return aside
        return self._looker.look(self.last_sight, self._closed, latency)

    def _survey(self, motions: SurveyMotions, latency: StepLatency) -> Sight | None:
        """Show the camera the table without the arm, which then returns the way it came; the view without the arm.

        The fingers let go of what is between them, whether it was seen there or not: the arm would take it along. The
        arm stays aside if the goal is reached. None if it cannot move aside; what it does not hide is all there is.
        """
        try:
            legs = motions(self._cell.rest()[0].positions)
        except UnreachableError:
            return None
        if self._closed and self._cell.gripper().opening > _EMPTY:
            self._closed = False
            execute(self._cell, None, self._cell.stroke)
        for leg in legs:
            execute(self._cell, leg, None)
        sight = self._looker.look(None, self._closed, latency)
        if not _is_goal(sight):
            for leg in reversed(legs):
                execute(self._cell, backwards(leg), None)
        return sight

    # ------------------------------------------------------------------------------------------------------------ act
    def act(self, action: Action) -> None:
        motion = self._space.motion(action)
        with self._stopping_on_faults():
            sight = self._confirmed_sight()
            if sight is None:
                return
            latency, started = self.latencies[-1], time.perf_counter()
            trajectory = self._trajectory(motion)
            latency.path_s = time.perf_counter() - started
            opening = None if motion.closed is None else (0.0 if motion.closed else self._cell.stroke)
            latency.view_age_s = self._looker.age(sight)
            if latency.view_age_s > self._cell.limits.max_view_age_s:
                raise CellFault(
                    f"the path of the arm took so long that the view is {latency.view_age_s:.2f} s old; at most "
                    f"{self._cell.limits.max_view_age_s:g} s are allowed"
                )
            self.sight, self.last_trajectory = None, trajectory  # the view is used up
            self._predict(sight, action)
            if motion.closed is not None:
                self._closed = motion.closed
            latency.motion_s = execute(self._cell, trajectory, opening)
            self._num_withheld = 0
            self.latencies.append(StepLatency())

    def _predict(self, sight: Sight, action: Action) -> None:
        """Predict the state after the action, and tell it to a perception that can make use of it."""
        self._predicted = None
        if self.imagine is None:
            return
        try:
            self._predicted = self.imagine(sight.view.state, action)
        except VisualRHPError:  # an overlap that the model cannot simulate
            return
        self._looker.expect(sight.view, self._predicted)

    def _trajectory(self, motion: GripperMotion) -> JointTrajectory | None:
        """The checked motion of the arm; None if only the fingers move."""
        if motion.forward == motion.left == motion.rotation == 0.0:
            return None
        arm = self._cell.arm()
        above = self._kinematics.forward(arm.positions).height - GRIPPER_HEIGHT
        if abs(above) > self._motion_limits.max_deviation:
            raise CellFault(f"the gripper is {1e3 * above:+.1f} mm from its height: it stands on something, or is held")
        trajectory = self._kinematics.path(arm.positions, motion)
        check_trajectory(trajectory, arm, motion, self._kinematics, self._motion_limits, self._cell.arm_limits)
        return trajectory

    def _confirmed_sight(self) -> Sight | None:
        """The view on which the action rests, if it still holds; None, after a new look, if the scene has changed."""
        sight = self.sight
        if sight is None:
            raise CellFault("the robot has moved and has not looked since; an action needs a view")
        if self._is_current(sight):
            return sight
        # Something that goes on slipping, while everything stays in its place, hinders no motion.
        is_gripped = self._is_gripped_as_in(sight) or self._num_withheld == self._looker.limits.max_withheld
        self._renew()
        assert self.sight is not None
        if is_gripped and self._looker.agree(sight.view, self.sight.view):
            return self.sight
        self.latencies[-1].is_withheld = True
        self.latencies.append(StepLatency())
        self._num_withheld += 1
        if self._num_withheld > self._looker.limits.max_withheld:
            raise PerceptionError(
                f"the scene changed while the planner decided, {self._num_withheld} times in succession"
            )
        return None

    def _is_current(self, sight: Sight) -> bool:
        """Whether a view can be acted on: it is young, and nothing between the fingers has slipped; the robot must not
        have moved since.

        Raises:
            CellFault: the arm has moved without a command.
        """
        limits = self._cell.limits
        arm = self._cell.arm()
        if (drift := float(np.abs(arm.positions - sight.arm.positions).max())) > limits.max_drift:
            raise CellFault(f"the arm moved by {drift:.3f} rad without a command")
        if not self._cell.is_still(arm):
            raise CellFault("the arm is moving without a command")
        return self._is_gripped_as_in(sight) and self._looker.age(sight) <= limits.max_view_age_s

    def _is_gripped_as_in(self, sight: Sight) -> bool:
        """Whether the fingers are where they were: they close further when an object slips away between them."""
        gripper = self._cell.gripper()
        return not gripper.is_moving and (
            abs(gripper.opening - sight.gripper.opening) <= self._cell.limits.max_opening_drift
        )

    # ---------------------------------------------------------------------------------------------------------- faults
    @contextmanager
    def _stopping_on_faults(self) -> Iterator[None]:
        """Stop the robot at any error in the block, but one of an action that was refused before anything moved."""
        if self.fault is not None:
            raise CellFault(f"the robot was stopped before: {self.fault}")
        try:
            yield
        except ActionError:
            raise
        except BaseException as error:
            self.stop(str(error) or type(error).__name__)
            if not isinstance(error, CellFault | PerceptionError) or self.fault == str(error):
                raise
            raise type(error)(self.fault) from error

    def stop(self, reason: str) -> None:
        """Bring the robot to rest; it does not move again. Never raises."""
        self.sight = None
        problem = self._cell.halt()
        self.fault = reason if problem is None else f"{reason}; whether the arm is at rest is not known: {problem}"

    def close(self) -> None:
        """Stop the robot, and release the cell."""
        self._cell.close()


def _is_goal(sight: Sight) -> bool:
    return rules.is_goal(sight.view.scene, sight.view.state)
