"""What the trainings of networks have in common (``train_il``, ``train_rl``): one network, or one for each density.

The image representation has one network for all numbers of objects, trained in this process; the Cartesian one has a
network for each, trained in parallel and tracked as child runs (Sec. 7.5).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from pipelines.config import TrainILConfig, TrainRLConfig
from pipelines.tracking import Run

if TYPE_CHECKING:
    from visualrhp.environments.task import ObservationFunction
    from visualrhp.learning.demonstrations import DemonstrationSet
    from visualrhp.learning.validation import GreedyValidation
    from visualrhp.scene import SceneDistribution

Config = TypeVar("Config", TrainILConfig, TrainRLConfig)
Metrics = dict[str, float]

NUM_THREADS = 1
"""Threads of torch in a training: the order of its sums, and with it the last bits of a result, depends on them."""

_VIDEO_FPS, _FRAMES_PER_ACTION = 9.0, 3
"""Drawing takes time: these are for a glance, the report has the good ones."""


@dataclass(frozen=True)
class Part:
    """One network to train.

    Attributes:
        name: ``image``, or ``m=4``.
        suffix: of its files: nothing, or ``_m4``.
        num_objects: densities of its scenes.
    """

    name: str
    suffix: str
    num_objects: tuple[int, int]

    def folder(self, work: Path) -> Path:
        """The part's own folder in the work folder."""
        folder = work / self.name.replace("=", "")
        folder.mkdir(parents=True, exist_ok=True)
        return folder


def parts_of(config: TrainILConfig | TrainRLConfig) -> list[Part]:
    """The networks to train: one for images, one for each density for Cartesian poses."""
    fewest, most = config.scene.num_objects  # type: ignore[misc]  # a pair by now
    if config.representation.name == "image":
        return [Part("image", "", (fewest, most))]
    return [Part(f"m={m}", f"_m{m}", (m, m)) for m in config.representation.num_objects]


def scene_distribution(config: TrainILConfig | TrainRLConfig, part: Part) -> SceneDistribution:
    """Where the task instances of ``part`` come from."""
    from visualrhp.scene import SceneDistribution

    return SceneDistribution(**asdict(replace(config.scene, num_objects=part.num_objects)))


def observation_function(config: TrainILConfig | TrainRLConfig, part: Part) -> ObservationFunction:
    """What the network of ``part`` reads."""
    from visualrhp.environments.task import ObservationFunction

    return ObservationFunction.for_distribution(config.representation.name, scene_distribution(config, part))


def greedy_validation(config: TrainILConfig | TrainRLConfig, part: Part) -> GreedyValidation | None:
    """The greedy evaluation between iterations, if the configuration wants one."""
    from visualrhp.learning.validation import GreedyValidation
    from visualrhp.simulation import Physics

    if not config.validation.num_instances:
        return None
    return GreedyValidation(
        scene_distribution(config, part),
        config.validation.num_instances,
        config.seed,
        physics=Physics(**asdict(config.physics)),
    )


