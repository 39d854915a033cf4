"""Kinodynamic RRT over statically stable states (Sec. 6.1, after Haustein et al., 2015), run open loop (Sec. 7.5).

The tree grows through the physics: a state at rest is expanded by simulating actions in it, so every edge is a motion
that the simulator confirms and every path from the root is a plan.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np

from visualrhp.errors import ConfigError, SimulationError
from visualrhp.planning.plan import Plan
from visualrhp.planning.planner import Decision, Planner, PlanningModel, Policy
from visualrhp.scene.scene import Scene
from visualrhp.simulation.action_spaces import ContinuousActionSpace, DiscreteActionSpace
from visualrhp.simulation.task import MAX_EPISODE_ACTIONS
from visualrhp.types import Action, Episode, FloatArray, State, Transition, wrap_angle


@dataclass(frozen=True, slots=True)
class SearchResult:
    """What a search found, and what it cost.

    Attributes:
        episode: the plan with its states, or None if the budget ran out first.
        num_simulated: simulated actions, those of shortening the plan included.
        num_nodes: states in the tree.
    """

    episode: Episode | None
    num_simulated: int
    num_nodes: int


@dataclass(frozen=True, slots=True)
class KinodynamicRRT(Planner):
    """Kinodynamic RRT in either action space.

    Until a goal state is simulated: draw a sample, find the node nearest to it, simulate up to ``num_children`` actions
    there (all 8 in the discrete space, each once), test every child for the goal, discard the invalid ones and add the
    others to the tree. A node at the depth of the action limit is not added, so a plan always has under 50 actions.

    Samples are of three kinds. With probability ``goal_bias``, a *pushing* sample: the desired object in the target
    region, the robot at the object, on the side away from the target region and facing it, relative to the arrangement
    of each node; the obstacles where they were at the start. With probability ``robot_bias``, only the robot's place
    matters, which is then on any side of the object. Otherwise an *exploring* sample: robot and objects anywhere.

    The distance of a node to a sample is Euclidean over all bodies, weighted as below, angles wrapped, plus
    ``depth_weight`` per action from the root, which favours short plans.

    Attributes:
        num_children: k, simulated actions per expansion (Sec. 7.5); in the continuous space only.
        num_directed: how many of them head for the sampled robot pose, with noise; the others are uniform.
        direction_noise: standard deviation of that noise in units of the action range.
        gripper_persistence: probability that a child keeps the commanded gripper state; in the continuous space only.
        goal_bias: probability of a pushing sample with the desired object in the target region.
        robot_bias: probability of a sample that only asks for the robot to be near the desired object.
        standoff: largest distance of a pushing robot's frame from the centre of the desired object [m].
        heading_weight: of the robot's angle [m/rad].
        object_weight: of the desired object's position, relative to the robot's.
        obstacle_weight: of the obstacles' positions, relative to the robot's.
        depth_weight: of an action from the root [m].
        max_simulations: budget: simulated actions after which the search gives up.
        time_limit_s: the paper's limit, 180 s in Sec. 7.5; None for results that depend on the seed alone.
        shorten: whether actions that a found plan does without are dropped from it (:func:`shorten_plan`).

    Raises:
        ConfigError: a parameter is out of range.
    """

    num_children: int = 8
    num_directed: int = 4
    direction_noise: float = 0.3
    gripper_persistence: float = 0.8
    goal_bias: float = 0.5
    robot_bias: float = 0.25
    standoff: float = 0.1
    heading_weight: float = 0.06
    object_weight: float = 1.0
    obstacle_weight: float = 0.3
    depth_weight: float = 0.01
    max_simulations: int = 100_000
    time_limit_s: float | None = None
    shorten: bool = False

    def __post_init__(self) -> None:
        for name in ("num_children", "max_simulations"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name}={getattr(self, name)} of the kinodynamic RRT: must be at least 1.")
        if not 0 <= self.num_directed <= self.num_children:
            raise ConfigError(
                f"num_directed={self.num_directed} of the kinodynamic RRT: must be from 0 to num_children, which is "
                f"{self.num_children}."
            )
        if self.goal_bias < 0.0 or self.robot_bias < 0.0 or self.goal_bias + self.robot_bias > 1.0:
            raise ConfigError(
                f"goal_bias={self.goal_bias} and robot_bias={self.robot_bias} of the kinodynamic RRT are probabilities "
                "with a sum of at most 1."
            )
        if not 0.0 <= self.gripper_persistence <= 1.0:
            raise ConfigError(
                f"gripper_persistence={self.gripper_persistence} of the kinodynamic RRT is a probability: from 0 to 1."
            )
        for entry in fields(self):
            value = getattr(self, entry.name)
            if entry.name.endswith(("_weight", "_noise", "standoff")) and not value >= 0.0:
                raise ConfigError(f"{entry.name}={value} of the kinodynamic RRT: must not be negative.")
        if self.time_limit_s is not None and not self.time_limit_s > 0.0:
            raise ConfigError(f"time_limit_s={self.time_limit_s} of the kinodynamic RRT: must be positive or null.")

    @property
    def name(self) -> str:
        return "K.RRT"

    def start(self, model: PlanningModel, rng: np.random.Generator) -> Policy:
        """Plan at the first call, then replay the plan whatever happens; without a plan, or after its end, give up."""
        plan: Plan | None = None

        def policy(state: State) -> Decision:
            nonlocal plan
            if plan is None:
                plan = Plan(self.search(model, state, rng).episode)
            return plan.follow()

        return policy

    def search(
        self, model: PlanningModel, state: State, rng: np.random.Generator, max_actions: int = MAX_EPISODE_ACTIONS
    ) -> SearchResult:
        """Search for a plan from ``state`` to a goal state of at most ``max_actions``; by default under 50."""
        search = TreeSearch(self, model, state, rng, max_actions)
        while not search.is_over:
            search.expand()
        plan, num_simulated = search.plan, search.num_simulated
        if self.shorten and plan is not None:
            plan, num_resimulated = shorten_plan(model, plan)
            num_simulated += num_resimulated
        return SearchResult(plan, num_simulated, search.num_nodes)

    def draw_sample(self, scene: Scene, start: State, rng: np.random.Generator) -> _Sample:
        """A pushing, robot or exploring sample, for a search that started in ``start``."""
        kind = rng.random()
        if kind < self.goal_bias:
            return _PushingSample(self, scene, start, rng, with_object=True)
        if kind < self.goal_bias + self.robot_bias:
            return _PushingSample(self, scene, start, rng, with_object=False)
        return _ExploringSample(self, scene, rng)


class TreeSearch:
    """A search under way: the tree of :class:`KinodynamicRRT`, grown by one expansion at a time.

    Attributes:
        plan: the way to the first goal state that was simulated; None until then.
        num_simulated: simulated actions so far.
    """

    def __init__(
        self, planner: KinodynamicRRT, model: PlanningModel, root: State, rng: np.random.Generator, max_actions: int
    ) -> None:
        self.plan = Episode((root,), (), (), is_goal=True, is_dropped=False) if model.is_goal(root) else None
        self.num_simulated = 0
        self._planner, self._model, self._root, self._rng = planner, model, root, rng
        self._deadline = math.inf if planner.time_limit_s is None else time.monotonic() + planner.time_limit_s
        self._tree = _Tree(root, planner.depth_weight, max_actions)
        self._propose = _every_action_once if model.action_space.name == "discrete" else _partly_directed(planner)
        self._is_exhausted = max_actions < 1

    @property
    def is_over(self) -> bool:
        """Whether there is a plan, the budget is spent, or every action has been tried in every node."""
        return (
            self.plan is not None
            or self._is_exhausted
            or self.num_simulated >= self._planner.max_simulations
            or time.monotonic() >= self._deadline
        )

    @property
    def num_nodes(self) -> int:
        """States in the tree; nodes are numbered in the order in which they joined it, the root is 0."""
        return len(self._tree.states)

    def expand(self) -> range:
        """Draw a sample and simulate actions in the node nearest to it; the nodes that joined the tree.

        The first child in the goal becomes the end of the plan, and ends the expansion.
        """
        tree, num_nodes = self._tree, self.num_nodes
        sample = self._planner.draw_sample(self._model.scene, self._root, self._rng)
        node = tree.nearest(sample)
        if node is None:
            self._is_exhausted = True
            return range(0)
        children = []
        for action in self._propose(tree, node, sample, self._rng):
            self.num_simulated += 1
            try:
                child = self._model.simulate(tree.states[node], action)
            except SimulationError:
                continue
            if child.is_goal:
                self.plan = Episode.from_transitions([*tree.path(node), child])
                return range(0)
            if not child.is_dropped:
                children.append(child)
        for child in children:
            tree.add(node, child)
        return range(num_nodes, self.num_nodes)

    def state(self, node: int) -> State:
        """The state of ``node``."""
        return self._tree.states[node]

    def path(self, node: int) -> list[Transition]:
        """The transitions from the root to ``node``."""
        return self._tree.path(node)


def shorten_plan(model: PlanningModel, plan: Episode) -> tuple[Episode, int]:
    """Drop actions from ``plan`` as long as the others, simulated anew, still reach a goal state.

    One action at a time is left out, the first one first; what followed it is simulated from the state before it, and
    kept up to the first goal state, if there is one before a drop. Once no single action can be left out, the plan is
    returned: never longer than it was, and a fixed point of this function. No random numbers are drawn.

    Returns:
        The plan, and the number of simulated actions.
    """
    num_simulated = index = num_needed = 0  # the last ``num_needed`` attempts in a row, all around, failed
    while num_needed < len(plan):
        index = index if index < len(plan) else 0
        tail, num_tail = replay(model, plan.states[index], plan.actions[index + 1 :])
        num_simulated += num_tail
        if tail is None:
            index, num_needed = index + 1, num_needed + 1
            continue
        states, rewards = (*plan.states[:index], *tail.states), (*plan.rewards[:index], *tail.rewards)
        plan = Episode(states, (*plan.actions[:index], *tail.actions), rewards, is_goal=True, is_dropped=False)
        num_needed = 0
    return plan, num_simulated


def replay(model: PlanningModel, state: State, actions: Sequence[Action]) -> tuple[Episode | None, int]:
    """Take ``actions`` from ``state`` on, up to the first terminal state.

    Returns:
        The episode, None unless it ends in a goal state; and the number of simulated actions.
    """
    transitions: list[Transition] = []
    for action in actions:
        try:
            transitions.append(model.simulate(state, action))
        except SimulationError:
            return None, len(transitions) + 1
        state = transitions[-1].next_state
        if transitions[-1].is_terminal:
            break
    if not transitions or not transitions[-1].is_goal:
        return None, len(transitions)
    return Episode.from_transitions(transitions), len(transitions)


class _Sample(Protocol):
    """A sampled arrangement. ``vectors`` are states as in :class:`State`: [N, 5 + 3 m]."""

    def squared_distances(self, vectors: FloatArray) -> FloatArray:
        """[N] squared weighted distance of the states to the sample [m^2]."""
        ...

    def robot_pose(self, vector: FloatArray) -> tuple[float, float, float]:
        """Where the robot should go from the state ``vector`` [5 + 3 m]: x, y [m], theta [rad]."""
        ...


class _ExploringSample:
    """Robot and objects anywhere on the surface."""

    def __init__(self, planner: KinodynamicRRT, scene: Scene, rng: np.random.Generator) -> None:
        low, high = scene.edges.min(axis=0), scene.edges.max(axis=0)
        self._x, self._y = rng.uniform(low, high).tolist()
        self._theta = float(rng.uniform(-np.pi, np.pi))
        self._objects = rng.uniform(low, high, (scene.num_objects, 2))
        weights = np.full(scene.num_objects, planner.obstacle_weight)
        weights[0] = planner.object_weight
        self._squared_weights = weights**2
        self._heading_weight = planner.heading_weight

    def squared_distances(self, vectors: FloatArray) -> FloatArray:
        turn = self._heading_weight * wrap_angle(vectors[:, 2] - self._theta)
        robot = (vectors[:, 0] - self._x) ** 2 + (vectors[:, 1] - self._y) ** 2 + turn**2
        dx, dy = vectors[:, 5::3] - self._objects[:, 0], vectors[:, 6::3] - self._objects[:, 1]
        return robot + (dx**2 + dy**2) @ self._squared_weights

    def robot_pose(self, vector: FloatArray) -> tuple[float, float, float]:
        return self._x, self._y, self._theta


_TARGET_SHARE = 0.5
"""The desired object is sampled within this share of the target region's radius, so that it does not just graze it."""

