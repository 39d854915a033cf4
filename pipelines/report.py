"""Put the results on one page to look at: ``python -m pipelines.report``.

The artefact is a folder with ``index.html``, which holds everything it shows, and the same figures (``figures/*.svg``,
``*.png``) and videos (``videos/*.webm``) as files.
"""

from __future__ import annotations

import datetime
import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipelines.app import app, compose
from pipelines.config import EvaluateConfig, ReportConfig

if TYPE_CHECKING:
    import pandas as pd

    from pipelines.report_page import NamedFigure, SceneVideos
    from pipelines.tracking import Run
    from visualrhp.rendering.video import Frame

_log = logging.getLogger(__name__)

_FRAMES_PER_SECOND_OF_MOTION = 3  # actions a second
_GRID_COLUMNS = 3
_TASKS_PER_BATCH = 20  # Sec. 7.4
_GRID_CELL_PX = 208
_CURVES = {
    "train_il": (
        "Imitation learning",
        "epoch",
        (
            "greedy/success_rate",
            "greedy/action_efficiency",
            "validation/loss",
            "validation/value_rmse",
            "validation/agreement",
            "train/entropy",
        ),
    ),
    "train_rl": (
        "Reinforcement learning",
        "iteration",
        (
            "greedy/success_rate",
            "greedy/action_efficiency",
            "collection/success_rate",
            "value/td_rmse",
            "policy/kl",
            "policy/entropy",
        ),
    ),
}
"""By stage: its name in words, what a row of its curves is, and the curves to show."""


@dataclass(frozen=True)
class VideoTask:
    """A planner's attempt at a task, to be run and filmed.

    Attributes:
        config: planner, action space, scene (of one density), physics and networks.
        scene_index: which scene of the page.
        episode: index of the task instance.
        fps: frames a second.
        size_px: width.
    """

    config: EvaluateConfig = field(repr=False)
    scene_index: int
    episode: int
    fps: int
    size_px: int


@dataclass(frozen=True)
class FilmedTask:
    """A video, or why there is none.

    Attributes:
        method: as in figures and tables.
        label: what happens, in words.
        data: the .webm file; empty if the planner cannot do this task.
        poster: its last frame as a .webp picture.
    """

    scene_index: int
    action_space: str
    method: str
    label: str
    data: bytes = field(default=b"", repr=False)
    poster: bytes = field(default=b"", repr=False)
    width: int = 0
    height: int = 0


@app("report", ReportConfig)
def main(config: ReportConfig) -> None:
    """Make the report and publish it."""
    from pipelines.tracking import open_run
    from pipelines.work import discard, publish, work_folder

    work = work_folder(config, "report")
    with open_run(config, "report", "report", work) as run:
        publish(make_report(config, work, run), config.paths.artefact)
    discard(work)
    _log.info("The report is %s", Path(config.paths.artefact) / "index.html")


def make_report(config: ReportConfig, work: Path, run: Run) -> Path:
    """Load what the other pipelines made, film the planners, write the page; the folder of the artefact."""
    from pipelines import report_page
    from pipelines.work import discard
    from visualrhp.evaluation import figures
    from visualrhp.files import write_text

    episodes, evaluation = load_evaluation(Path(config.evaluation))
    tasks = video_tasks(config)
    artefact = work / "artefact"
    discard(artefact)  # a killed run's
    named = report_page.episode_figures(episodes)
    named["training"] = training_figures([Path(folder) for folder in config.training])
    named["sweeps"] = sweep_figures(config)
    for figure in (figure for section in named.values() for figure in section):
        for suffix in ("svg", "png"):
            figures.save(figure.figure, artefact / "figures" / f"{figure.stem}.{suffix}")
    scenes = film(config, tasks, artefact / "videos")
    content = page_content(config, episodes, evaluation, named, scenes)
    write_text(artefact / "index.html", report_page.render(content))
    run.log_artifact(artefact)
    return artefact


