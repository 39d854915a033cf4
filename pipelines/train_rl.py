"""Improve a heuristic by reinforcement learning (Sec. 6.3): ``python -m pipelines.train_rl``.

Starts from the networks of ``train_il``: DQN with eps-RHP in the discrete action space (its replay buffer starts with
the demonstrations), C3PO on PPO in the continuous one. One image network is trained for all numbers of
objects; Cartesian networks, one per number of objects, are trained in parallel and tracked as child runs.

``heuristic*.safetensors`` is the network with the best success rate of the greedy policy on validation tasks after any
iteration, including the initial network; ``last*.safetensors`` is the network after the last iteration. The metrics
contain both, and the initial network.
"""

from __future__ import annotations

import functools
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.training import (
    Inputs,
    Part,
    Training,
    demonstrations_of,
    distribution_of,
    greedy_evaluation,
    load_start,
    observation_of,
    read_start_networks,
    start_path,
)
from pipelines.workflow.app import app

if TYPE_CHECKING:
    from pipelines.config import DQNLearnerConfig, TrainRLConfig
    from visualrhp.demonstrations.dataset import DemonstrationSet
    from visualrhp.heuristics.networks import QNetwork
    from visualrhp.learning.reinforcement import ReinforcementLearner
    from visualrhp.planning import RecedingHorizon
    from visualrhp.types import Metrics

STAGE = "train_rl"

_STATE = "state.safetensors"
SAVE_INTERVAL_S = 30.0
"""Least time between two saved states of a training, and thus the most that a killed training loses."""


@app(STAGE)
def main(config: TrainRLConfig) -> None:
    from pipelines.workflow.publishing import publish
    from pipelines.workflow.tracking import open_run
    from pipelines.workflow.workspace import open_work

    inputs = read_inputs(config)
    name = f"RL {config.action_space.name} {config.observation.name}"
    with open_work(config, STAGE, inputs.hashes) as work, open_run(config, STAGE, name, work) as run:
        folder = TRAINING.run(inputs.store(config, work), config.learner.iterations, work, run)
        publish(folder, config.paths.artefact, STAGE)


def make_learner(config: TrainRLConfig, part: Part) -> ReinforcementLearner:
    """Make the training of one network, ready to run or to be resumed.

    Raises:
        CheckpointError: the initial network is missing or damaged, or has another action space or observation.
        ConfigError: ``learner.frames_per_batch`` is not a multiple of ``learner.num_envs``.
        DataError: the demonstrations are missing or damaged.
    """
    from visualrhp.environments.batched import BatchedClutterEnv

    learner = config.learner
    network = load_start(start_path(config, part), config.action_space.name, observation_of(config, part))
    network = network.to(config.device)
    env = BatchedClutterEnv(
        distribution_of(config, part),
        config.action_space.name,
        config.observation.name,
        learner.num_envs,
        seed=config.seed,
        physics=config.physics,
    )
    common: dict[str, Any] = {
        "seed": config.seed,
        "evaluate": greedy_evaluation(config, part),
        "evaluate_every": config.validation.every,
    }
    if learner.algorithm == "dqn":
        from visualrhp.learning.dqn import DQN

        demonstrations = demonstrations_of(_open_demonstrations(config), part)
        return DQN(network, env, functools.partial(_planner, learner), learner, demonstrations, **common)
    from visualrhp.learning.c3po import C3PO

    return C3PO(network, env, learner, **common)


def _planner(learner: DQNLearnerConfig, network: QNetwork) -> RecedingHorizon:
    """The planner of eps-RHP, guided by the current weights of ``network``."""
    from visualrhp.heuristics.conversion import heuristic_of
    from visualrhp.planning import RecedingHorizon

    return RecedingHorizon(
        heuristic_of(network, learner.temperature),
        num_rollouts=learner.num_rollouts,
        horizon=learner.horizon,
        discount=learner.discount,
    )


def train_part(config: TrainRLConfig, part: Part, folder: Path) -> Iterator[Metrics]:
    """Train one network in ``folder``, or resume its training; yield one row of metrics per iteration."""
    from pipelines.workflow.artefacts import card
    from visualrhp.files import write_json
    from visualrhp.heuristics.conversion import save_heuristic
    from visualrhp.learning.history import reinforcement_summary

    learner = make_learner(config, part)
    state = folder / _STATE
    if os.path.lexists(state):
        learner.load(state)
    saved = time.monotonic()
    for row in learner.run(config.learner.iterations):
        if time.monotonic() - saved >= SAVE_INTERVAL_S or learner.iteration == config.learner.iterations:
            learner.save(state)
            saved = time.monotonic()
        yield row
    metrics = reinforcement_summary(learner.history, learner.best_iteration)
    is_validated = config.validation.num_instances > 0
    published = {
        "heuristic": (learner.best_network, learner.best_iteration),
        "last": (learner.network, learner.iteration),
    }
    if not is_validated:  # without validation, the best one is unknown
        published["heuristic"] = published["last"]
    inputs = read_inputs(config).hashes
    for stem, (network, iteration) in published.items():
        about = card(config, STAGE, part=part.name, iteration=iteration, metrics=metrics, inputs=inputs)
        save_heuristic(folder / f"{stem}.safetensors", network, about)  # pyright: ignore[reportArgumentType]
    write_json(folder / "history.json", learner.history)
    write_json(folder / "metrics.json", metrics)


# ------------------------------------------------------------------------------------------------------------- inputs
def _open_demonstrations(config: TrainRLConfig) -> DemonstrationSet:
    from visualrhp.demonstrations.dataset import DemonstrationSet

    return DemonstrationSet.open(config.demonstrations, config.action_space.name)


def read_inputs(config: TrainRLConfig) -> Inputs:
    """The inputs of the training; missing or damaged files are found here, before any work."""
    networks = read_start_networks(config)
    if config.learner.algorithm != "dqn":
        return Inputs(networks)
    content_hash = str(_open_demonstrations(config).card["content_hash"])
    return Inputs(networks, Path(config.demonstrations), content_hash)


TRAINING = Training(STAGE, "Reinforcement", "iteration", train_part)


if __name__ == "__main__":
    main()
