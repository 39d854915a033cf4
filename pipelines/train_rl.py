"""Improve the heuristic by reinforcement learning (Sec. 6.3): ``python -m pipelines.train_rl``.

Starts from the networks of ``train_il``: DQN with eps-RHP in the discrete action space (its replay buffer starts with
the demonstrations), C3PO on PPO in the continuous one. The image representation has one network; the Cartesian one has a
network for each number of objects, trained in parallel and tracked as child runs.

What is published as ``heuristic*.safetensors`` is the network with the best success rate of the greedy policy on
validation tasks after any iteration, the initial network included; ``last*.safetensors`` is the network after the last
iteration. Both are in the metrics, with the network that the training started from.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.app import app
from pipelines.config import DQNLearnerConfig, TrainRLConfig
from pipelines.training import Part, Training, demonstrations_of, greedy_validation, parts_of, scene_distribution

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import nn

    from visualrhp.learning.reinforcement import Metrics, ReinforcementLearner

STAGE = "train_rl"

_STATE = "state.safetensors"
_SAVE_INTERVAL_S = 30.0
"""At least this long between two saved states of a training; a killed one loses no more."""

_REPORTED = ("success_rate", "dropped_rate", "action_efficiency", "num_actions")
_CURVES = (
    "greedy/success_rate",
    "greedy/action_efficiency",
    "collection/success_rate",
    "collection/return",
    "value/td_rmse",
    "policy/entropy",
    "policy/kl",
    "baseline/kl",
    "q/loss",
)


@app(STAGE, TrainRLConfig)
def main(config: TrainRLConfig) -> None:
    from pipelines.tracking import open_run
    from pipelines.work import discard, publish, work_folder

    parts = parts_of(config)
    work = work_folder(config, STAGE, _input_hashes(config, parts))
    with open_run(config, STAGE, f"reinforcement {config.action_space.name} {config.representation.name}", work) as run:
        folder = TRAINING.run(config, config.learner.iterations, work, run)
        publish(folder, config.paths.artefact)
    discard(work)


def make_learner(config: TrainRLConfig, part: Part, replay_folder: Path | None = None) -> ReinforcementLearner:
    """The training of one network, ready to run or to be resumed.

    Raises:
        CheckpointError: the network to start from is missing, damaged, or of another action space or representation.
        ConfigError: a parameter is out of range.
        DataError: the demonstrations are missing or damaged.
    """
    from visualrhp.environments.batched import BatchedClutterEnv
    from visualrhp.heuristics.checkpoint import load_network
    from visualrhp.heuristics.learned import LearnedHeuristic
    from visualrhp.simulation import Physics

    distribution = scene_distribution(config, part)
    physics = Physics(**asdict(config.physics))
    network, _ = load_network(_start_path(config, part), config.action_space.name)
    network.to(config.device)
    _check_representation(config, part, network.observation)
    learner = config.learner
    env = BatchedClutterEnv(
        distribution,
        config.action_space.name,
        config.representation.name,
        learner.num_envs,
        seed=config.seed,
        physics=physics,
    )

    validate = greedy_validation(config, part)

    def evaluate(candidate: nn.Module) -> Mapping[str, float]:
        assert validate is not None
        return validate(LearnedHeuristic(candidate))  # pyright: ignore[reportArgumentType]

    common: dict[str, Any] = {
        "seed": config.seed,
        "evaluate": evaluate if validate else None,
        "evaluate_every": config.validation.every,
    }
    parameters = asdict(learner)
    for name in ("algorithm", "iterations", "num_envs"):
        del parameters[name]
    if isinstance(learner, DQNLearnerConfig):
        from visualrhp.learning.demonstrations import DemonstrationSet
        from visualrhp.learning.dqn import DQN, DQNConfig
        from visualrhp.planning import RecedingHorizon

        for name in ("num_rollouts", "horizon", "temperature"):
            del parameters[name]
        heuristic = LearnedHeuristic(network, learner.temperature)
        planner = RecedingHorizon(heuristic, learner.num_rollouts, learner.horizon, learner.discount)
        demonstrations = demonstrations_of(
            DemonstrationSet.open(config.demonstrations, config.action_space.name), part
        )
        return DQN(
            network, env, planner, DQNConfig(**parameters), demonstrations, replay_folder=replay_folder, **common
        )
    from visualrhp.learning.c3po import C3PO, C3POConfig

    return C3PO(network, env, C3POConfig(**parameters), **common)


def train_part(config: TrainRLConfig, part: Part, folder: Path) -> Iterator[Metrics]:
    """Train one network in ``folder``, going on from what is there; yields a row of metrics an iteration.

    Leaves ``state.safetensors``, ``heuristic.safetensors`` (the best) and ``last.safetensors``.
    """
    import time

    from pipelines.work import card
    from visualrhp.files import write_json
    from visualrhp.heuristics.checkpoint import save_heuristic

    learner = make_learner(config, part)
    state = folder / _STATE
    if state.is_file():
        learner.load(state)
    saved = time.monotonic()
    for row in learner.run(config.learner.iterations):
        if time.monotonic() - saved >= _SAVE_INTERVAL_S or learner.iteration == config.learner.iterations:
            learner.save(state)
            saved = time.monotonic()
        yield row
    metrics = summary(learner.history, learner.best_iteration)
    about = card(config, STAGE, part=part.name, iteration=learner.best_iteration, metrics=metrics)
    best = learner.best_network if config.validation.num_instances else learner.network
    save_heuristic(folder / "heuristic.safetensors", best, about)  # pyright: ignore[reportArgumentType]
    about["iteration"] = learner.iteration
    save_heuristic(folder / "last.safetensors", learner.network, about)  # pyright: ignore[reportArgumentType]
    write_json(folder / "history.json", learner.history)
    write_json(folder / "metrics.json", metrics)


def summary(history: list[Metrics], best_iteration: int) -> dict[str, Any]:
    """Greedy performance of the initial, the best and the last network, and what it took; times are left out."""
    evaluated = [row for row in history if "greedy/success_rate" in row]
    metrics: dict[str, Any] = {"iterations": int(history[-1]["iteration"])}
    if evaluated:
        best = next(row for row in evaluated if row["iteration"] == best_iteration)
        metrics["best_iteration"] = best_iteration
        for name, row in (("initial", evaluated[0]), ("best", best), ("last", evaluated[-1])):
            metrics[name] = {key: row[f"greedy/{key}"] for key in _REPORTED if f"greedy/{key}" in row}
    if "collection/transitions" in history[-1]:
        metrics["transitions"] = int(history[-1]["collection/transitions"])
    return metrics


# --------------------------------------------------------------------------------------------------------------- inputs
def _start_path(config: TrainRLConfig, part: Part) -> Path:
    return Path(config.heuristic) / f"heuristic{part.suffix}.safetensors"


def _input_hashes(config: TrainRLConfig, parts: list[Part]) -> dict[str, str]:
    """Hashes of what the training starts from; whatever is missing or damaged is found here, before any work."""
    import hashlib

    from visualrhp.heuristics.checkpoint import load_network

    hashes = {}
    for part in parts:
        path = _start_path(config, part)
        network, _ = load_network(path, config.action_space.name)
        _check_representation(config, part, network.observation)
        hashes[part.name] = hashlib.sha256(path.read_bytes()).hexdigest()
    if isinstance(config.learner, DQNLearnerConfig):
        from visualrhp.learning.demonstrations import DemonstrationSet

        demonstrations = DemonstrationSet.open(config.demonstrations, config.action_space.name)
        hashes["demonstrations"] = str(demonstrations.card["content_hash"])
    return hashes


def _check_representation(config: TrainRLConfig, part: Part, observation: Any) -> None:
    from visualrhp.errors import CheckpointError

    expected = part.num_objects[0] if config.representation.name == "cartesian" else None
    if (observation.name, observation.num_objects) != (config.representation.name, expected):
        raise CheckpointError(
            f"{_start_path(config, part)} reads {observation.name} observations of "
            f"{observation.num_objects or 'any number of'} objects, but {config.representation.name} observations of "
            f"{expected or 'any number of'} objects are asked for; give the folder of a network made for them"
        )


TRAINING = Training(STAGE, "Reinforcement", "iteration", _CURVES, train_part)


if __name__ == "__main__":
    main()
