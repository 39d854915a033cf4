"""The content of the report's page, from the artefacts of an evaluation and of the trainings."""

from __future__ import annotations

import datetime
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from visualrhp.evaluation.curves import trained_networks
from visualrhp.evaluation.episodes import SETTING_COLUMNS
from visualrhp.evaluation.methods import method_label
from visualrhp.evaluation.report_figures import NamedFigure
from visualrhp.evaluation.report_page import Content
from visualrhp.evaluation.report_videos import SceneVideos
from visualrhp.evaluation.summaries import duration, percent

_KEYS: Final = tuple(name for name in SETTING_COLUMNS if name != "seed")


def page_content(
    title: str,
    episodes: pd.DataFrame,
    evaluation: Mapping[str, Any],
    figures: Mapping[str, Sequence[NamedFigure]],
    scenes: Sequence[SceneVideos],
    training: Sequence[Path],
    commit: str | None,
) -> Content:
    """Assemble the page.

    Args:
        title: of the page.
        episodes: the table of episodes.
        evaluation: its card, ``evaluation.json``.
        figures: by section (:class:`visualrhp.evaluation.report_page.Content`).
        scenes: videos.
        training: folders of the trainings, whose networks are listed.
        commit: of the repository, for a card that has none.
    """
    commit = str(evaluation.get("commit") or commit or "unknown")
    today = datetime.datetime.now(tz=datetime.UTC).date().isoformat()
    points = _points(episodes, evaluation["points"])
    planning, simulating = (float(np.sum(episodes[name])) for name in ("decision_time_s", "simulation_time_s"))
    facts = [
        ("scale", str(evaluation["scale"])),
        ("episodes", f"{len(episodes):,}"),
        ("seed", str(evaluation["seed"])),
        ("date", today),
        ("commit", f"{commit[:10]}{' with changes' if commit.endswith('-dirty') else ''}"),
    ]
    run_facts = [
        ("Scale", str(evaluation["scale"])),
        ("Episodes", f"{len(episodes):,} in {len(points)} settings, seed {evaluation['seed']}"),
        ("Planning", f"{duration(planning)} in total; {duration(simulating)} to execute"),
        ("Evaluation", f"{duration(float(evaluation['wall_time_s']))} on {evaluation['num_workers'] or 'all'} workers"),
        ("Networks", f"{len(evaluation['networks'])}: {', '.join(evaluation['networks']) or 'none'}"),
        ("Commit", commit),
        ("Versions", ", ".join(f"{name} {number}" for name, number in evaluation["versions"].items() if number)),
        *_training_facts(training),
    ]
    shown = {name: evaluation["config"][name] for name in evaluation["config"] if name != "planner" or len(points) == 1}
    return Content(
        title=title,
        episodes=episodes,
        figures=figures,
        scenes=scenes,
        run_facts=run_facts,
        points=points,
        warnings=_warnings(evaluation["points"]),
        documents=[("Configuration of the evaluation", json.dumps(shown, indent=2))],
        facts=facts,
        footer=f"Made by python -m pipelines.report on {today}.",
    )


def _points(episodes: pd.DataFrame, points: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The evaluated settings with their success rates, for the template."""
    outcomes: dict[tuple[str, ...], list[bool]] = {}
    for row in episodes.to_dict("records"):
        outcomes.setdefault(tuple(_cell(row[name]) for name in _KEYS), []).append(bool(row["success"]))
    described = []
    for point in points:
        successes = outcomes.get(tuple(_cell(point[name]) for name in _KEYS), [])
        described.append(
            {
                **{name: point[name] for name in ("action_space", "object_size", "layout", "noise_level")},
                "method": _label(point),
                "num_objects": point["scene_num_objects"].replace("-", " to "),
                "episodes": point["num_episodes"],
                "skipped": point["num_skipped"] or "",
                "success": percent(sum(successes) / len(successes)) if successes else "",
            }
        )
    return described


def _warnings(points: Sequence[Mapping[str, Any]]) -> list[str]:
    """Skipped episodes, by method and action space."""
    counts: dict[tuple[str, str], tuple[int, int]] = {}
    for point in points:
        key = (_label(point), point["action_space"])
        skipped, requested = counts.get(key, (0, 0))
        counts[key] = (skipped + point["num_skipped"], requested + point["num_skipped"] + point["num_episodes"])
    return [
        f"{method} with {space} actions has no network for some numbers of objects: {skipped} of {requested} tasks "
        "were not run and are not counted."
        for (method, space), (skipped, requested) in counts.items()
        if skipped
    ]


def _training_facts(folders: Sequence[Path]) -> list[tuple[str, str]]:
    """One line per training stage: how many networks it trained."""
    facts = []
    for folder in folders:
        count, names = trained_networks(folder)
        if count:
            facts.append((folder.name, f"{count} networks ({'; '.join(names)})"))
    return facts


def _label(point: Mapping[str, Any]) -> str:
    return method_label(point["planner"], point["num_rollouts"], point["horizon"])


def _cell(value: Any) -> str:
    """A value of a table or a card as text, the same for all missing values."""
    return "" if pd.isna(value) else str(value)
