"""Learn a heuristic by imitating the demonstrations (Sec. 6.2): ``python -m pipelines.train_il``.

The image representation has one network; the Cartesian one has a network for each number of objects, trained in
parallel on the demonstrations of that density and tracked as child runs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.app import app
from pipelines.config import QImitationConfig as QImitationSettings
from pipelines.config import TrainILConfig
from pipelines.training import Part, Training, demonstrations_of, greedy_validation, observation_function

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import nn

    from visualrhp.learning.demonstrations import DemonstrationSet
    from visualrhp.learning.imitation import ImitationLearner, Metrics

STAGE = "train_il"

_STATE = "state.safetensors"
_CURVES = (
    "greedy/success_rate",
    "greedy/action_efficiency",
    "train/loss",
    "validation/loss",
    "validation/value_rmse",
    "validation/agreement",
    "train/log_likelihood",
    "validation/log_likelihood",
    "train/entropy",
)


@app(STAGE, TrainILConfig)
def main(config: TrainILConfig) -> None:
    from pipelines.tracking import open_run
    from pipelines.work import discard, publish, work_folder

    inputs = {"demonstrations": str(_open_demonstrations(config).card["content_hash"])}
    work = work_folder(config, STAGE, inputs)
    with open_run(config, STAGE, f"IL {config.action_space.name} {config.representation.name}", work) as run:
        folder = TRAINING.run(config, config.learner.epochs, work, run)
        publish(folder, config.paths.artefact)
    discard(work)


def make_learner(config: TrainILConfig, part: Part) -> ImitationLearner:
    """The training of one network, ready to run or to be resumed.

    Raises:
        ConfigError: a parameter is out of range.
        DataError: the demonstrations are missing, damaged, of the other action space, or none has the part's density.
    """
    import torch

    from visualrhp.heuristics.learned import LearnedHeuristic
    from visualrhp.heuristics.networks import make_network
    from visualrhp.learning.imitation import (
        ActorCriticImitationConfig,
        ImitationData,
        ImitationLearner,
        QImitationConfig,
    )

    observe = observation_function(config, part)
    demonstrations = islice(demonstrations_of(_open_demonstrations(config), part), config.max_demonstrations)
    data = ImitationData.from_demonstrations(demonstrations, observe, config.learner.discount)
    parameters = asdict(config.learner)
    del parameters["algorithm"]
    kind = QImitationConfig if isinstance(config.learner, QImitationSettings) else ActorCriticImitationConfig
    torch.manual_seed(config.seed)  # of the initial weights; the learner has a generator of its own
    network = make_network(config.action_space.name, observe).to(config.device)
    validate = greedy_validation(config, part)

    def evaluate(candidate: nn.Module) -> Mapping[str, float]:
        assert validate is not None
        return validate(LearnedHeuristic(candidate))  # pyright: ignore[reportArgumentType]

    return ImitationLearner(
        network, data, kind(**parameters), config.seed, evaluate if validate else None, config.validation.every
    )


def train_part(config: TrainILConfig, part: Part, folder: Path) -> Iterator[Metrics]:
    """Train one network in ``folder``, going on from what is there; yields a row of metrics an epoch."""
    from pipelines.work import card
    from visualrhp.files import write_json
    from visualrhp.heuristics.checkpoint import save_heuristic

    learner = make_learner(config, part)
    state = folder / _STATE
    if state.is_file():
        learner.load(state)
    for row in learner.run():
        learner.save(state)
        yield row
    metrics = summary(learner.history)
    content_hash = _open_demonstrations(config).card["content_hash"]
    about = card(config, STAGE, part=part.name, metrics=metrics, demonstrations=content_hash)
    save_heuristic(folder / "heuristic.safetensors", learner.network, about)
    write_json(folder / "history.json", learner.history)
    write_json(folder / "metrics.json", metrics)


def summary(history: list[Metrics]) -> dict[str, Any]:
    """What the training came to; times are left out."""
    last = history[-1]
    words = {"train/": "train", "validation/": "validation", "greedy/": "greedy"}
    metrics: dict[str, Any] = {"epochs": int(last["epoch"])}
    for prefix, group in words.items():
        rows = {name.removeprefix(prefix): value for name, value in last.items() if name.startswith(prefix)}
        if rows:
            metrics[group] = {name: value for name, value in rows.items() if not name.endswith("_time_s")}
    return metrics


def _open_demonstrations(config: TrainILConfig) -> DemonstrationSet:
    from visualrhp.errors import DataError
    from visualrhp.learning.demonstrations import DemonstrationSet

    demonstrations = DemonstrationSet.open(config.demonstrations, config.action_space.name)
    if config.max_demonstrations is not None and config.max_demonstrations > len(demonstrations):
        raise DataError(
            f"max_demonstrations={config.max_demonstrations}, but {config.demonstrations} has {len(demonstrations)}; "
            "generate more of them, or say null to use all."
        )
    return demonstrations


TRAINING = Training(STAGE, "Imitation", "epoch", _CURVES, train_part)


if __name__ == "__main__":
    main()