def load_evaluation(folder: Path) -> tuple[pd.DataFrame, dict[str, Any]]:
    """The episodes table and the card that ``evaluate`` made.

    Raises:
        DataError: they are missing, damaged or lack a column.
    """
    import pandas as pd
    import pyarrow as pa

    from visualrhp.errors import DataError
    from visualrhp.evaluation.metrics import EPISODE_COLUMNS
    from visualrhp.files import read_json

    path = folder / "episodes.parquet"
    if not path.is_file():
        raise DataError(f"evaluation={folder} has no file episodes.parquet; make it with python -m pipelines.evaluate")
    try:
        episodes = pd.read_parquet(path)
    except (OSError, ValueError, pa.ArrowException) as error:
        raise DataError(
            f"{path} is damaged or no Parquet file ({error}); python -m pipelines.evaluate makes it anew"
        ) from error
    missing = [name for name in (*EPISODE_COLUMNS, "scene_num_objects") if name not in episodes.columns]
    if missing or episodes.empty:
        what = f"lacks the columns {', '.join(missing)}" if missing else "has no rows"
        raise DataError(f"{path} {what}; python -m pipelines.evaluate makes it anew")
    return episodes, read_json(folder / "evaluation.json")


# -------------------------------------------------------------------------------------------------------------- videos
def video_tasks(config: ReportConfig) -> list[VideoTask]:
    """What is to be filmed: every planner in every action space on every scene, scenes of the densities in turn.

    Raises:
        ConfigError: a planner is not known.
        CheckpointError: a network of the image representation is missing or damaged.
    """
    from pipelines.planners import build_planner, needed_network

    videos = config.videos
    tasks = []
    for scene_index in range(videos.num_scenes):
        density = videos.num_objects[scene_index % len(videos.num_objects)]
        for space in videos.action_spaces:
            for planner in videos.planners:
                overrides = [f"planner={planner}", f"action_space={space}", f"scene.num_objects={density}"]
                composed = compose("evaluate", EvaluateConfig, overrides)
                point = replace(composed, seed=config.seed, heuristics=config.heuristics, paths=config.paths)
                path = needed_network(point.planner, space, config.heuristics, density)
                if path is None or path.is_file() or path.name == "heuristic.safetensors":
                    build_planner(point.planner, space, config.heuristics, density)
                tasks.append(VideoTask(point, scene_index, scene_index, videos.fps, videos.size_px))
    return tasks


