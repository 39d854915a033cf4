"""An episode: a planner acts in a world until success, a drop or the action limit (paper, Sec. 3, 7.3 and 8.2)."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np

from visualrhp.errors import CellFault, PerceptionError, SimulationError, UnreachableError
from visualrhp.execution.world import World, simulated_task
from visualrhp.planning.planner import Decision, Planner, PlanningModel
from visualrhp.scene.scene import Scene, TaskInstance
from visualrhp.simulation import rules
from visualrhp.simulation.action_spaces import ActionSpace
from visualrhp.simulation.physics import Physics
from visualrhp.streams import Split, Stream, generator_for
from visualrhp.types import Action, Episode, Outcome, State


class RunningEpisode:
    """An episode in progress in a world, with the only implementation of its end (Sec. 7.3).

    It ends with success or a drop (terminal), after 49 actions (success requires under 50), when the planner gives up,
    or when an action fails: the physics of the world fails, the arm of a robot cannot make the motion, or a fault stops
    the robot. A failed action leaves the state unchanged.

    Args:
        world: the world, in its initial state.
        num_actions: actions already taken, for an episode that is resumed.

    Attributes:
        world: as given.
        scene: as last observed.
        state: the current one.
        num_actions: number of actions executed so far.
        reward: of the last action (Sec. 7).
        outcome: how the episode ended; None while it is in progress.
        fault: why a robot could not act or was stopped; None if it was not.
    """

    def __init__(self, world: World, num_actions: int = 0) -> None:
        self.world = world
        self.scene, self.state = world.observe()
        self.num_actions = num_actions
        self.reward = 0.0
        self.fault: str | None = None
        self.outcome: Outcome | None = self._outcome(rules.is_dropped(self.scene, self.state))
        self._states = [self.state]
        self._actions: list[Action] = []
        self._rewards: list[float] = []

    def _outcome(self, dropped: bool) -> Outcome | None:
        return rules.outcome_after(rules.is_goal(self.scene, self.state), dropped, self.num_actions)

    def act(self, action: Action) -> None:
        """Execute ``action`` and observe the result.

        Raises:
            ActionError: the action is not in the action space; nothing has changed.
        """
        try:
            self.world.act(action)
            self.scene, self.state = self.world.observe()
        except SimulationError:
            self.reward, self.outcome = rules.ACTION_REWARD, Outcome.DIVERGED
            return
        except UnreachableError as error:
            self.reward, self.outcome, self.fault = rules.ACTION_REWARD, Outcome.UNREACHABLE, str(error)
            return
        except (CellFault, PerceptionError) as error:
            self.stop(error)
            return
        self.num_actions += 1
        dropped = rules.is_dropped(self.scene, self.state)
        self.reward = rules.reward(dropped)
        self.outcome = self._outcome(dropped)
        self._states.append(self.state)
        self._actions.append(action)
        self._rewards.append(self.reward)

    def give_up(self) -> None:
        """End the episode without success: the planner has no action."""
        self.outcome = Outcome.PLAN_FAILED if self.num_actions else Outcome.NO_PLAN

    def stop(self, fault: CellFault | PerceptionError) -> None:
        """End the episode without success: ``fault`` has brought the robot to rest."""
        self.reward, self.outcome, self.fault = rules.ACTION_REWARD, Outcome.STOPPED, str(fault)

    @property
    def episode(self) -> Episode:
        """The transitions since this object was made."""
        return Episode(tuple(self._states), tuple(self._actions), tuple(self._rewards), self.outcome)


@dataclass(frozen=True, slots=True)
class TimedDecision:
    """A decision, the state in which it was made, and the wall-clock time that it took [s]."""

    state: State
    decision: Decision
    time_s: float


@dataclass(frozen=True, slots=True)
class EpisodeResult:
    """Result of an episode.

    Attributes:
        scene: as observed at the end.
        episode: states, actions, rewards and outcome.
        decisions: in order; the last one may have no action, or one that failed.
        simulation_time_s: wall-clock time to execute the actions [s].
        fault: why a robot could not act or was stopped; None if it was not.
    """

    scene: Scene
    episode: Episode
    decisions: tuple[TimedDecision, ...]
    simulation_time_s: float
    fault: str | None = None

    @property
    def outcome(self) -> Outcome:
        """How the episode ended."""
        assert self.episode.outcome is not None  # only a finished episode has a result
        return self.episode.outcome

    @property
    def success(self) -> bool:
        """Whether the task was completed."""
        return self.outcome is Outcome.SUCCESS

    @property
    def dropped(self) -> bool:
        """Whether an object fell off the surface."""
        return self.outcome is Outcome.DROPPED

    @property
    def num_objects(self) -> int:
        """Number of objects m in the scene."""
        return self.scene.num_objects

    @property
    def num_actions(self) -> int:
        """Actions executed; without a plan, the action limit, 49."""
        return rules.MAX_EPISODE_ACTIONS if self.outcome is Outcome.NO_PLAN else len(self.episode)

    @property
    def discounted_return(self) -> float:
        """G_0 of Sec. 4 over the executed actions."""
        return sum((rules.DISCOUNT**k * reward for k, reward in enumerate(self.episode.rewards)), 0.0)

    @property
    def decision_time_s(self) -> float:
        """Time that the planner took to choose all actions, wall clock [s]."""
        return sum((timed.time_s for timed in self.decisions), 0.0)

    @property
    def num_invalid_rollouts(self) -> int:
        """Roll-outs that diverged, over all decisions."""
        return sum(timed.decision.num_invalid for timed in self.decisions)

    @property
    def action_efficiency(self) -> float:
        """Number of objects in the scene over number of actions until completion (Sec. 7.3); NaN if not completed."""
        return self.num_objects / self.num_actions if self.success and self.num_actions > 0 else math.nan

    @property
    def execution_time_s(self) -> float:
        """Planning and execution time of the run (Sec. 7.3) [s]."""
        return self.decision_time_s + self.simulation_time_s


class EpisodeListener:
    """Receives the events of a running episode, for instance to show it. By default, the methods do nothing."""

    def observed(self, state: State, outcome: Outcome | None) -> None:
        """Called for every observed state, including the initial one; ``outcome`` is None until the episode ends."""

    def decided(self, decision: TimedDecision) -> None:
        """Called after the planner chose an action, before it is executed."""


def run_episode(
    planner: Planner,
    world: World,
    model: PlanningModel,
    rng: np.random.Generator,
    listener: EpisodeListener | None = None,
) -> EpisodeResult:
    """Run ``planner`` in ``world`` until the episode is over.

    Where the number of objects in the observed scene changes, as a camera may find, the policy starts anew.

    Args:
        planner: decides in every state (its policy may follow an earlier plan).
        world: executes the actions; its scene may differ from the model's (Sec. 8.2).
        model: the model that the planner uses; its heuristic observes the scene of the model.
        rng: source of all random numbers of the planner.
        listener: receives states and decisions.
    """
    listener = listener or EpisodeListener()
    policy = planner.start(model, rng)
    running = RunningEpisode(world)
    num_objects = running.scene.num_objects
    decisions: list[TimedDecision] = []
    simulation_time = 0.0
    listener.observed(running.state, running.outcome)
    while running.outcome is None:
        if running.scene.num_objects != num_objects:  # a camera found another one, or one less
            policy, num_objects = planner.start(model, rng), running.scene.num_objects
        started = time.perf_counter()
        try:
            decision = policy(running.state)
        except (CellFault, PerceptionError) as error:
            running.stop(error)
            break
        decided = time.perf_counter()
        decisions.append(TimedDecision(running.state, decision, decided - started))
        listener.decided(decisions[-1])
        if decision.action is None:
            running.give_up()
            break
        acting = time.perf_counter()
        running.act(decision.action)
        simulation_time += time.perf_counter() - acting
        if running.outcome is None or not running.outcome.is_failed_action:
            listener.observed(running.state, running.outcome)
    return EpisodeResult(running.scene, running.episode, tuple(decisions), simulation_time, running.fault)


def run_task(
    planner: Planner,
    instance: TaskInstance,
    seed: int,
    split: Split,
    index: int,
    *,
    action_space: ActionSpace,
    physics: Physics | None = None,
    noise: float = 0.0,
    listener: EpisodeListener | None = None,
) -> EpisodeResult:
    """Run ``planner`` on ``instance``, the task instance ``index``: except for the times, a function of the arguments.

    All planners act in the same perturbed world at each level of ``noise`` (see
    :func:`visualrhp.execution.world.simulated_task`).
    """
    world, model = simulated_task(instance, seed, split, index, action_space=action_space, physics=physics, noise=noise)
    return run_episode(planner, world, model, generator_for(seed, split, index, Stream.PLANNER), listener)
