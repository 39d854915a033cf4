"""Learn a heuristic by imitating demonstrations (Sec. 6.2): ``python -m pipelines.train_il``.

One image network is trained for all numbers of objects; Cartesian networks, one per number of objects, are trained in
parallel on the demonstrations with that number, and tracked as child runs.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from pipelines.training import Inputs, Part, Training, demonstrations_of, greedy_evaluation, observation_of
from pipelines.workflow.app import app

if TYPE_CHECKING:
    from pipelines.config import TrainILConfig
    from visualrhp.demonstrations.dataset import DemonstrationSet
    from visualrhp.learning.imitation import ImitationLearner
    from visualrhp.types import Metrics

STAGE = "train_il"

_STATE = "state.safetensors"


@app(STAGE)
def main(config: TrainILConfig) -> None:
    from pipelines.workflow.publishing import publish
    from pipelines.workflow.tracking import open_run
    from pipelines.workflow.workspace import open_work

    content_hash = str(_open_demonstrations(config).card["content_hash"])
    inputs = Inputs({}, Path(config.demonstrations), content_hash)
    name = f"IL {config.action_space.name} {config.observation.name}"
    with open_work(config, STAGE, inputs.hashes) as work, open_run(config, STAGE, name, work) as run:
        folder = TRAINING.run(inputs.store(config, work), config.learner.epochs, work, run)
        publish(folder, config.paths.artefact, STAGE)


def make_learner(config: TrainILConfig, part: Part) -> ImitationLearner:
    """Make the training of one network, ready to run or to be resumed.

    Raises:
        DataError: the demonstrations are missing or damaged, have the other action space, or none has the number of
            objects of the part.
    """
    import torch

    from visualrhp.heuristics.networks import make_network
    from visualrhp.learning.imitation import ImitationLearner
    from visualrhp.learning.imitation_data import ImitationData
    from visualrhp.streams import TrainingStream

    observe = observation_of(config, part)
    demonstrations = islice(demonstrations_of(_open_demonstrations(config), part), config.max_demonstrations)
    data = ImitationData.from_demonstrations(demonstrations, observe, config.learner.discount)
    torch.manual_seed(TrainingStream.INITIAL_WEIGHTS.seed(config.seed))
    network = make_network(config.action_space.name, observe).to(config.device)
    evaluate = greedy_evaluation(config, part)
    return ImitationLearner(network, data, config.learner, config.seed, evaluate, config.validation.every)


def train_part(config: TrainILConfig, part: Part, folder: Path) -> Iterator[Metrics]:
    """Train one network in ``folder``, or resume its training; yield one row of metrics per epoch."""
    from pipelines.workflow.artefacts import card
    from visualrhp.files import write_json
    from visualrhp.heuristics.conversion import save_heuristic
    from visualrhp.learning.history import imitation_summary

    learner = make_learner(config, part)
    state = folder / _STATE
    if os.path.lexists(state):
        learner.load(state)
    for row in learner.run():
        learner.save(state)
        yield row
    metrics = imitation_summary(learner.history)
    content_hash = _open_demonstrations(config).card["content_hash"]
    about = card(config, STAGE, part=part.name, metrics=metrics, demonstrations=content_hash)
    save_heuristic(folder / "heuristic.safetensors", learner.network, about)
    write_json(folder / "history.json", learner.history)
    write_json(folder / "metrics.json", metrics)


def _open_demonstrations(config: TrainILConfig) -> DemonstrationSet:
    from visualrhp.demonstrations.dataset import DemonstrationSet
    from visualrhp.errors import DataError

    demonstrations = DemonstrationSet.open(config.demonstrations, config.action_space.name)
    if config.max_demonstrations is not None and config.max_demonstrations > len(demonstrations):
        raise DataError(
            f"max_demonstrations={config.max_demonstrations}, but {config.demonstrations} has {len(demonstrations)}; "
            "generate more of them, or set it to null to use all."
        )
    return demonstrations


TRAINING = Training(STAGE, "Imitation", "epoch", train_part)


if __name__ == "__main__":
    main()
