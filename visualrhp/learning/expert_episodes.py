"""Episodes of the planner, from which its network learns (expert iteration). Does not import torch.

Not in the paper. A block of episodes is a unit of parallel work; its result is plain arrays, with T pairs of all
episodes concatenated:

==================  ==========  ============  ===============================================================
array               dtype       shape         content
==================  ==========  ============  ===============================================================
``observation``     see class   [T, *shape]   of the state
``gripper_closed``  bool        [T]           the gripper was last commanded to close
``action``          float32     [T, 4]        the planner's action; int64 [T] in the discrete space
``returns``         float32     [T]           discounted return after this action
``steps_to_go``     int64       [T]           L - l
``episode``         int64       [T]           index of the task instance
``is_target``       bool        [T]           the policy learns the action
``is_valued``       bool        [T]           the value learns the return
``num_objects``     int64       [E]           objects m, of each of E episodes
``success``         bool        [E]           the task was completed
``dropped``         bool        [E]           an object was dropped
``num_actions``     int64       [E]           actions executed
``is_greedy``       bool        [E]           the mode of the policy acted, instead of the planner
==================  ==========  ============  ===============================================================
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from visualrhp.demonstrations.returns import monte_carlo_returns
from visualrhp.demonstrations.shards import read_arrays
from visualrhp.documents import FileKind
from visualrhp.execution.episode import EpisodeResult, run_task
from visualrhp.files import atomic_path
from visualrhp.observation import Observation
from visualrhp.planning.greedy import Greedy
from visualrhp.planning.planner import Decision, Planner, PlanningModel, Policy
from visualrhp.planning.receding_horizon import RecedingHorizon
from visualrhp.scene.sampling import SceneDistribution, sample_task_instance
from visualrhp.simulation import rules
from visualrhp.simulation.action_spaces import ActionSpace, make_action_space
from visualrhp.simulation.physics import Physics
from visualrhp.streams import Split, Stream, generator_for
from visualrhp.types import ActionSpaceName, Outcome, State

Arrays = dict[str, npt.NDArray[Any]]

PAIR_ARRAYS = (
    "observation",
    "gripper_closed",
    "action",
    "returns",
    "steps_to_go",
    "episode",
    "is_target",
    "is_valued",
)
"""The arrays with one row per pair."""

_PAIR_KINDS = dict(zip(PAIR_ARRAYS, ("fu", "b", "fi", "f", "i", "i", "b", "b"), strict=True))
_EPISODE_KINDS = {"num_objects": "i", "success": "b", "dropped": "b", "num_actions": "i", "is_greedy": "b"}
"""The arrays with a row per pair, and with a row per episode: letters of the kinds of their types."""

BLOCK = FileKind("a block of episodes (an npz file)", "delete it, and rerun the command to run these episodes again")


@dataclass(frozen=True)
class ExpertSetting:
    """Parameters of the episodes, without the network.

    Attributes:
        distribution: of the task instances.
        action_space: of the planner.
        observation: that the network reads.
        seed: of the task instances and the planner.
        discount: gamma of the returns.
        greedy_share: share of the episodes in which the mode of the policy acts, and the planner only decides.
        noise: relative standard deviation of shapes, friction and density in the world.
        physics: of the simulation.
    """

    distribution: SceneDistribution
    action_space: ActionSpaceName
    observation: Observation
    seed: int
    discount: float = rules.DISCOUNT
    greedy_share: float = 0.0
    noise: float = 0.0
    physics: Physics | None = None


def run_expert_block(indices: Sequence[int], planner: RecedingHorizon, setting: ExpertSetting) -> Arrays:
    """Run ``planner`` on the task instances ``indices`` of the split EXPERT_ITERATION (see the module).

    The planner decides in every state. In most episodes it also acts: the policy learns the actions of successful
    episodes, and the value the returns of all of them, failures included. In a ``greedy_share`` of the episodes, the
    mode of the policy acts, and the policy learns what the planner would have done there (as in DAgger, Ross et al.
    2011), unless all of its roll-outs drop an object; the value of the greedy policy is not learned. In the discrete
    action space, where action values are the policy, such a pair has the return of the planner's roll-out.
    """
    space = make_action_space(setting.action_space)
    blocks = [_run_episode(index, planner, setting, space) for index in indices]
    return {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}


def validate_block(indices: Sequence[int], planner: Planner, setting: ExpertSetting) -> Arrays:
    """Run ``planner`` on the task instances ``indices`` of the split VALIDATION; only the arrays with a row per
    episode."""
    space = make_action_space(setting.action_space)
    rows = [_summary(_run(index, planner, setting, space, Split.VALIDATION), False) for index in indices]
    return {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}


def score(blocks: Mapping[str, npt.NDArray[Any]], action_cost: float) -> float:
    """Mean of [success] - ``action_cost`` * actions / 49, where a failure counts 49 actions."""
    actions = np.where(blocks["success"], blocks["num_actions"], rules.MAX_EPISODE_ACTIONS)
    return float(np.mean(blocks["success"] - action_cost * actions / rules.MAX_EPISODE_ACTIONS))


def return_after(outcome: Outcome, discount: float) -> float:
    """Value of the last state of an episode: 0 if it is terminal, otherwise as many more actions as an episode may
    have, since the task is hard for the policy there."""
    if outcome.is_terminal:
        return 0.0
    return rules.ACTION_REWARD * sum(discount**k for k in range(rules.MAX_ACTIONS))


def _run(index: int, planner: Planner, setting: ExpertSetting, space: ActionSpace, split: Split) -> EpisodeResult:
    instance = sample_task_instance(setting.distribution, setting.seed, split, index)
    return run_task(
        planner,
        instance,
        setting.seed,
        split,
        index,
        action_space=space,
        physics=setting.physics,
        noise=setting.noise,
    )


def _run_episode(index: int, planner: RecedingHorizon, setting: ExpertSetting, space: ActionSpace) -> Arrays:
    split = Split.EXPERT_ITERATION
    is_greedy = generator_for(setting.seed, split, index, Stream.EXPLORATION, 0).random() < setting.greedy_share
    result = _run(index, _GreedyActing(planner) if is_greedy else planner, setting, space, split)
    episode, scene = result.episode, result.scene
    count = len(episode)
    decisions = [timed.decision for timed in result.decisions[:count]]
    chosen = [None if d.chosen is None else d.rollouts[d.chosen] for d in decisions]
    actions = list(episode.actions)
    if is_greedy:
        returns = np.array([np.nan if rollout is None else rollout.total_return for rollout in chosen])
        is_safe = [r is not None and not r.is_diverged and not rules.is_dropped(scene, r.states[-1]) for r in chosen]
        actions = [action if r is None else r.actions[0] for action, r in zip(actions, chosen, strict=True)]
        is_target = np.array(is_safe, dtype=np.bool_)
        is_valued = is_target & (setting.action_space == "discrete")
        returns = np.where(is_target, returns, 0.0)
    else:
        rewards = list(episode.rewards)
        if rewards:
            rewards[-1] += setting.discount * return_after(result.outcome, setting.discount)
        returns = monte_carlo_returns(rewards, setting.discount)
        is_target = np.array([result.success and rollout is not None for rollout in chosen], dtype=np.bool_)
        is_valued = np.ones(count, dtype=np.bool_)
    observe = setting.observation
    states = episode.states[:count]
    discrete = setting.action_space == "discrete"
    return {
        "observation": np.array([observe(scene, state) for state in states], observe.dtype).reshape(-1, *observe.shape),
        "gripper_closed": np.array([state.gripper_closed for state in states], dtype=np.bool_),
        "action": np.array(actions, np.int64) if discrete else np.array(actions, np.float32).reshape(count, -1),
        "returns": returns.astype(np.float32),
        "steps_to_go": np.arange(count, 0, -1),
        "episode": np.full(count, index),
        "is_target": is_target,
        "is_valued": is_valued,
        **_summary(result, is_greedy),
    }


def _summary(result: EpisodeResult, is_greedy: bool) -> Arrays:
    return {
        "num_objects": np.array([result.num_objects]),
        "success": np.array([result.success]),
        "dropped": np.array([result.dropped]),
        "num_actions": np.array([len(result.episode)]),
        "is_greedy": np.array([is_greedy]),
    }


class _GreedyActing(Planner):
    """Decisions of a planner, but actions of the greedy policy of its heuristic."""

    def __init__(self, planner: RecedingHorizon) -> None:
        self.name = planner.name
        self._planner = planner

    def start(self, model: PlanningModel, rng: np.random.Generator) -> Policy:
        decide, act = self._planner.start(model, rng), Greedy(self._planner.heuristic).start(model, rng)

        def policy(state: State) -> Decision:
            return replace(decide(state), action=act(state).action)

        return policy


def write_block(path: Path, block: Arrays) -> None:
    """Write a block to a compressed npz file, atomically."""
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **block)


def read_block(path: Path) -> Arrays:
    """Read a file of :func:`write_block`.

    Raises:
        DataError: the file is missing or damaged, or holds other arrays.
    """
    block = read_arrays(path, BLOCK)
    try:
        _check_block(block)
    except ValueError as error:
        raise BLOCK.damaged(path, error) from error
    return block


def _check_block(block: Arrays) -> None:
    for name, kinds in (_PAIR_KINDS | _EPISODE_KINDS).items():
        if name not in block:
            raise ValueError(f"the array {name} is missing")
        if block[name].dtype.kind not in kinds or not block[name].ndim:
            raise ValueError(f"{name} is {block[name].dtype} of shape {list(block[name].shape)}")
    for names in (_PAIR_KINDS, _EPISODE_KINDS):
        if len(lengths := {len(block[name]) for name in names}) > 1:
            raise ValueError(f"the arrays {', '.join(names)} have different lengths ({sorted(lengths)})")
    if not all(np.isfinite(block[name]).all() for name in ("observation", "action", "returns")):
        raise ValueError("an observation, an action or a return is not finite")
