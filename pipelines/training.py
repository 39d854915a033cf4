"""Common code of the stages that train networks: one network, or one per number of objects.

An image network is for all numbers of objects and is trained in this process; Cartesian networks, one per number of
objects, are trained in parallel and tracked as child runs (Sec. 7.5).
"""

from __future__ import annotations

import functools
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.workflow.tracking import Run, flatten

if TYPE_CHECKING:
    from pipelines.config import ExpertIterationConfig, TrainILConfig, TrainRLConfig
    from pipelines.networks import NetworkFile
    from visualrhp.demonstrations.dataset import DemonstrationSet
    from visualrhp.heuristics.networks import ActorCritic, QNetwork
    from visualrhp.observation import Observation
    from visualrhp.scene import SceneDistribution
    from visualrhp.types import ActionSpaceName, Metrics

    AnyConfig = TrainILConfig | TrainRLConfig | ExpertIterationConfig
    StartedConfig = TrainRLConfig | ExpertIterationConfig

NUM_THREADS = 1
"""Number of threads of torch in a training; it determines the order of sums, and thus the last bits of a result."""


@dataclass(frozen=True)
class Part:
    """One network to train.

    Attributes:
        name: ``image``, or ``m=4``.
        num_objects: smallest and largest number of objects of its scenes.
        suffix: of its files: empty, or ``_m4``.
    """

    name: str
    num_objects: tuple[int, int]
    suffix: str = ""

    def folder(self, work: Path) -> Path:
        """The folder of the part in the work folder."""
        folder = work / self.name.replace("=", "")
        folder.mkdir(parents=True, exist_ok=True)
        return folder


def parts_of(config: AnyConfig) -> list[Part]:
    """The networks to train."""
    from pipelines.networks import network_suffix
    from visualrhp.observation import observation_class

    if not observation_class(config.observation.name).fixes_num_objects:
        return [Part(config.observation.name, config.scene.num_objects)]
    return [Part(f"m={m}", (m, m), network_suffix(m)) for m in config.observation.num_objects]


def distribution_of(config: AnyConfig, part: Part) -> SceneDistribution:
    """The distribution of the task instances of ``part``."""
    return replace(config.scene, num_objects=part.num_objects)


def observation_of(config: AnyConfig, part: Part) -> Observation:
    """The observation that the network of ``part`` reads."""
    from visualrhp.observation import observation_for

    return observation_for(config.observation.name, distribution_of(config, part))


def demonstrations_of(demonstrations: DemonstrationSet, part: Part) -> Iterator[Any]:
    """(task instance, demonstration) pairs with the numbers of objects of ``part``."""
    fewest, most = part.num_objects
    for task, episode in demonstrations:
        if fewest <= task.scene.num_objects <= most:
            yield task, episode


def load_start(path: Path, action_space: ActionSpaceName, expected: Observation) -> QNetwork | ActorCritic:
    """Load the initial network of a training.

    Raises:
        CheckpointError: it is missing or damaged, or has another action space or observation.
    """
    from visualrhp.heuristics.conversion import load_network

    network, _ = load_network(path, action_space, expected)
    return network


def start_path(config: StartedConfig, part: Part) -> Path:
    """File of the initial network."""
    return Path(config.heuristic) / f"heuristic{part.suffix}.safetensors"