_SIDE_DEVIATION = 0.3
"""Standard deviation of the direction in which a pushing robot stands at the object, from straight behind [rad]."""

_HEADING_DEVIATION = 0.15
"""Standard deviation of a pushing robot's heading from the direction of the object [rad]."""

_BEHIND_DISTANCE = 0.04
_BEHIND_ANGLE = 0.6
"""A robot this close [m, rad] to its place behind the object is taken to be there: it may push."""


class _PushingSample:
    """The robot at the desired object; ``with_object``: behind it, and the object in the target region."""

    def __init__(
        self, planner: KinodynamicRRT, scene: Scene, start: State, rng: np.random.Generator, with_object: bool
    ) -> None:
        radius = _TARGET_SHARE * scene.target.radius * math.sqrt(rng.random())
        angle = rng.uniform(-np.pi, np.pi)
        self._x = float(scene.target.position[0]) + radius * math.cos(angle)
        self._y = float(scene.target.position[1]) + radius * math.sin(angle)
        self._standoff = float(rng.uniform(0.0, planner.standoff))
        side = rng.normal(0.0, _SIDE_DEVIATION) if with_object else rng.uniform(-np.pi, np.pi)
        self._side, self._turn = float(side), float(rng.normal(0.0, _HEADING_DEVIATION))
        self._obstacles = start.object_poses[1:, :2]
        self._heading_weight = planner.heading_weight
        self._object_weight = planner.object_weight if with_object else 0.0
        self._obstacle_weight = planner.obstacle_weight

    def squared_distances(self, vectors: FloatArray) -> FloatArray:
        dx, dy = self._x - vectors[:, 5], self._y - vectors[:, 6]  # what the object has still to go
        direction = np.arctan2(dy, dx) + self._side
        behind_x = vectors[:, 5] - self._standoff * np.cos(direction)
        behind_y = vectors[:, 6] - self._standoff * np.sin(direction)
        turn = self._heading_weight * wrap_angle(vectors[:, 2] - direction - self._turn)
        squared = (vectors[:, 0] - behind_x) ** 2 + (vectors[:, 1] - behind_y) ** 2 + turn**2
        squared += self._object_weight**2 * (dx**2 + dy**2)
        if len(self._obstacles):
            moved_x, moved_y = vectors[:, 8::3] - self._obstacles[:, 0], vectors[:, 9::3] - self._obstacles[:, 1]
            squared += self._obstacle_weight**2 * (moved_x**2 + moved_y**2).sum(axis=1)
        return squared

    def robot_pose(self, vector: FloatArray) -> tuple[float, float, float]:
        x, y, theta, object_x, object_y = vector[[0, 1, 2, 5, 6]].tolist()
        dx, dy = self._x - object_x, self._y - object_y
        direction = math.atan2(dy, dx) + self._side
        behind_x = object_x - self._standoff * math.cos(direction)
        behind_y = object_y - self._standoff * math.sin(direction)
        is_behind = (
            math.hypot(x - behind_x, y - behind_y) < _BEHIND_DISTANCE
            and abs(wrap_angle(theta - direction)) < _BEHIND_ANGLE
        )
        if self._object_weight and is_behind:
            behind_x, behind_y = behind_x + dx, behind_y + dy
        return behind_x, behind_y, direction + self._turn