def film_task(task: VideoTask) -> FilmedTask:
    """Run a planner on a task and encode the video of it."""
    import tempfile

    from pipelines.evaluate import scene_distribution
    from pipelines.planners import build_planner, needed_network
    from visualrhp.evaluation.episodes import run_task
    from visualrhp.evaluation.figures import method_label
    from visualrhp.rendering.frames import episode_frames
    from visualrhp.rendering.video import write_video
    from visualrhp.scene import Split, sample_task_instance
    from visualrhp.simulation import Physics, make_action_space
    from visualrhp.simulation.task import MAX_EPISODE_ACTIONS

    config = task.config
    space, planner = config.action_space.name, config.planner
    method = method_label(planner.name, getattr(planner, "num_rollouts", None), getattr(planner, "horizon", None))
    distribution = scene_distribution(config)
    num_objects = distribution.num_objects[0]
    network = needed_network(planner, space, config.heuristics, num_objects)
    if network is not None and not network.is_file():
        return FilmedTask(task.scene_index, space, method, f"{method}: no network for {num_objects} objects")
    result = run_task(
        build_planner(planner, space, config.heuristics, num_objects),
        distribution,
        config.seed,
        Split.EVALUATION,
        task.episode,
        action_space=make_action_space(space),
        physics=Physics(**asdict(config.physics)),
        keep_states=True,
    )
    instance = sample_task_instance(distribution, config.seed, Split.EVALUATION, task.episode)
    frames = list(
        episode_frames(
            instance.scene,
            result.states,
            title=method,
            outcome=result.outcome,
            max_steps=MAX_EPISODE_ACTIONS,
            size_px=task.size_px,
            frames_per_action=max(1, round(task.fps / _FRAMES_PER_SECOND_OF_MOTION)),
            hold=task.fps // 2,
        )
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "video.webm"
        write_video(path, frames, task.fps)
        data = path.read_bytes()
    label = f"{method}, {space} actions: {result.outcome}, {result.num_actions} actions"
    height, width = frames[0].shape[:2]
    return FilmedTask(task.scene_index, space, method, label, data, encode_picture(frames[-1]), width, height)


def film(config: ReportConfig, tasks: Sequence[VideoTask], folder: Path) -> list[SceneVideos]:
    """Film all tasks in parallel, write the videos and a comparison side by side to ``folder``, arrange them."""
    from tqdm import tqdm

    from pipelines.execution import run_tasks
    from pipelines.report_page import SceneVideos, Video, VideoRow
    from visualrhp.evaluation.figures import order_methods
    from visualrhp.files import atomic_path

    results = run_tasks(film_task, tasks, config.executor)
    filmed = {
        (result.scene_index, result.action_space, result.method): result
        for result in tqdm(results, total=len(tasks), desc="videos", unit="video", disable=not tasks)
    }
    methods = order_methods([method for _, _, method in filmed])
    scenes = []
    for scene_index in range(config.videos.num_scenes):
        rows = []
        for space in config.videos.action_spaces:
            attempts = [filmed[key] for method in methods if (key := (scene_index, space, method)) in filmed]
            for attempt in attempts:
                if attempt.data:
                    stem = f"scene_{scene_index}_{space}_{attempt.method.replace(' ', '_')}"
                    with atomic_path(folder / f"{stem}.webm") as path:
                        path.write_bytes(attempt.data)
            videos = [Video(a.label, a.data, a.poster, a.width, a.height) for a in attempts]
            rows.append(VideoRow(f"{space.capitalize()} actions", videos))
        density = config.videos.num_objects[scene_index % len(config.videos.num_objects)]
        title = f"{density} objects" if density > 1 else "One object"
        scenes.append(SceneVideos(title, f"mixed sizes, task {scene_index} of seed {config.seed}", rows))
    first = [result for result in filmed.values() if result.data and result.scene_index == 0]
    for space in config.videos.action_spaces[:1]:
        compared = {result.method: result.data for result in first if result.action_space == space}
        if compared:
            write_comparison(
                [compared[m] for m in methods if m in compared], folder / "comparison.webm", config.videos.fps
            )
    return scenes


def encode_picture(frame: Frame) -> bytes:
    """A frame as the content of a .webp file."""
    import cv2

    _, data = cv2.imencode(".webp", cv2.cvtColor(frame, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_WEBP_QUALITY, 85])
    return data.tobytes()


def write_comparison(videos: Sequence[bytes], path: Path, fps: int) -> None:
    """Write a grid in which several videos play at once."""
    import tempfile

    import cv2
    import numpy as np

    from visualrhp.rendering.video import read_video, side_by_side, write_video

    def small(frame: Frame) -> Frame:
        scale = min(1.0, _GRID_CELL_PX / frame.shape[1])
        size = (round(scale * frame.shape[1]), round(scale * frame.shape[0]))
        return np.asarray(cv2.resize(frame, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)

    decoded = []
    with tempfile.TemporaryDirectory() as folder:
        for number, data in enumerate(videos):
            source = Path(folder) / f"{number}.webm"
            source.write_bytes(data)
            decoded.append([small(frame) for frame in read_video(source)])
    write_video(path, side_by_side(decoded, columns=min(_GRID_COLUMNS, len(decoded))), fps)


# ------------------------------------------------------------------------------------------------------------ training
def training_figures(folders: Sequence[Path]) -> list[NamedFigure]:
    """A figure of training curves for each stage that left any below its folder, a line for each network.

    Raises:
        DataError: the curves are damaged.
    """
    from pipelines.report_page import NamedFigure
    from visualrhp.errors import DataError
    from visualrhp.evaluation.figures import training_curves

    named = []
    for folder in folders:
        if folder.name not in _CURVES:
            continue
        words, unit, columns = _CURVES[folder.name]
        curves = load_curves(folder)
        try:
            figure = training_curves(curves, unit, columns, unit.capitalize())
        except DataError:  # no such curves, as in a run without validation of a single iteration
            continue
        caption = f"A line for each trained network ({len(curves)}); greedy is the policy without look-ahead."
        named.append(NamedFigure(f"training_{folder.name}", words, caption, figure))
    return named


def load_curves(folder: Path) -> dict[str, pd.DataFrame]:
    """The training curves of the networks below ``folder`` (``<action space>/<representation>/curves.csv``), by name.

    Raises:
        DataError: a file is no table.
    """
    import pandas as pd

    from visualrhp.errors import DataError

    curves = {}
    for path in sorted(folder.glob("*/*/curves.csv")):
        try:
            table = pd.read_csv(path)
            groups = list(table.groupby("network", sort=False))
        except (OSError, ValueError, KeyError) as error:
            raise DataError(f"{path} is no table of training curves ({error}); train again to make it anew") from error
        space, representation = path.parent.parts[-2:]
        for network, rows in groups:
            names = (space, representation, str(network))
            curves[", ".join(dict.fromkeys(names))] = rows.dropna(axis="columns", how="all")
    return curves


# -------------------------------------------------------------------------------------------------------------- sweeps
def sweep_figures(config: ReportConfig) -> list[NamedFigure]:
    """Fig. 5 and 6, if the configuration names the sweeps behind them.

    Raises:
        DataError: a sweep has no finished job.
    """
    from pipelines.report_page import NamedFigure
    from visualrhp.evaluation.figures import demonstrations_sweep, learning_stability

    named = []
    if config.sweeps.demonstrations is not None:
        figure = demonstrations_sweep(demonstration_batches(Path(config.sweeps.demonstrations)))
        caption = f"Imitation followed greedily, means over batches of {_TASKS_PER_BATCH} tasks (Fig. 5)."
        named.append(NamedFigure("demonstrations", "Number of demonstrations", caption, figure))
    if config.sweeps.stability is not None:
        trials = stability_trials(Path(config.sweeps.stability))
        caption = (
            f"Reinforcement learning with and without the baseline step, {trials['trial'].nunique()} trials (Fig. 6)."
        )
        named.append(NamedFigure("stability", "Learning stability", caption, learning_stability(trials)))
    return named


def demonstration_batches(folder: Path) -> pd.DataFrame:
    """A row per batch of tasks, from ``<number>/evaluation/<action space>/episodes.parquet``.

    Columns: action_space, num_demonstrations, success_rate.
    """
    import pandas as pd

    rows = []
    for path in sorted(folder.glob("*/evaluation/*/episodes.parquet")):
        episodes = load_evaluation(path.parent)[0].sort_values("episode")
        batch = episodes["episode"] // _TASKS_PER_BATCH
        for _, tasks in episodes.groupby(batch):
            point = {"action_space": path.parts[-2], "num_demonstrations": int(path.parts[-4])}
            rows.append(point | {"success_rate": float(tasks["success"].to_numpy().mean())})
    if not rows:
        raise _no_sweep("demonstrations", folder, "fig5_evaluation")
    return pd.DataFrame(rows)


def stability_trials(folder: Path) -> pd.DataFrame:
    """A row per greedy evaluation of a training, from ``baseline_step_<bool>/seed_<number>/curves.csv``.

    Columns: algorithm, trial, transitions, success_rate.
    """
    import pandas as pd

    tables = []
    for path in sorted(folder.glob("baseline_step_*/seed_*/curves.csv")):
        curves = pd.read_csv(path)
        rates = curves.loc[curves["greedy/success_rate"].notna()]
        transitions = rates["collection/transitions"].fillna(0)  # none before the first iteration
        tables.append(
            pd.DataFrame(
                {
                    "algorithm": "C3PO" if path.parts[-3].endswith("True") else "PPO",
                    "trial": path.parts[-2],
                    "transitions": transitions,
                    "success_rate": rates["greedy/success_rate"],
                }
            )
        )
    if not tables:
        raise _no_sweep("stability", folder, "fig6")
    return pd.concat(tables, ignore_index=True)


def _no_sweep(key: str, folder: Path, experiment: str) -> Exception:
    from visualrhp.errors import DataError

    return DataError(
        f"sweeps.{key}={folder} has no finished job; the first lines of conf/experiment/{experiment}.yaml make it"
    )


# ---------------------------------------------------------------------------------------------------------------- page
def page_content(
    config: ReportConfig,
    episodes: pd.DataFrame,
    evaluation: Mapping[str, Any],
    named: Mapping[str, Sequence[NamedFigure]],
    scenes: Sequence[SceneVideos],
) -> Any:
    """Everything for the page, in the page's own terms."""
    import numpy as np

    from pipelines.report_page import Content, duration, percent
    from pipelines.work import git_commit
    from visualrhp.evaluation.figures import method_label

    commit = evaluation.get("commit") or git_commit() or "unknown"
    short = f"{commit[:10]}{' with changes' if str(commit).endswith('-dirty') else ''}"
    today = datetime.datetime.now(tz=datetime.UTC).date().isoformat()
    keys = ("experiment", "planner", "action_space", "scene_num_objects", "object_size", "noise_level")
    keys += ("num_rollouts", "horizon")
    outcomes: dict[tuple[str, ...], list[bool]] = {}
    for row in episodes.to_dict("records"):
        outcomes.setdefault(tuple(_cell(row[name]) for name in keys), []).append(bool(row["success"]))
    points = []
    for point in evaluation["points"]:
        successes = outcomes.get(tuple(_cell(point[name]) for name in keys), [])
        points.append(
            {
                **{name: point[name] for name in ("action_space", "object_size", "noise_level")},
                "method": method_label(point["planner"], point["num_rollouts"], point["horizon"]),
                "num_objects": point["scene_num_objects"].replace("-", " to "),
                "episodes": point["num_episodes"],
                "skipped": point["num_skipped"] or "",
                "success": percent(sum(successes) / len(successes)) if successes else "",
            }
        )
    warnings = []
    for (method, space), (skipped, asked) in _skipped(evaluation["points"]).items():
        warnings.append(
            f"{method} with {space} actions has no network for some numbers of objects: {skipped} of {asked} tasks "
            "were not run and are not counted."
        )
    planning, simulating = (float(np.sum(episodes[name])) for name in ("decision_time_s", "simulation_time_s"))
    facts = [
        ("scale", str(evaluation["scale"])),
        ("episodes", f"{len(episodes):,}"),
        ("seed", str(evaluation["seed"])),
        ("date", today),
        ("commit", short),
    ]
    run_facts = [
        ("Scale", str(evaluation["scale"])),
        ("Episodes", f"{len(episodes):,} in {len(evaluation['points'])} settings, seed {evaluation['seed']}"),
        ("Planning", f"{duration(planning)} in all; {duration(simulating)} to execute"),
        ("Evaluation", f"{duration(float(evaluation['wall_time_s']))} on {evaluation['num_workers'] or 'all'} workers"),
        ("Networks", f"{len(evaluation['networks'])}: {', '.join(evaluation['networks']) or 'none'}"),
        ("Commit", str(commit)),
        ("Versions", ", ".join(f"{name} {number}" for name, number in evaluation["versions"].items() if number)),
    ]
    run_facts += training_facts([Path(folder) for folder in config.training])
    shown = {name: evaluation["config"][name] for name in evaluation["config"] if name != "planner" or len(points) == 1}
    return Content(
        title=config.title,
        episodes=episodes,
        figures=named,
        scenes=scenes,
        run_facts=run_facts,
        points=points,
        warnings=warnings,
        documents=[("Configuration of the evaluation", json.dumps(shown, indent=2))],
        facts=facts,
        footer=f"Made by python -m pipelines.report on {today}.",
    )


def _skipped(points: Sequence[Mapping[str, Any]]) -> dict[tuple[str, str], tuple[int, int]]:
    """(method, action space) -> (episodes skipped, episodes asked for) over its settings, where any was skipped."""
    from visualrhp.evaluation.figures import method_label

    counts: dict[tuple[str, str], tuple[int, int]] = {}
    for point in points:
        key = (method_label(point["planner"], point["num_rollouts"], point["horizon"]), point["action_space"])
        skipped, asked = counts.get(key, (0, 0))
        counts[key] = (skipped + point["num_skipped"], asked + point["num_skipped"] + point["num_episodes"])
    return {key: numbers for key, numbers in counts.items() if numbers[0]}


def _cell(value: Any) -> str:
    """A value of a table or a card as text, missing ones alike."""
    import pandas as pd

    return "" if pd.isna(value) else str(value)


def training_facts(folders: Sequence[Path]) -> list[tuple[str, str]]:
    """One line per stage: how many networks it trained, from the cards beside them."""
    facts = []
    for folder in folders:
        cards = sorted(folder.glob("**/heuristic*.json"))
        if cards:
            names = sorted({", ".join(card.relative_to(folder).parent.parts) for card in cards})
            facts.append((folder.name, f"{len(cards)} networks ({'; '.join(names)})"))
    return facts


if __name__ == "__main__":
    main()
