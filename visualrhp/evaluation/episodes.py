"""Running a planner on a task in closed loop, and what is recorded of it (paper, Sec. 7.3 and 8.2)."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from visualrhp.errors import SimulationError
from visualrhp.planning.planner import Planner, PlanningModel
from visualrhp.rendering.frames import Outcome
from visualrhp.scene import Scene, SceneDistribution, Split, generator_for, perturb, sample_task_instance
from visualrhp.simulation.action_spaces import ActionSpace
from visualrhp.simulation.physics import Physics
from visualrhp.simulation.task import DISCOUNT, MAX_EPISODE_ACTIONS
from visualrhp.simulation.transition_model import TransitionModel
from visualrhp.types import State

_PLANNER_STREAM = 1
_NOISE_STREAM = 2


@dataclass(frozen=True, slots=True)
class EpisodeResult:
    """What became of one task.

    Attributes:
        outcome: "success" (the desired object reached the target region in under 50 actions and nothing was dropped),
            "dropped", "out of actions", "no plan" (the planner gave up at once), "plan failed" (an open-loop plan ended
            without success) or "diverged" (the physics of the world failed).
        num_objects: m of the scene.
        num_actions: actions executed; without a plan, the full limit, 49.
        discounted_return: G_0 of Sec. 4 over the actions executed.
        decision_time_s: time the planner took to choose all actions of the task, wall clock [s].
        simulation_time_s: time to roll the physics of the executed actions, wall clock [s].
        num_invalid_rollouts: roll-outs that diverged, over all decisions.
        states: the L + 1 states passed through, initial first; empty unless asked for.
    """

    outcome: Outcome
    num_objects: int
    num_actions: int
    discounted_return: float
    decision_time_s: float
    simulation_time_s: float
    num_invalid_rollouts: int = 0
    states: tuple[State, ...] = ()

    @property
    def success(self) -> bool:
        """Whether the task was completed."""
        return self.outcome == "success"

    @property
    def dropped(self) -> bool:
        """Whether an object fell off the surface."""
        return self.outcome == "dropped"

    @property
    def action_efficiency(self) -> float:
        """Number of objects in the scene over number of actions until completion (Sec. 7.3); NaN if not completed."""
        return self.num_objects / self.num_actions if self.success and self.num_actions > 0 else math.nan

    @property
    def execution_time_s(self) -> float:
        """Planning and execution time of the run (Sec. 7.3) [s]."""
        return self.decision_time_s + self.simulation_time_s


def run_episode(
    planner: Planner,
    world: TransitionModel,
    model: PlanningModel,
    state: State,
    rng: np.random.Generator,
    *,
    keep_states: bool = False,
) -> EpisodeResult:
    """Let ``planner`` act in ``world`` until success, a drop, or 49 actions.

    Args:
        planner: decides anew in every state (a policy may still follow a plan that it made before).
        world: executes the actions; its scene may differ from the model's (Sec. 8.2).
        model: what the planner plans with, and whose scene its heuristic sees.
        state: initial state.
        rng: every random draw of the planner.
        keep_states: whether to record the states, for a video.
    """
    policy = planner.start(model, rng)
    states = [state]
    outcome: Outcome = "success" if world.is_goal(state) and not world.is_dropped(state) else "out of actions"
    num_actions, num_invalid = 0, 0
    episode_return = decision_time = simulation_time = 0.0
    while outcome == "out of actions" and num_actions < MAX_EPISODE_ACTIONS:
        started = time.perf_counter()
        decision = policy(state)
        decided = time.perf_counter()
        decision_time += decided - started
        num_invalid += decision.num_invalid
        if decision.action is None:
            outcome, num_actions = ("plan failed", num_actions) if num_actions else ("no plan", MAX_EPISODE_ACTIONS)
            break
        try:
            transition = world.simulate(state, decision.action)
        except SimulationError:
            outcome = "diverged"
            break
        simulation_time += time.perf_counter() - decided
        episode_return += DISCOUNT**num_actions * transition.reward
        num_actions += 1
        state = transition.next_state
        states.append(state)
        if transition.is_dropped:
            outcome = "dropped"
        elif transition.is_goal:
            outcome = "success"
    return EpisodeResult(
        outcome=outcome,
        num_objects=model.scene.num_objects,
        num_actions=num_actions,
        discounted_return=episode_return,
        decision_time_s=decision_time,
        simulation_time_s=simulation_time,
        num_invalid_rollouts=num_invalid,
        states=tuple(states) if keep_states else (),
    )


def run_task(
    planner: Planner,
    distribution: SceneDistribution,
    seed: int,
    split: Split,
    index: int,
    *,
    action_space: ActionSpace,
    physics: Physics | None = None,
    noise: float = 0.0,
    keep_states: bool = False,
) -> EpisodeResult:
    """Run ``planner`` on task instance ``index``: a function of the arguments alone (but for the times).

    Every planner and action space meets the same instance, and the same perturbed world at each level of ``noise``, a
    relative standard deviation on the shape, friction and density of the world's objects; the planner's model keeps the
    nominal ones (Sec. 8.2). All levels scale the same draws, so that a change of level is not a change of luck.
    """
    instance = sample_task_instance(distribution, seed, split, index)
    model = TransitionModel(instance.scene, action_space, physics)
    world = model
    if noise != 0.0:
        world = TransitionModel(perturbed_scene(instance.scene, noise, seed, split, index), action_space, physics)
    rng = generator_for(seed, split, index, _PLANNER_STREAM)
    return run_episode(planner, world, model, instance.state, rng, keep_states=keep_states)


def perturbed_scene(scene: Scene, noise: float, seed: int, split: Split, index: int) -> Scene:
    """The world of task instance ``index`` at a level of ``noise`` (a relative standard deviation)."""
    return perturb(scene, noise, generator_for(seed, split, index, _NOISE_STREAM))


def evaluate_policy(
    planner: Planner,
    distribution: SceneDistribution,
    seed: int,
    split: Split,
    indices: Iterable[int],
    action_space: ActionSpace,
    physics: Physics | None = None,
    noise: float = 0.0,
) -> list[EpisodeResult]:
    """Run ``planner`` on several task instances in this process, one after the other (see :func:`run_task`)."""
    return [
        run_task(planner, distribution, seed, split, index, action_space=action_space, physics=physics, noise=noise)
        for index in indices
    ]