class _Tree:
    """States reached so far, the root first, in arrays that grow by doubling."""

    def __init__(self, root: State, depth_weight: float, max_actions: int) -> None:
        self.states = [root]
        self._arrivals: list[Transition | None] = [None]
        self._parents = [-1]
        self._depths = [0]  # actions from the root
        self._known = {root}
        self._depth_weight, self._max_actions = depth_weight, max_actions
        self._vectors = np.empty((_INITIAL_CAPACITY, root.vector.size))  # [capacity, 5 + 3 m]
        self._penalties = np.empty(_INITIAL_CAPACITY)  # [capacity] m, added to distances; infinite once closed
        self._vectors[0], self._penalties[0] = root.vector, 0.0

    def nearest(self, sample: _Sample) -> int | None:
        """The open node nearest to ``sample``; None if all are closed."""
        count = len(self.states)
        distances = np.sqrt(sample.squared_distances(self._vectors[:count])) + self._penalties[:count]
        node = int(np.argmin(distances))
        return node if math.isfinite(distances[node]) else None

    def close(self, node: int) -> None:
        """Never expand ``node`` again."""
        self._penalties[node] = math.inf

    def add(self, parent: int, arrival: Transition) -> None:
        """Add the state that ``arrival`` led to, unless it is known, or so deep that no action would be left in it."""
        state, node, depth = arrival.next_state, len(self.states), self._depths[parent] + 1
        if state in self._known or depth >= self._max_actions:
            return
        if node == len(self._penalties):
            self._vectors = np.concatenate([self._vectors, np.empty_like(self._vectors)])
            self._penalties = np.concatenate([self._penalties, np.empty_like(self._penalties)])
        self._vectors[node], self._penalties[node] = state.vector, self._depth_weight * depth
        self._known.add(state)
        self._depths.append(depth)
        self.states.append(state)
        self._arrivals.append(arrival)
        self._parents.append(parent)

    def path(self, node: int) -> list[Transition]:
        """The transitions from the root to ``node``."""
        transitions = []
        while (arrival := self._arrivals[node]) is not None:
            transitions.append(arrival)
            node = self._parents[node]
        return transitions[::-1]


