"""Expert iteration: the planner solves tasks with a network, and the network learns from the planner. Not in the paper.

After Anthony, Tian and Barber, "Thinking Fast and Slow with Deep Learning and Tree Search", NeurIPS 2017. Look-ahead
makes better decisions than the policy that guides it, so imitating these decisions improves the policy, and with it the
next look-ahead.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from visualrhp.errors import DataError
from visualrhp.files import write_json
from visualrhp.heuristics.conversion import load_network, save_heuristic
from visualrhp.heuristics.networks import ActorCritic, QNetwork
from visualrhp.learning.configs import ExpertIterationConfig
from visualrhp.learning.expert_episodes import PAIR_ARRAYS, Arrays, read_block, score, write_block
from visualrhp.learning.history import RoundHistory, read_history
from visualrhp.learning.imitation import ImitationLearner
from visualrhp.learning.imitation_data import ImitationData
from visualrhp.observation import Observation
from visualrhp.streams import search_seed
from visualrhp.types import Metrics

BLOCK_SIZE = 25
"""Episodes in a block, the unit of parallel work."""

Collect = Callable[[Path, int, Sequence[range]], Iterable[tuple[range, Arrays]]]
"""Runs the planner with the network in a file: (file, largest number of objects, blocks of indices) -> blocks, in any
order (:func:`visualrhp.learning.expert_episodes.run_expert_block`)."""

Validate = Callable[[Path], Arrays]
"""Runs the planner with the network in a file on validation instances
(:func:`visualrhp.learning.expert_episodes.validate_block`)."""


class ExpertIteration:
    """Rounds of collecting episodes of the planner, imitating them, and validation.

    In each round, the planner solves new task instances with the latest network, the number of objects growing from
    round to round; a copy of that network learns from the episodes of the last rounds; and it is kept as the best one
    if the planner scores higher with it on the validation instances. The next round starts from the latest network,
    kept or not: a round improves less than validation on a few hundred instances can tell (docs/planning.md).

    Everything is in ``folder``: finished blocks, the networks of all rounds, the state of the imitation after each
    epoch, and the history. A new object with the same arguments resumes there; a kill loses at most the blocks that are
    being computed and an epoch. The result is a function of the arguments.

    Args:
        start: file of the initial network.
        folder: of all files; created if missing.
        config: parameters.
        seed: of the imitation.
        collect: runs the planner.
        validate: runs the planner.
        evaluate: further metrics of a network, such as those of its greedy policy.
        device: of the imitation.

    Attributes:
        history: one row of metrics per round. Round 0 is the validation of the initial network.

    Raises:
        DataError: the history in ``folder`` is damaged.
    """

    def __init__(
        self,
        start: Path,
        folder: Path,
        config: ExpertIterationConfig,
        seed: int,
        collect: Collect,
        validate: Validate,
        evaluate: Callable[[QNetwork | ActorCritic], Metrics] | None = None,
        device: str = "cpu",
    ) -> None:
        self.config = config
        self.history: list[Metrics] = []
        self._start = start
        self._folder = folder
        self._seed = seed
        self._collect = collect
        self._validate = validate
        self._evaluate = evaluate
        self._device = device
        folder.mkdir(parents=True, exist_ok=True)
        if os.path.lexists(self._history_file):
            self.history = read_history(self._history_file, RoundHistory)

    def run(self) -> Iterator[Metrics]:
        """Run the rounds that are missing; yield the rows of all rounds.

        Raises:
            CheckpointError: the network of a round, or the state of an imitation, is missing or damaged.
            DataError: the episodes of a round have no actions, or a block is damaged.
            LearningError: the imitation diverged.
        """
        yield from self.history
        while len(self.history) <= self.config.rounds:
            round_ = len(self.history)
            metrics = self._run_round(round_) if round_ else {}
            metrics |= self._validation(self.network_file(round_))
            metrics["validation/kept"] = float(not round_ or metrics["validation/score"] > self.best_score)
            row = {"round": float(round_), **metrics}
            self.history.append(row)
            write_json(self._history_file, self.history)
            yield row

    @property
    def best_round(self) -> int:
        """The round with the best network; 0 for the initial one."""
        return max((int(row["round"]) for row in self.history if row["validation/kept"]), default=0)

    @property
    def best_score(self) -> float:
        """Validation score of the best network."""
        return self.history[self.best_round]["validation/score"]

    def network_file(self, round_: int) -> Path:
        """File of the network after a round."""
        return self._start if round_ == 0 else self._round_folder(round_) / "network.safetensors"

    @property
    def _history_file(self) -> Path:
        return self._folder / "rounds.json"

    def _round_folder(self, round_: int) -> Path:
        return self._folder / f"round_{round_:03d}"

    def _block_file(self, round_: int, block: range) -> Path:
        return self._round_folder(round_) / f"block_{block.start:08d}.npz"

    def _blocks(self, round_: int) -> list[range]:
        """Indices of the task instances of a round; every round has new ones."""
        count = self.config.episodes_per_round
        end = round_ * count
        return [range(first, min(first + BLOCK_SIZE, end)) for first in range(end - count, end, BLOCK_SIZE)]

    def _run_round(self, round_: int) -> Metrics:
        folder, blocks = self._round_folder(round_), self._blocks(round_)
        folder.mkdir(exist_ok=True)
        missing = [block for block in blocks if not os.path.lexists(self._block_file(round_, block))]
        max_objects = self.config.max_objects_in(round_)
        for block, arrays in self._collect(self.network_file(round_ - 1), max_objects, missing):
            write_block(self._block_file(round_, block), arrays)
        metrics = _collected([read_block(self._block_file(round_, block)) for block in blocks])
        return {"collection/max_objects": float(max_objects), **metrics, **self._imitate(round_)}

    def _imitate(self, round_: int) -> Metrics:
        """Train a copy of the latest network on the episodes of the last rounds, and write it."""
        rounds = range(max(1, round_ - self.config.replay_rounds + 1), round_ + 1)
        files = [self._block_file(past, block) for past in rounds for block in self._blocks(past)]
        network, _ = load_network(self.network_file(round_ - 1))
        network.to(self._device)
        data = data_of_blocks((read_block(file) for file in files), network.observation)
        learner = ImitationLearner(network, data, self.config.imitation, search_seed(self._seed, round_))
        state = self._round_folder(round_) / "imitation.safetensors"
        if os.path.lexists(state):
            learner.load(state)
        for _ in learner.run():
            learner.save(state)
        save_heuristic(self.network_file(round_), learner.network)
        last = learner.history[-1]
        losses = {name: value for name, value in last.items() if name.startswith(("train/", "validation/"))}
        return {
            "imitation/pairs": float(len(data)),
            **{f"imitation/{name.replace('/', '_')}": value for name, value in losses.items()},
        }

    def _validation(self, file: Path) -> Metrics:
        rows = self._validate(file)
        metrics = {
            "validation/score": score(rows, self.config.action_cost),
            "validation/success_rate": float(rows["success"].mean()),
            "validation/dropped_rate": float(rows["dropped"].mean()),
            "validation/num_actions": _mean(rows["num_actions"][rows["success"]]),
        }
        if self._evaluate is not None:
            network, _ = load_network(file)
            metrics |= {f"greedy/{name}": value for name, value in self._evaluate(network).items()}
        return metrics


def data_of_blocks(blocks: Iterable[Arrays], observe: Observation) -> ImitationData:
    """Join the pairs of blocks of episodes, which are read one at a time.

    Raises:
        DataError: there are no pairs.
    """
    parts: dict[str, list[np.ndarray]] = {name: [] for name in PAIR_ARRAYS if name != "observation"}

    def observed() -> Iterator[np.ndarray]:
        for block in blocks:
            for name, part in parts.items():
                part.append(block[name])
            yield from block["observation"]

    observations = observe.store(observed())
    if not len(observations):
        raise DataError("the episodes have no actions to learn from")
    pairs: dict[str, Any] = {name: torch.from_numpy(np.concatenate(part)) for name, part in parts.items()}
    return ImitationData(
        observation=observe,
        observations=observations,
        gripper_closed=pairs["gripper_closed"],
        action=pairs["action"],
        returns=pairs["returns"],
        steps_to_go=pairs["steps_to_go"].to(torch.int32),
        demonstration=pairs["episode"].to(torch.int32),
        is_target=pairs["is_target"],
        is_valued=pairs["is_valued"],
    )


def _collected(blocks: Sequence[Arrays]) -> Metrics:
    """Metrics of the episodes of a round, by who acted."""
    rows = {
        name: np.concatenate([block[name] for block in blocks])
        for name in ("success", "dropped", "num_actions", "is_greedy")
    }
    metrics: Metrics = {"collection/episodes": float(len(rows["success"]))}
    for actor, mask in (("expert", ~rows["is_greedy"]), ("greedy", rows["is_greedy"])):
        if mask.any():
            solved = mask & rows["success"]
            metrics[f"collection/{actor}_success_rate"] = float(rows["success"][mask].mean())
            metrics[f"collection/{actor}_dropped_rate"] = float(rows["dropped"][mask].mean())
            metrics[f"collection/{actor}_num_actions"] = _mean(rows["num_actions"][solved])
    return metrics


def _mean(values: np.ndarray) -> float:
    """The mean, 0 without values."""
    return math.fsum(values.tolist()) / max(1, len(values))
