"""Kinodynamic RRT over statically stable states (Sec. 6.1, after Haustein et al., 2015), run open loop (Sec. 7.5).

The tree is grown by simulation: a state at rest is expanded by simulating actions in it, so every edge is a simulated
motion and every path from the root is a plan.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from visualrhp.errors import SimulationError
from visualrhp.parameters import Count, Fraction, Index, NonNegative, Positive, parameters
from visualrhp.planning.plan import Plan
from visualrhp.planning.planner import Decision, Planner, PlanningModel, Policy
from visualrhp.planning.rrt_samples import ExploringSample, PushingSample, Sample
from visualrhp.scene.scene import Scene
from visualrhp.simulation.action_spaces import ContinuousActionSpace, DiscreteActionSpace
from visualrhp.simulation.rules import MAX_EPISODE_ACTIONS
from visualrhp.types import Action, Episode, Outcome, State, Transition, wrap_angle


@dataclass(frozen=True, slots=True)
class SearchResult:
    """The result of a search, and its cost.

    Attributes:
        episode: the plan with its states, or None if the budget ran out first.
        num_simulated: simulated actions, including those of shortening the plan.
        num_nodes: states in the tree.
    """

    episode: Episode | None
    num_simulated: int
    num_nodes: int


@parameters
class KinodynamicRRT(Planner):
    """Kinodynamic RRT in either action space.

    Until a goal state is simulated: draw a sample, find the node nearest to it, simulate up to ``num_children`` actions
    there (each of the 8 discrete actions once), test every child for the goal, discard invalid children and add the
    others to the tree. Nodes at the depth of the action limit are not added, so a plan always has under 50 actions.

    There are three kinds of samples. With probability ``goal_bias``, a *pushing* sample: the desired object in the
    target region, the gripper at the object's position in each node, on the side opposite to the target region and
    facing it, and the obstacles at their initial positions. With probability ``gripper_bias``, only the gripper's pose
    counts, which is on any side of the object. Otherwise, an *exploring* sample: gripper and objects anywhere.

    The distance of a node to a sample is Euclidean over all bodies, weighted as below, angles wrapped, plus
    ``depth_weight`` per action from the root, which favours short plans.

    Attributes:
        num_children: k, simulated actions per expansion (Sec. 7.5); only in the continuous space.
        num_directed: number of these actions towards the sampled gripper pose, with noise; the others are uniform.
        direction_noise: standard deviation of that noise in units of the action range.
        gripper_persistence: probability that a child keeps the commanded gripper state; only in the continuous space.
        goal_bias: probability of a pushing sample with the desired object in the target region.
        gripper_bias: probability of a sample in which only the gripper's pose near the desired object counts.
        standoff: largest distance of a pushing gripper's frame from the centre of the desired object [m].
        heading_weight: of the gripper's angle [m/rad].
        object_weight: of the desired object's position, relative to the gripper's.
        obstacle_weight: of the obstacles' positions, relative to the gripper's.
        depth_weight: of an action from the root [m].
        max_simulations: simulated actions after which the search gives up.
        time_limit_s: time limit [s], 180 in Sec. 7.5; None for results that depend only on the seed.
        shorten: whether to remove actions that the found plan does not need (:func:`shorten_plan`).
        name: in tables and figures.

    Raises:
        ConfigError: a parameter is out of range.
    """

    num_children: Count = 8
    num_directed: Index = 4
    direction_noise: NonNegative = 0.3
    gripper_persistence: Fraction = 0.8
    goal_bias: Fraction = 0.5
    gripper_bias: Fraction = 0.25
    standoff: NonNegative = 0.1
    heading_weight: NonNegative = 0.06
    object_weight: NonNegative = 1.0
    obstacle_weight: NonNegative = 0.3
    depth_weight: NonNegative = 0.01
    max_simulations: Count = 100_000
    time_limit_s: Positive | None = None
    shorten: bool = False
    name: str = "K.RRT"

    def __post_init__(self) -> None:
        if self.num_directed > self.num_children:
            raise ValueError(
                f"num_directed={self.num_directed}: it should be from 0 to num_children={self.num_children}."
            )
        if self.goal_bias + self.gripper_bias > 1.0:
            raise ValueError(
                f"goal_bias={self.goal_bias} and gripper_bias={self.gripper_bias} are probabilities with a sum of at "
                "most 1."
            )

    def start(self, model: PlanningModel, rng: np.random.Generator) -> Policy:
        """Plan at the first call, then follow the plan open loop; without a plan, or after its end, give up."""
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
        """Search for a plan from ``state`` to a goal state with at most ``max_actions``, by default 49."""
        search = TreeSearch(self, model, state, rng, max_actions)
        while not search.is_over:
            search.expand()
        plan, num_simulated = search.plan, search.num_simulated
        if self.shorten and plan is not None:
            plan, num_resimulated = shorten_plan(model, plan)
            num_simulated += num_resimulated
        return SearchResult(plan, num_simulated, search.num_nodes)

    def draw_sample(self, scene: Scene, start: State, rng: np.random.Generator) -> Sample:
        """Draw a pushing, approaching or exploring sample, for a search from ``start``."""
        kind = rng.random()
        if kind < self.goal_bias:
            return PushingSample(self, scene, start, rng, with_object=True)
        if kind < self.goal_bias + self.gripper_bias:
            return PushingSample(self, scene, start, rng, with_object=False)
        return ExploringSample(self, scene, rng)


class TreeSearch:
    """A search in progress: the tree of :class:`KinodynamicRRT`, grown one expansion at a time.

    Attributes:
        plan: the path to the first simulated goal state; None until there is one.
        num_simulated: simulated actions so far.
    """

    def __init__(
        self, planner: KinodynamicRRT, model: PlanningModel, root: State, rng: np.random.Generator, max_actions: int
    ) -> None:
        self.plan = Episode((root,), (), (), Outcome.SUCCESS) if model.is_goal(root) else None
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
        """Number of states in the tree; nodes are numbered in the order of insertion, the root is 0."""
        return len(self._tree.states)

    def expand(self) -> range:
        """Draw a sample and simulate actions in the node nearest to it; return the nodes added to the tree.

        The first child in a goal state becomes the end of the plan, and ends the expansion.
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
    """Remove actions from ``plan`` while the remaining ones, simulated again, still reach a goal state.

    Actions are removed one at a time, in order; the actions after it are simulated from the state before it, and kept
    up to the first goal state, if one is reached before a drop. The plan is returned once no single action can be
    removed: it is not longer than before, and a fixed point of this function. No random numbers are used.

    Returns:
        The plan, and the number of simulated actions.
    """
    num_simulated = index = num_needed = 0  # the last ``num_needed`` attempts, in cyclic order, failed
    while num_needed < len(plan):
        index = index if index < len(plan) else 0
        tail, num_tail = replay(model, plan.states[index], plan.actions[index + 1 :])
        num_simulated += num_tail
        if tail is None:
            index, num_needed = index + 1, num_needed + 1
            continue
        states, rewards = (*plan.states[:index], *tail.states), (*plan.rewards[:index], *tail.rewards)
        plan = Episode(states, (*plan.actions[:index], *tail.actions), rewards, Outcome.SUCCESS)
        num_needed = 0
    return plan, num_simulated


