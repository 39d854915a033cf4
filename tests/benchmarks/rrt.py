"""Success and time of K.RRT by number of objects, and of OMPL's control::RRT on the same task instances.

    python -m tests.benchmarks rrt --instances 300

A search that exceeds its time limit counts as unsolved, and its time is included. Plans have fewer than 50 actions, for
both planners. The section rrt_ompl, the comparison, requires OMPL.
"""

from __future__ import annotations

import importlib
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.benchmarks.timing import Effort, readable
from visualrhp.errors import SimulationError
from visualrhp.planning import KinodynamicRRT
from visualrhp.scene import SceneDistribution, TaskInstance, sample_task_instance
from visualrhp.simulation import MAX_ACTIONS, TransitionModel, make_action_space
from visualrhp.simulation.action_spaces import ContinuousActionSpace, DiscreteActionSpace
from visualrhp.streams import Split, Stream, generator_for
from visualrhp.types import Action, ActionSpaceName, State, wrap_angle

_SEED = 0
NUM_OBJECTS = range(1, 8)
ACTION_SPACES: tuple[ActionSpaceName, ...] = ("continuous", "discrete")


@dataclass(frozen=True)
class Search:
    """Result of a search on one task instance.

    Attributes:
        length: actions of the plan; None if there is none.
        time_s: of the one thread, by the processor's clock [s].
        num_simulated: simulated actions.
    """

    length: int | None
    time_s: float
    num_simulated: int


def _instance(num_objects: int, index: int) -> TaskInstance:
    distribution = SceneDistribution(num_objects=(num_objects, num_objects))
    return sample_task_instance(distribution, _SEED, Split.EVALUATION, index)


def _ours(space: ActionSpaceName, task: TaskInstance, index: int, planner: KinodynamicRRT) -> Search:
    model = TransitionModel(task.scene, make_action_space(space))
    rng = generator_for(_SEED, Split.EVALUATION, index, Stream.PLANNER)
    started = time.process_time()
    found = planner.search(model, task.state, rng)
    elapsed = time.process_time() - started
    return Search(len(found.episode) if found.episode else None, elapsed, found.num_simulated)


def planner_for(effort: Effort) -> KinodynamicRRT:
    """K.RRT with the time limit as its only one."""
    return KinodynamicRRT(max_simulations=10**8, time_limit_s=effort.time_limit_s)


def run(effort: Effort) -> None:
    for space in ACTION_SPACES:
        reach(space, NUM_OBJECTS, effort.instances, planner_for(effort))


def reach(space: ActionSpaceName, counts: Sequence[int], instances: int, planner: KinodynamicRRT) -> None:
    """Print a table of success and time by number of objects."""
    _show_head(f"K.RRT, {space} actions, {instances} task instances per row, limit {planner.time_limit_s} s")
    for num_objects in counts:
        found = [_ours(space, _instance(num_objects, index), index, planner) for index in range(instances)]
        _show(f"m = {num_objects}", found)


def against_ompl(space: ActionSpaceName, counts: Sequence[int], instances: int, planner: KinodynamicRRT) -> None:
    """Table of K.RRT and OMPL, each instance by the one and then by the other; ratios where both have a plan."""
    _show_head(
        f"K.RRT and OMPL's control::RRT, {space} actions, {instances} task instances per row, limit "
        f"{planner.time_limit_s} s"
    )
    ours: list[Search] = []
    theirs: list[Search] = []
    for num_objects in counts:
        for index in range(instances):
            task = _instance(num_objects, index)
            ours.append(_ours(space, task, index, planner))
            theirs.append(OMPLSearch(space, task, index, planner).search())
        _show(f"m = {num_objects}, K.RRT", ours[-instances:])
        _show(f"m = {num_objects}, OMPL", theirs[-instances:])
    _show("all, K.RRT", ours)
    _show("all, OMPL", theirs)
    both = [(a, b) for a, b in zip(ours, theirs, strict=True) if a.length is not None and b.length is not None]
    if both:
        lengths = np.array([(a.length, b.length) for a, b in both], dtype=float)
        times = np.array([(a.time_s, b.time_s) for a, b in both])
        print(
            f"where both have a plan ({len(both)}): K.RRT needs {lengths[:, 0].sum() / lengths[:, 1].sum():.0%} of "
            f"OMPL's actions, {times[:, 0].sum() / times[:, 1].sum():.0%} of its time, in the median "
            f"{np.median(times[:, 0]) / np.median(times[:, 1]):.0%}"
        )


def _show_head(title: str) -> None:
    print(
        f"\n{title}\n{'':<18} {'solved':>12} {'median':>9} {'mean':>9} {'95th':>9} {'longest':>9} "
        f"{'simulated':>10} {'actions':>8} {'median':>7} {'longest':>8}",
        flush=True,
    )


