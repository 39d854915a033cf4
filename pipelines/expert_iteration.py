"""Improve a heuristic by imitating the planner that it guides: ``python -m pipelines.expert_iteration``.

Not in the paper (:mod:`visualrhp.learning.expert_iteration`). Starts from the networks of ``train_rl``. The planner
solves task instances on all workers of the executor; an image network then learns from them in this process. Cartesian
networks, one per number of objects, are trained in parallel, each on one worker.

``heuristic*.safetensors`` is the network with which the planner scores highest on validation tasks, the initial one
included; ``last*.safetensors`` is the network after the last round.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from pipelines.training import (
    Inputs,
    Part,
    Training,
    greedy_evaluation,
    observation_of,
    read_start_networks,
    start_path,
)
from pipelines.workflow.app import app

if TYPE_CHECKING:
    from pipelines.config import ExpertIterationConfig
    from visualrhp.learning.expert_episodes import Arrays, ExpertSetting
    from visualrhp.learning.expert_iteration import ExpertIteration
    from visualrhp.planning import RecedingHorizon
    from visualrhp.types import Metrics

STAGE = "expert_iteration"


@app(STAGE)
def main(config: ExpertIterationConfig) -> None:
    from pipelines.workflow.publishing import publish
    from pipelines.workflow.tracking import open_run
    from pipelines.workflow.workspace import open_work

    inputs = Inputs(read_start_networks(config))
    name = f"ExIt {config.action_space.name} {config.observation.name}"
    with open_work(config, STAGE, inputs.hashes) as work, open_run(config, STAGE, name, work) as run:
        folder = TRAINING.run(inputs.store(config, work), config.learner.rounds, work, run)
        publish(folder, config.paths.artefact, STAGE)


def make_learner(config: ExpertIterationConfig, part: Part, folder: Path) -> ExpertIteration:
    """Make the training of one network in ``folder``, ready to run or to be resumed."""
    from visualrhp.learning.expert_iteration import ExpertIteration

    if part.suffix:  # the networks are trained in parallel
        config = replace(config, executor=replace(config.executor, name="loky", num_workers=1, address=None))
    return ExpertIteration(
        start_path(config, part),
        folder,
        config.learner,
        config.seed,
        functools.partial(collect, config, part),
        functools.partial(validate, config, part),
        greedy_evaluation(config, part),
        config.device,
    )


def train_part(config: ExpertIterationConfig, part: Part, folder: Path) -> Iterator[Metrics]:
    """Train one network in ``folder``, or resume its training; yield one row of metrics per round."""
    from pipelines.workflow.artefacts import card
    from visualrhp.files import write_json
    from visualrhp.heuristics.conversion import load_network, save_heuristic
    from visualrhp.learning.history import expert_iteration_summary

    learner = make_learner(config, part, folder)
    yield from learner.run()
    metrics = expert_iteration_summary(learner.history, learner.best_round)
    inputs = {part.name: read_start_networks(config)[part.name].sha256}
    for stem, round_ in (("heuristic", learner.best_round), ("last", config.learner.rounds)):
        network, _ = load_network(learner.network_file(round_), config.action_space.name)
        about = card(config, STAGE, part=part.name, round=round_, metrics=metrics, inputs=inputs)
        save_heuristic(folder / f"{stem}.safetensors", network, about)
    write_json(folder / "history.json", learner.history)
    write_json(folder / "metrics.json", metrics)


def collect(
    config: ExpertIterationConfig, part: Part, network: Path, max_objects: int, blocks: Sequence[range]
) -> Iterable[tuple[range, Arrays]]:
    """Run the planner on blocks of task instances, in parallel."""
    from pipelines.workflow.executor import run_tasks

    return run_tasks(functools.partial(collect_block, config, part, network, max_objects), blocks, config.executor)


def collect_block(
    config: ExpertIterationConfig, part: Part, network: Path, max_objects: int, block: range
) -> tuple[range, Arrays]:
    """The task of a worker."""
    from visualrhp.learning.expert_episodes import run_expert_block

    return block, run_expert_block(block, build_expert(config, part, network), setting_of(config, part, max_objects))


def validate(config: ExpertIterationConfig, part: Part, network: Path) -> Arrays:
    """Run the planner on the validation instances, in parallel; rows in the order of the instances."""
    import numpy as np

    from pipelines.workflow.executor import run_tasks
    from visualrhp.learning.expert_iteration import BLOCK_SIZE

    count = config.validation.num_instances
    blocks = [range(first, min(first + BLOCK_SIZE, count)) for first in range(0, count, BLOCK_SIZE)]
    task = functools.partial(validate_block, config, part, network)
    found = dict(run_tasks(task, blocks, config.executor))
    rows = [found[block] for block in blocks]
    return {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}


def validate_block(config: ExpertIterationConfig, part: Part, network: Path, block: range) -> tuple[range, Arrays]:
    """The task of a worker."""
    from visualrhp.learning import expert_episodes

    setting = setting_of(config, part, config.learner.max_objects[1])
    return block, expert_episodes.validate_block(block, build_expert(config, part, network), setting)


def build_expert(config: ExpertIterationConfig, part: Part, network: Path) -> RecedingHorizon:
    """The planner, guided by the network in a file."""
    from pipelines.planners import cached_heuristic, parameters_of
    from visualrhp.planning import RecedingHorizon
    from visualrhp.planning.decision_task import RecedingHorizonParameters

    temperature = getattr(config.planner.heuristic, "temperature", 1.0)
    heuristic = cached_heuristic(network, config.action_space.name, observation_of(config, part), temperature)
    return RecedingHorizon(heuristic, **parameters_of(config.planner, RecedingHorizonParameters))


def setting_of(config: ExpertIterationConfig, part: Part, max_objects: int) -> ExpertSetting:
    """The episodes of a part, with up to ``max_objects`` objects if their number is not fixed."""
    from visualrhp.learning.expert_episodes import ExpertSetting

    fewest, most = part.num_objects
    return ExpertSetting(
        replace(config.scene, num_objects=(fewest, most if part.suffix else max(fewest, max_objects))),
        config.action_space.name,
        observation_of(config, part),
        config.seed,
        config.planner.discount,
        config.learner.greedy_share,
        config.learner.noise,
        config.physics,
    )


TRAINING = Training(STAGE, "Expert iteration", "round", train_part)


if __name__ == "__main__":
    main()