@dataclass(frozen=True)
class Inputs:
    """What a training reads, as it was when the stage started.

    Attributes:
        networks: initial networks by the names of their parts.
        demonstrations: folder of the set.
        content_hash: of the set.
    """

    networks: dict[str, NetworkFile]
    demonstrations: Path | None = None
    content_hash: str | None = None

    @property
    def hashes(self) -> dict[str, str]:
        """Hash of every input."""
        hashes = {name: file.sha256 for name, file in self.networks.items()}
        return hashes if self.content_hash is None else hashes | {"demonstrations": self.content_hash}

    def store(self, config: Any, work: Path) -> Any:
        """Copy the inputs to ``work``, unless an interrupted run did; return the configuration that reads the copies.

        Raises:
            DataError: the demonstrations were replaced since the stage started.
        """
        from pipelines.workflow.publishing import copy_artefacts
        from visualrhp.demonstrations.dataset import read_card
        from visualrhp.errors import DataError
        from visualrhp.files import atomic_path

        folder = work / "inputs"
        for file in self.networks.values():
            with atomic_path(folder / file.name) as path:
                path.write_bytes(file.content)
        if self.networks:
            config = replace(config, heuristic=str(folder))
        if self.demonstrations is not None:
            copy = copy_artefacts(self.demonstrations, folder)
            if read_card(copy).get("content_hash") != self.content_hash:
                raise DataError(f"{self.demonstrations} was replaced while this command started; run it again")
            config = replace(config, demonstrations=str(copy))
        return config


def read_start_networks(config: StartedConfig) -> dict[str, NetworkFile]:
    """The initial network of every part, by its name; missing or damaged ones are found here, before any work.

    Raises:
        CheckpointError: an initial network is missing or damaged, or has another action space or observation.
    """
    from pipelines.networks import NetworkFile

    files = {}
    for part in parts_of(config):
        path = start_path(config, part)
        load_start(path, config.action_space.name, observation_of(config, part))
        files[part.name] = NetworkFile.read(path, path.name)
    return files


def greedy_evaluation(config: AnyConfig, part: Part) -> Callable[[Any], Metrics] | None:
    """The greedy evaluation between iterations; None if the configuration disables it."""
    if not config.validation.num_instances:
        return None
    from visualrhp.heuristics.conversion import heuristic_of
    from visualrhp.learning.validation import GreedyValidation

    distribution = distribution_of(config, part)
    validation = GreedyValidation(distribution, config.validation.num_instances, config.seed, physics=config.physics)
    return lambda network: validation(heuristic_of(network))