@dataclass(frozen=True)
class Training:
    """A stage that trains networks.

    Attributes:
        stage: name of the pipeline.
        label: what the progress bar says.
        unit: what a row of metrics stands for: ``epoch``, ``iteration``.
        curves: metrics that are drawn.
        train_part: trains one network in a folder, going on from what is there; yields a row of metrics a unit and
            leaves ``heuristic.safetensors``, ``history.json`` and ``metrics.json``, perhaps further networks.
    """

    stage: str
    label: str
    unit: str
    curves: Sequence[str]
    train_part: Callable[[Any, Part, Path], Iterator[Metrics]]

    def run(self, config: TrainILConfig | TrainRLConfig, num_rows: int, work: Path, run: Run) -> Path:
        """Train all networks in ``work``, tracked by ``run``; return the folder of the artefact."""
        parts = parts_of(config)
        if len(parts) == 1 and not parts[0].suffix:
            self._train_here(config, parts[0], num_rows, work, run)
        else:
            self._train_in_parallel(config, parts, work, run)
        return self._assemble(config, parts, work, run)

    def _train_here(
        self, config: TrainILConfig | TrainRLConfig, part: Part, num_rows: int, work: Path, run: Run
    ) -> None:
        """Every row is tracked when it is there."""
        import torch
        from tqdm import tqdm

        torch.set_num_threads(NUM_THREADS)
        with tqdm(total=num_rows, desc=self._description(config, part), unit=self.unit) as progress:
            for row in self.train_part(config, part, part.folder(work)):
                self._show(progress, row)
                run.log_metrics(self._tracked(row), step=int(row[self.unit]))

    def _train_in_parallel(
        self, config: TrainILConfig | TrainRLConfig, parts: list[Part], work: Path, run: Run
    ) -> None:
        """A worker each; tracked by this process when one is done."""
        import json

        from tqdm import tqdm

        from pipelines.execution import run_tasks

        task = functools.partial(_train_whole_part, self.train_part, config, work)
        with tqdm(total=len(parts), desc=self._description(config, None), unit="network") as progress:
            for part in run_tasks(task, parts, config.executor):
                with run.child(part.name, {"num_objects": part.num_objects[0]}) as child:
                    for row in json.loads((part.folder(work) / "history.json").read_text(encoding="utf-8")):
                        child.log_metrics(self._tracked(row), step=int(row[self.unit]))
                progress.update()

    def _show(self, progress: Any, row: Metrics) -> None:
        progress.update(int(row[self.unit]) - progress.n)
        names = {"success": "greedy/success_rate", "collected": "collection/success_rate"}
        progress.set_postfix({word: f"{row[name]:.0%}" for word, name in names.items() if name in row})

    def _tracked(self, row: Metrics) -> Metrics:
        return {name: value for name, value in row.items() if name != self.unit}

    def _description(self, config: TrainILConfig | TrainRLConfig, part: Part | None) -> str:
        return f"{self.label}, {config.action_space.name} {part.name if part else config.representation.name}"

    def _assemble(self, config: TrainILConfig | TrainRLConfig, parts: list[Part], work: Path, run: Run) -> Path:
        """The artefact: networks and cards, ``curves.csv``, ``metrics.json``, ``curves.png``, ``greedy.webm``."""
        import json
        import shutil

        import pandas as pd

        from visualrhp.evaluation.figures import training_curves
        from visualrhp.files import atomic_path, write_json

        folder = work / "artefact"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        metrics: dict[str, Any] = {}
        tables = {}
        for part in parts:
            made = part.folder(work)
            for path in [*made.glob("heuristic.*"), *made.glob("last.*")]:
                shutil.copyfile(path, folder / f"{path.stem}{part.suffix}{path.suffix}")
            metrics[part.name] = json.loads((made / "metrics.json").read_text(encoding="utf-8"))
            history = pd.DataFrame(json.loads((made / "history.json").read_text(encoding="utf-8")))
            tables[part.name] = history[[name for name in history.columns if not name.endswith(("_per_s", "_time_s"))]]
        write_json(folder / "metrics.json", metrics)
        with atomic_path(folder / "curves.csv") as path:
            pd.concat(tables, names=["network", "row"]).droplevel("row").to_csv(path)
        with atomic_path(folder / "curves.png") as path:
            training_curves(tables, self.unit, self.curves, self.unit).savefig(path, dpi=120)
        if config.video.num_scenes:
            _write_video(config, parts[-1], folder)
        for path in sorted(folder.iterdir()):
            run.log_artifact(path)
        run.log_metrics(_means(metrics))
        return folder


def _train_whole_part(train_part: Any, config: Any, work: Path, part: Part) -> Part:
    """A worker's task."""
    for _ in train_part(config, part, part.folder(work)):
        pass
    return part


def demonstrations_of(demonstrations: DemonstrationSet, part: Part) -> Iterator[Any]:
    """(task instance, demonstration) pairs of the densities that ``part`` is for."""
    fewest, most = part.num_objects
    for task, episode in demonstrations:
        if fewest <= task.scene.num_objects <= most:
            yield task, episode


def _means(metrics: dict[str, Any]) -> dict[str, float]:
    """Means over the networks of what their summaries say: ``{"image": {"best": {"a": 1}}}`` -> ``{"best/a": 1}``."""
    from pipelines.tracking import flatten

    rows = [flatten(part) for part in metrics.values()]
    shared = [key for key in rows[0] if all(isinstance(row.get(key), int | float) for row in rows)]
    return {key.replace(".", "/"): sum(row[key] for row in rows) / len(rows) for key in shared}


def _write_video(config: TrainILConfig | TrainRLConfig, part: Part, folder: Path) -> None:
    """The greedy policy on the first validation tasks."""
    from visualrhp.evaluation.episodes import run_episode
    from visualrhp.heuristics.checkpoint import load_heuristic
    from visualrhp.planning import Greedy
    from visualrhp.rendering.frames import episode_frames
    from visualrhp.rendering.video import write_video
    from visualrhp.scene import Split, generator_for, sample_task_instance
    from visualrhp.simulation import Physics, TransitionModel, make_action_space

    planner = Greedy(load_heuristic(folder / f"heuristic{part.suffix}.safetensors", config.action_space.name))

    def frames() -> Iterator[Any]:
        for index in range(config.video.num_scenes):
            task = sample_task_instance(scene_distribution(config, part), config.seed, Split.VALIDATION, index)
            physics = Physics(**asdict(config.physics))
            model = TransitionModel(task.scene, make_action_space(config.action_space.name), physics)
            rng = generator_for(config.seed, Split.VALIDATION, index, 1)
            episode = run_episode(planner, model, model, task.state, rng, keep_states=True)
            yield from episode_frames(
                task.scene,
                episode.states,
                title=f"Greedy, {config.action_space.name}",
                outcome=episode.outcome,
                size_px=config.video.size_px,
                frames_per_action=_FRAMES_PER_ACTION,
                hold=round(_VIDEO_FPS),
                show_observation=True,
            )

    write_video(folder / "greedy.webm", frames(), _VIDEO_FPS)