_INITIAL_CAPACITY = 256

_Proposal = Callable[[_Tree, int, _Sample, np.random.Generator], Sequence[Action]]
"""The actions to simulate in a node of the tree, given the sample that it is nearest to."""


def _every_action_once(tree: _Tree, node: int, sample: _Sample, rng: np.random.Generator) -> Sequence[Action]:
    """All discrete actions; the node is closed, since repeating them would give the same children."""
    tree.close(node)
    return range(DiscreteActionSpace.NUM_ACTIONS)


def _partly_directed(planner: KinodynamicRRT) -> _Proposal:
    """Continuous actions: some towards the sampled robot pose, with noise, the others uniform."""

    def propose(tree: _Tree, node: int, sample: _Sample, rng: np.random.Generator) -> Sequence[Action]:
        actions = rng.uniform(-1.0, 1.0, (planner.num_children, ContinuousActionSpace.DIMENSION))
        directed = actions[: planner.num_directed]
        directed[:, :3] = _action_towards(sample.robot_pose(tree.states[node].vector), tree.states[node])
        directed[:, :3] += rng.normal(0.0, planner.direction_noise, (planner.num_directed, 3))
        command = 1.0 if tree.states[node].gripper_closed else -1.0
        keeps = rng.random(planner.num_children) < planner.gripper_persistence
        actions[:, 3] = np.abs(actions[:, 3]) * np.where(keeps, command, -command)
        return list(actions.clip(-1.0, 1.0))

    return propose


def _action_towards(goal: tuple[float, float, float], state: State) -> tuple[float, float, float]:
    """Longitudinal, lateral and rotational component of the action whose motion ends closest to the pose ``goal``."""
    x, y, theta = state.robot_pose.tolist()
    dx, dy = (goal[0] - x) / ContinuousActionSpace.TRANSLATION, (goal[1] - y) / ContinuousActionSpace.TRANSLATION
    forward, left = math.cos(theta) * dx + math.sin(theta) * dy, math.cos(theta) * dy - math.sin(theta) * dx
    scale = max(abs(forward), abs(left), 1.0)  # a longer way keeps its direction
    turn = wrap_angle(goal[2] - theta) / ContinuousActionSpace.ROTATION
    return forward / scale, left / scale, min(max(turn, -1.0), 1.0)