@dataclass(frozen=True)
class Training:
    """A stage that trains networks.

    Attributes:
        stage: name of the pipeline.
        label: of the progress bar.
        unit: of a row of metrics: ``epoch``, ``iteration``.
        train_part: trains one network in a folder, or resumes its training; yields one row of metrics per unit and
            writes ``heuristic.safetensors``, ``history.json`` and ``metrics.json``, and possibly further networks.
    """

    stage: str
    label: str
    unit: str
    train_part: Callable[[Any, Part, Path], Iterator[Metrics]]

    def run(self, config: AnyConfig, num_rows: int, work: Path, run: Run) -> Path:
        """Train all networks in ``work``, tracked by ``run``; return the folder of the artefact."""
        parts = parts_of(config)
        if len(parts) == 1 and not parts[0].suffix:
            self._train_here(config, parts[0], num_rows, work, run)
        else:
            self._train_in_parallel(config, parts, work, run)
        return self._assemble(config, parts, work, run)

    def _train_here(self, config: AnyConfig, part: Part, num_rows: int, work: Path, run: Run) -> None:
        """Train in this process; every row is tracked immediately."""
        import torch
        from tqdm import tqdm

        torch.set_num_threads(NUM_THREADS)
        with tqdm(total=num_rows, desc=self._description(config, part.name), unit=self.unit) as progress:
            for row in self.train_part(config, part, part.folder(work)):
                self._show(progress, row)
                run.log_metrics(self._tracked(row), step=int(row[self.unit]))
        self._track_history(part, work, run)  # a killed run may have saved rows that it did not track

    def _train_in_parallel(self, config: AnyConfig, parts: list[Part], work: Path, run: Run) -> None:
        """Train each network in a worker; this process tracks it when it is finished."""
        from tqdm import tqdm

        from pipelines.workflow.executor import run_tasks

        task = functools.partial(_train_whole_part, self.train_part, config, work)
        with tqdm(
            total=len(parts), desc=self._description(config, config.observation.name), unit="network"
        ) as progress:
            for part in run_tasks(task, parts, config.executor):
                with run.child(part.name, {"num_objects": part.num_objects[0]}) as child:
                    self._track_history(part, work, child)
                progress.update()

    def _track_history(self, part: Part, work: Path, run: Run) -> None:
        """Track all rows of a finished training that are not tracked yet."""
        for row in self._read_history(part, work):
            run.log_metrics(self._tracked(row), step=int(row[self.unit]))

    def _read_history(self, part: Part, work: Path) -> list[Metrics]:
        from visualrhp.learning import history

        schemas = {"epoch": history.EpochHistory, "iteration": history.IterationHistory, "round": history.RoundHistory}
        return history.read_history(part.folder(work) / "history.json", schemas[self.unit])

    def _show(self, progress: Any, row: Metrics) -> None:
        progress.update(int(row[self.unit]) - progress.n)
        names = {"success": "greedy/success_rate", "collected": "collection/success_rate"}
        progress.set_postfix({word: f"{row[name]:.0%}" for word, name in names.items() if name in row})

    def _tracked(self, row: Metrics) -> Metrics:
        return {name: value for name, value in row.items() if name != self.unit}

    def _description(self, config: AnyConfig, what: str) -> str:
        return f"{self.label}, {config.action_space.name} {what}"

    def _assemble(self, config: AnyConfig, parts: list[Part], work: Path, run: Run) -> Path:
        """Write the artefact: networks and cards, ``curves.csv``, ``metrics.json``, ``curves.png``, ``greedy.webm``."""
        import pandas as pd

        from pipelines.workflow.workspace import empty_folder
        from visualrhp.evaluation.styles import save
        from visualrhp.evaluation.training_figures import SHOWN_CURVES, training_curves
        from visualrhp.files import atomic_path, write_json
        from visualrhp.learning.history import read_summary

        folder = empty_folder(work / "artefact")
        metrics: dict[str, Any] = {}
        tables = {}
        for part in parts:
            made = part.folder(work)
            for path in [*made.glob("heuristic.*"), *made.glob("last.*")]:
                shutil.copyfile(path, folder / f"{path.stem}{part.suffix}{path.suffix}")
            metrics[part.name] = read_summary(made / "metrics.json")
            history = pd.DataFrame(self._read_history(part, work))
            tables[part.name] = history[[name for name in history.columns if not name.endswith(("_per_s", "_time_s"))]]
        write_json(folder / "metrics.json", metrics)
        with atomic_path(folder / "curves.csv") as path:
            pd.concat(tables, names=["network", "row"]).droplevel("row").to_csv(path)
        curves = training_curves(tables, self.unit, SHOWN_CURVES[self.stage].columns, self.unit.capitalize())
        save(curves, folder / "curves.png")
        if config.video.num_scenes:
            self._write_preview(config, parts[-1], folder)
        for path in sorted(folder.iterdir()):
            run.log_artifact(path)
        run.log_metrics(_means(metrics))
        return folder

    def _write_preview(self, config: AnyConfig, part: Part, folder: Path) -> None:
        """Write a video of the greedy policy of the last network on the first validation tasks."""
        from pipelines.previews import write_greedy_video

        write_greedy_video(
            folder / "greedy.webm",
            folder / f"heuristic{part.suffix}.safetensors",
            distribution_of(config, part),
            config.action_space.name,
            config.physics,
            config.seed,
            num_scenes=config.video.num_scenes,
            size_px=config.video.size_px,
        )


def _train_whole_part(train_part: Any, config: AnyConfig, work: Path, part: Part) -> Part:
    """The task of a worker."""
    for _ in train_part(config, part, part.folder(work)):
        pass
    return part


def _means(metrics: dict[str, Any]) -> Metrics:
    """Means of the networks' summaries: ``{"image": {"best": {"a": 1}}}`` -> ``{"best/a": 1}``."""
    rows = [flatten(part) for part in metrics.values()]
    shared = [key for key in rows[0] if all(isinstance(row.get(key), int | float) for row in rows)]
    return {key.replace(".", "/"): sum(row[key] for row in rows) / len(rows) for key in shared}
