"""Improve the heuristic by reinforcement learning (Sec. 6.3): ``python -m pipelines.train_rl``.

Starts from the networks of ``train_il``: DQN with eps-RHP in the discrete action space (its replay buffer starts with
the demonstrations), C3PO on PPO in the continuous one. The image representation has one network; the Cartesian one has
a network for each number of objects, trained in parallel and tracked as child runs.

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
from pipelines.training import (
    Part,
    Training,
    demonstrations_of,
    greedy_validation,
    observation_function,
    parts_of,
    scene_distribution,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import nn

    from visualrhp.environments.task import ObservationFunction
    from visualrhp.heuristics.networks import ActorCritic, QNetwork
    from visualrhp.learning.demonstrations import DemonstrationSet
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
    "q/loss",
    "baseline/kl",
    "policy/entropy",
    "policy/kl",
)


@app(STAGE, TrainRLConfig)
def main(config: TrainRLConfig) -> None:
    from pipelines.tracking import open_run
    from pipelines.work import discard, publish, work_folder

    work = work_folder(config, STAGE, _input_hashes(config))
    with open_run(config, STAGE, f"RL {config.action_space.name} {config.representation.name}", work) as run:
        folder = TRAINING.run(config, config.learner.iterations, work, run)
        publish(folder, config.paths.artefact)
    discard(work)


def make_learner(config: TrainRLConfig, part: Part) -> ReinforcementLearner:
    """The training of one network, ready to run or to be resumed.

    Raises:
        CheckpointError: the network to start from is missing, damaged, or of another action space or representation.
        ConfigError: a parameter is out of range.
        DataError: the demonstrations are missing or damaged.
    """
    from visualrhp.environments.batched import BatchedClutterEnv
    from visualrhp.heuristics.learned import LearnedHeuristic
    from visualrhp.simulation import Physics

    learner = config.learner
    network = _load_start(config, part).to(config.device)
    env = BatchedClutterEnv(
        scene_distribution(config, part),
        config.action_space.name,
        config.representation.name,
        learner.num_envs,
        seed=config.seed,
        physics=Physics(**asdict(config.physics)),
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
        from visualrhp.learning.dqn import DQN, DQNConfig
        from visualrhp.planning import RecedingHorizon

        for name in ("num_rollouts", "horizon", "temperature"):
            del parameters[name]
        heuristic = LearnedHeuristic(network, learner.temperature)
        planner = RecedingHorizon(heuristic, learner.num_rollouts, learner.horizon, learner.discount)
        demonstrations = demonstrations_of(_open_demonstrations(config), part)
        return DQN(network, env, planner, DQNConfig(**parameters), demonstrations, **common)
    from visualrhp.learning.c3po import C3PO, C3POConfig

    return C3PO(network, env, C3POConfig(**parameters), **common)


def train_part(config: TrainRLConfig, part: Part, folder: Path) -> Iterator[Metrics]:
    """Train one network in ``folder``, going on from what is there; yields a row of metrics an iteration."""
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
    is_validated = config.validation.num_instances > 0
    published = {
        "heuristic": (learner.best_network, learner.best_iteration),
        "last": (learner.network, learner.iteration),
    }
    if not is_validated:  # nobody knows which one is best
        published["heuristic"] = published["last"]
    for stem, (network, iteration) in published.items():
        about = card(config, STAGE, part=part.name, iteration=iteration, metrics=metrics, inputs=_input_hashes(config))
        save_heuristic(folder / f"{stem}.safetensors", network, about)  # pyright: ignore[reportArgumentType]
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


# ------------------------------------------------------------------------------------------------------------- inputs
def _start_path(config: TrainRLConfig, part: Part) -> Path:
    return Path(config.heuristic) / f"heuristic{part.suffix}.safetensors"


def _load_start(config: TrainRLConfig, part: Part) -> QNetwork | ActorCritic:
    """The network to start from."""
    from visualrhp.errors import CheckpointError
    from visualrhp.heuristics.checkpoint import load_network

    path = _start_path(config, part)
    network, _ = load_network(path, config.action_space.name)
    expected = observation_function(config, part)
    if network.observation != expected:
        raise CheckpointError(
            f"{path} reads {_words(network.observation)}, but representation={config.representation.name} asks for "
            f"{_words(expected)}; give the folder of networks made for them as heuristic=<folder>"
        )
    return network


def _words(observation: ObservationFunction) -> str:
    return f"{observation.name} observations of {observation.num_objects or 'any number of'} objects"


def _open_demonstrations(config: TrainRLConfig) -> DemonstrationSet:
    from visualrhp.learning.demonstrations import DemonstrationSet

    return DemonstrationSet.open(config.demonstrations, config.action_space.name)


def _input_hashes(config: TrainRLConfig) -> dict[str, str]:
    """Hashes of what the training starts from; whatever is missing or damaged is found here, before any work."""
    import hashlib

    hashes = {}
    for part in parts_of(config):
        _load_start(config, part)
        hashes[part.name] = hashlib.sha256(_start_path(config, part).read_bytes()).hexdigest()
    if isinstance(config.learner, DQNLearnerConfig):
        hashes["demonstrations"] = str(_open_demonstrations(config).card["content_hash"])
    return hashes


TRAINING = Training(STAGE, "Reinforcement", "iteration", _CURVES, train_part)


if __name__ == "__main__":
    main()