def _show(name: str, found: Sequence[Search]) -> None:
    times = np.array([search.time_s for search in found])
    lengths = np.array([search.length for search in found if search.length is not None] or [math.nan])
    solved = sum(search.length is not None for search in found)
    shown = [readable(float(value)) for value in (np.median(times), times.mean(), np.quantile(times, 0.95), max(times))]
    print(
        f"{name:<18} {solved:>5}/{len(found)} {solved / len(found):>5.1%} "
        + " ".join(f"{value:>9}" for value in shown)
        + f" {np.mean([search.num_simulated for search in found]):>10.0f} {lengths.mean():>8.1f}"
        + f" {np.median(lengths):>7.0f} {lengths.max():>8.0f}",
        flush=True,
    )


# ---------------------------------------------------------------------------------------------------------------- OMPL
_ROBOT, _HEADING, _GRIPPER, _DEPTH, _OBJECTS = 0, 1, 2, 3, 4
_ROOM = 0.1
"""The robot may reach this far beyond the edges [m]."""
_INVALID = 10.0 * MAX_ACTIONS
"""Depth of a state that is not valid."""


class OMPLSearch:
    """One task instance for OMPL's control::RRT, by the same propagation, validity, goal, controls and goal bias.

    A state is compound: robot position, heading, gripper (opening, command), depth, then position and angle of each
    object. The distance weighs robot, heading, desired object and obstacles as K.RRT's does, and takes no notice of the
    others. The depth, the number of actions from the root, is there so that a path of 50 actions is not valid.

    A goal sample has the desired object in the target region and the robot behind it, on the line from where the object
    was at the start, the obstacles where they were: the place that most pushes end in. OMPL's Python has one control an
    expansion, which is the default of its control::RRT.
    """

    def __init__(self, space: ActionSpaceName, task: TaskInstance, index: int, planner: KinodynamicRRT) -> None:
        self._task, self._index, self._planner, self._is_discrete = task, index, planner, space == "discrete"
        self._model = TransitionModel(task.scene, make_action_space(space))
        self._rng = generator_for(_SEED, Split.EVALUATION, index, Stream.PLANNER)
        self._num_simulated = 0

    def search(self) -> Search:
        """Search until there is a plan, or the planner's limits are reached."""
        base, control, util = (importlib.import_module(f"ompl.{name}") for name in ("base", "control", "util"))
        util.noOutputHandler()
        util.RNG.setSeed(self._index + 1)
        # OMPL's objects hold this one, so they are not attributes: Python does not see through such a cycle.
        information = self._space_information(base, control)
        start = information.allocState()
        self._write(self._task.state, 0.0, start)
        problem = base.ProblemDefinition(information)
        problem.addStartState(start)
        problem.setGoal(_goal_region(base)(information, self))
        rrt = control.RRT(information)
        rrt.setGoalBias(self._planner.goal_bias)
        rrt.setProblemDefinition(problem)
        rrt.setup()
        limit = math.inf if self._planner.time_limit_s is None else self._planner.time_limit_s
        started = time.process_time()

        def is_over() -> bool:
            return time.process_time() - started >= limit or self._num_simulated >= self._planner.max_simulations

        status = rrt.solve(base.PlannerTerminationCondition(is_over)).getStatus()
        assert status in (status.EXACT_SOLUTION, status.APPROXIMATE_SOLUTION, status.TIMEOUT), status
        elapsed, num_simulated = time.process_time() - started, self._num_simulated
        if not problem.hasExactSolution():
            return Search(None, elapsed, num_simulated)
        path = problem.getSolutionPath()
        self._check(path, information.allocState())
        return Search(path.getControlCount(), elapsed, num_simulated)

    def distance_to_goal(self, state: Any) -> float:
        """Distance of the desired object's centre from the target region [m], 0 in it."""
        target = self._task.scene.target
        x, y = state[_OBJECTS][0] - target.position[0], state[_OBJECTS][1] - target.position[1]
        return max(math.hypot(x, y) - target.radius, 0.0)

    def sample_goal(self, state: Any) -> None:
        """Write a goal sample into ``state``."""
        target, start = self._task.scene.target, self._task.state
        radius = 0.5 * target.radius * math.sqrt(self._rng.random())
        angle = self._rng.uniform(-math.pi, math.pi)
        x, y = target.position[0] + radius * math.cos(angle), target.position[1] + radius * math.sin(angle)
        object_x, object_y = start.desired_position
        heading = math.atan2(y - object_y, x - object_x)
        standoff = self._rng.uniform(0.0, self._planner.standoff)
        self._write(start, 0.0, state)
        state[_ROBOT][0], state[_ROBOT][1] = x - standoff * math.cos(heading), y - standoff * math.sin(heading)
        state[_HEADING].value = heading
        state[_OBJECTS][0], state[_OBJECTS][1] = x, y

    def _space_information(self, base: Any, control: Any) -> Any:
        states = self._state_space(base)
        controls = control.RealVectorControlSpace(states, 1 if self._is_discrete else ContinuousActionSpace.DIMENSION)
        limits = base.RealVectorBounds(1 if self._is_discrete else ContinuousActionSpace.DIMENSION)
        limits.setLow(0.0 if self._is_discrete else -1.0)
        limits.setHigh(float(DiscreteActionSpace.NUM_ACTIONS) if self._is_discrete else 1.0)
        controls.setBounds(limits)
        information = control.SpaceInformation(states, controls)
        information.setStatePropagator(self._propagate)
        information.setStateValidityChecker(lambda state: state[_DEPTH][0] < MAX_ACTIONS)
        information.setPropagationStepSize(1.0)
        information.setMinMaxControlDuration(1, 1)
        information.setup()
        return information

    def _state_space(self, base: Any) -> Any:
        scene, planner = self._task.scene, self._planner
        low, high = scene.edges.min(axis=0), scene.edges.max(axis=0)
        start = self._task.state.gripper_pose[:2]
        around = np.minimum(low - _ROOM, start), np.maximum(high + _ROOM, start)
        space = base.CompoundStateSpace()
        space.addSubspace(_plane(base, *around), 1.0)
        space.addSubspace(base.SO2StateSpace(), planner.heading_weight)
        space.addSubspace(_plane(base, (0.0, 0.0), (1.0, 1.0)), 0.0)
        space.addSubspace(_plane(base, (0.0,), (1.0,)), 0.0)
        for number in range(scene.num_objects):
            space.addSubspace(_plane(base, low, high), planner.obstacle_weight if number else planner.object_weight)
            space.addSubspace(base.SO2StateSpace(), 0.0)
        return space

    def _propagate(self, start: Any, control: Any, duration: float, result: Any) -> None:
        if self._is_discrete:
            action: Action = min(int(control[0]), DiscreteActionSpace.NUM_ACTIONS - 1)
        else:
            action = np.array([control[i] for i in range(ContinuousActionSpace.DIMENSION)])
        self._num_simulated += 1
        try:
            transition = self._model.simulate(self._read(start), action)
        except SimulationError:
            result[_DEPTH][0] = _INVALID
            return
        depth = start[_DEPTH][0] + duration
        self._write(transition.next_state, _INVALID if transition.is_dropped else depth, result)

    def _read(self, state: Any) -> State:
        robot, gripper = state[_ROBOT], state[_GRIPPER]
        places = range(_OBJECTS, _OBJECTS + 2 * self._task.scene.num_objects, 2)
        poses = [[state[place][0], state[place][1], state[place + 1].value] for place in places]
        return State.create([robot[0], robot[1], state[_HEADING].value], gripper[0], bool(gripper[1]), poses)

    def _write(self, source: State, depth: float, state: Any) -> None:
        state[_ROBOT][0], state[_ROBOT][1], heading = source.gripper_pose.tolist()
        state[_HEADING].value = wrap_angle(heading)  # OMPL refuses other angles
        state[_GRIPPER][0], state[_GRIPPER][1] = source.gripper_opening, float(source.gripper_closed)
        state[_DEPTH][0] = depth
        for number, (x, y, angle) in enumerate(source.object_poses.tolist()):
            position = state[_OBJECTS + 2 * number]
            position[0], position[1], state[_OBJECTS + 2 * number + 1].value = x, y, wrap_angle(angle)

    def _check(self, path: Any, result: Any) -> None:
        """Make sure that the path is a plan: its last state is what its actions lead to, and a goal state."""
        last = path.getState(path.getStateCount() - 1)
        assert path.getControlCount() < MAX_ACTIONS
        assert self._model.is_goal(self._read(last)) and not self._model.is_dropped(self._read(last))
        for number in range(path.getControlCount()):
            self._propagate(path.getState(number), path.getControl(number), 1.0, result)
            assert self._read(result) == self._read(path.getState(number + 1))


def _plane(base: Any, low: Sequence[float] | np.ndarray, high: Sequence[float] | np.ndarray) -> Any:
    space, bounds = base.RealVectorStateSpace(len(low)), base.RealVectorBounds(len(low))
    for axis in range(len(low)):
        bounds.setLow(axis, float(low[axis]))
        bounds.setHigh(axis, float(high[axis]))
    space.setBounds(bounds)
    return space


def _goal_region(base: Any) -> Any:
    """The class of goals; made here, because its base class is in an optional package."""

    class GoalRegion(base.GoalSampleableRegion):
        def __init__(self, information: Any, search: OMPLSearch) -> None:
            super().__init__(information)
            self.setThreshold(1e-12)
            self._search = search

        def distanceGoal(self, state: Any) -> float:  # OMPL's name
            return self._search.distance_to_goal(state)

        def sampleGoal(self, state: Any) -> None:  # OMPL's name
            self._search.sample_goal(state)

        def maxSampleCount(self) -> int:  # OMPL's name
            return 10**9

    return GoalRegion