def replay(model: PlanningModel, state: State, actions: Sequence[Action]) -> tuple[Episode | None, int]:
    """Execute ``actions`` from ``state``, up to the first terminal state.

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


class _Tree:
    """States reached so far, starting with the root, in arrays that grow by doubling."""

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

    def nearest(self, sample: Sample) -> int | None:
        """The open node nearest to ``sample``; None if all are closed."""
        count = len(self.states)
        distances = np.sqrt(sample.squared_distances(self._vectors[:count])) + self._penalties[:count]
        node = int(np.argmin(distances))
        return node if math.isfinite(distances[node]) else None

    def close(self, node: int) -> None:
        """Never expand ``node`` again."""
        self._penalties[node] = math.inf

    def add(self, parent: int, arrival: Transition) -> None:
        """Add the state that ``arrival`` led to, unless it is known or at the depth of the action limit."""
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

_Proposal = Callable[[_Tree, int, Sample, np.random.Generator], Sequence[Action]]
"""Returns the actions to simulate in a node of the tree, given the sample to which it is nearest."""


def _every_action_once(tree: _Tree, node: int, sample: Sample, rng: np.random.Generator) -> Sequence[Action]:
    """All discrete actions; the node is closed, since repeating them would give the same children."""
    tree.close(node)
    return range(DiscreteActionSpace.NUM_ACTIONS)


def _partly_directed(planner: KinodynamicRRT) -> _Proposal:
    """Continuous actions: some towards the sampled gripper pose, with noise, the others uniform."""

    def propose(tree: _Tree, node: int, sample: Sample, rng: np.random.Generator) -> Sequence[Action]:
        actions = rng.uniform(-1.0, 1.0, (planner.num_children, ContinuousActionSpace.DIMENSION))
        directed = actions[: planner.num_directed]
        directed[:, :3] = _action_towards(sample.gripper_pose(tree.states[node].vector), tree.states[node])
        directed[:, :3] += rng.normal(0.0, planner.direction_noise, (planner.num_directed, 3))
        command = 1.0 if tree.states[node].gripper_closed else -1.0
        keeps = rng.random(planner.num_children) < planner.gripper_persistence
        actions[:, 3] = np.abs(actions[:, 3]) * np.where(keeps, command, -command)
        return list(actions.clip(-1.0, 1.0))

    return propose


def _action_towards(goal: tuple[float, float, float], state: State) -> tuple[float, float, float]:
    """Longitudinal, lateral and rotational component of the action whose motion ends closest to the pose ``goal``."""
    x, y, theta = state.gripper_pose.tolist()
    dx, dy = (goal[0] - x) / ContinuousActionSpace.TRANSLATION, (goal[1] - y) / ContinuousActionSpace.TRANSLATION
    forward, left = math.cos(theta) * dx + math.sin(theta) * dy, math.cos(theta) * dy - math.sin(theta) * dx
    scale = max(abs(forward), abs(left), 1.0)  # scaling keeps the direction
    turn = wrap_angle(goal[2] - theta) / ContinuousActionSpace.ROTATION
    return forward / scale, left / scale, min(max(turn, -1.0), 1.0)
