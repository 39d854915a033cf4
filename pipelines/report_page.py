"""The report as one self-contained HTML page: what is shown, in which words. No files are read or written here."""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd
from matplotlib.figure import Figure

from visualrhp.errors import DataError
from visualrhp.evaluation import figures
from visualrhp.evaluation.metrics import CONFIDENCE, summarize

TEMPLATES = Path(__file__).parent / "templates"


@dataclass(frozen=True)
class NamedFigure:
    """A figure of the report: the stem of its file, its heading and what it shows."""

    stem: str
    name: str
    caption: str
    figure: Figure


@dataclass(frozen=True)
class Video:
    """A .webm video in a row and the .webp picture shown before it starts.

    Without ``data``, a note in its place says why (``label``).
    """

    label: str
    data: bytes = b""
    poster: bytes = b""
    width: int = 0
    height: int = 0


@dataclass(frozen=True)
class VideoRow:
    """The methods of one action space on one task."""

    title: str
    videos: Sequence[Video]


@dataclass(frozen=True)
class SceneVideos:
    """One task and everybody's attempt at it."""

    title: str
    subtitle: str
    rows: Sequence[VideoRow]


@dataclass(frozen=True)
class Content:
    """What goes onto the page.

    Attributes:
        title: of the page.
        episodes: the episodes table.
        figures: by section: "environments", "robustness", "training" and "sweeps"; sections without figures are left
            out.
        scenes: videos.
        run_facts: (name, value) pairs about how all this was made.
        points: one mapping per evaluated point (see ``pipelines.evaluate``).
        warnings: what a reader must know to read the numbers, such as what was skipped.
        documents: (name, text) pairs shown folded, such as the configuration.
        facts: a few (name, value) pairs for the head of the page.
        footer: closing line.
    """

    title: str
    episodes: pd.DataFrame
    figures: Mapping[str, Sequence[NamedFigure]]
    scenes: Sequence[SceneVideos]
    run_facts: Sequence[tuple[str, str]]
    points: Sequence[Mapping[str, Any]]
    warnings: Sequence[str]
    documents: Sequence[tuple[str, str]]
    facts: Sequence[tuple[str, str]]
    footer: str


def episode_figures(episodes: pd.DataFrame) -> dict[str, list[NamedFigure]]:
    """The paper's Fig. 7 to 10 that the episodes have rows for, by section."""
    environments: list[tuple[Callable[..., Figure], figures.MetricName, str, str, str]] = [
        (figures.by_density, "success_rate", "figure_7a", "Success rate by clutter density", "Paper, Fig. 7a."),
        (figures.by_size, "success_rate", "figure_7b", "Success rate by object size", "Paper, Fig. 7b."),
        (
            figures.by_density,
            "action_efficiency",
            "figure_8a",
            "Action efficiency by clutter density",
            "Paper, Fig. 8a.",
        ),
        (figures.by_size, "action_efficiency", "figure_8b", "Action efficiency by object size", "Paper, Fig. 8b."),
    ]
    captions = {
        "figure_7a": "Objects of mixed size.",
        "figure_7b": "Number of objects drawn at random.",
        "figure_8a": "Objects in the scene over actions until completion, completed tasks only: higher is better.",
        "figure_8b": "Number of objects drawn at random; completed tasks only.",
    }
    found: dict[str, list[NamedFigure]] = {"environments": [], "robustness": []}
    for draw, metric, stem, name, source in environments:
        if stem.endswith("b") and episodes.loc[episodes["noise_level"] == "none", "object_size"].nunique() < 2:
            continue
        try:
            figure = draw(episodes, metric)
        except DataError:
            continue
        found["environments"].append(NamedFigure(stem, name, f"{captions[stem]} {source}", figure))
    try:
        figure = figures.execution_time(episodes)
        caption = (
            "Time to choose all actions of a run and to roll the physics of those executed, mean over all runs, on "
            "this machine; a logarithmic scale. Paper, Fig. 9."
        )
        found["environments"].append(NamedFigure("figure_9", "Execution time per run", caption, figure))
    except DataError:
        pass
    try:
        figure = figures.robustness(episodes)
        caption = (
            "The world's shapes, friction and density are drawn around what the planner believes (relative standard "
            "deviation 1%, 3% and 5%). Every method meets the same perturbed worlds. Paper, Fig. 10."
        )
        found["robustness"].append(NamedFigure("figure_10", "Success rate under noise", caption, figure))
    except DataError:
        pass
    return found


def main_rows(episodes: pd.DataFrame) -> pd.DataFrame:
    """The episodes that the headline numbers are about: mixed sizes, no noise, random density where there is one."""
    rows = episodes.loc[(episodes["object_size"] == "mixed") & (episodes["noise_level"] == "none")]
    rows = rows if len(rows) else episodes
    random = rows["scene_num_objects"].astype(str).str.contains("-")
    return rows.loc[random] if random.any() else rows


def render(content: Content) -> str:
    """The page as a string of HTML that refers to nothing outside itself."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES), autoescape=True, undefined=jinja2.StrictUndefined
    )
    main = main_rows(content.episodes)
    headings = {
        "environments": (
            "Different environments",
            "Environments",
            "Success, action efficiency and time as the clutter grows denser and the objects larger (Sec. 8.1). Bars "
            f"are {CONFIDENCE:.0%} confidence intervals.",
        ),
        "robustness": (
            "Robustness to unmodelled dynamics",
            "Robustness",
            "The planner's model is nominal, the world is not (Sec. 8.2). Bars are "
            f"{CONFIDENCE:.0%} confidence intervals.",
        ),
        "sweeps": ("Learning studies", "Studies", "How the data and the algorithm matter (Sec. 7.4 and 7.5)."),
    }
    tables = _detail_tables(content.episodes)
    sections = [
        {
            "id": key,
            "title": title,
            "short": short,
            "text": text,
            "figures": [_embedded(figure) for figure in content.figures.get(key, ())],
            "tables": tables.get(key, []),
        }
        for key, (title, short, text) in headings.items()
        if content.figures.get(key)
    ]
    training = None
    if content.figures.get("training"):
        text = "Curves recorded while the networks were trained, first on demonstrations, then on their own experience."
        training = {"text": text, "figures": [_embedded(figure) for figure in content.figures["training"]]}
    return environment.get_template("report.html.j2").render(
        title=content.title,
        lead=_lead(main),
        facts=content.facts,
        cards=_cards(main),
        scenes=[_scene(scene) for scene in content.scenes],
        results_note=(
            f"{_description(main)} Every method meets the same tasks. Ranges are {CONFIDENCE:.0%} confidence "
            "intervals: Wilson's for rates, Student's for means. Action efficiency: objects in the scene over actions "
            "until completion, averaged over completed tasks (Sec. 7.3)."
        ),
        main_table=_table(main, ["method", "action_space"], ["Method", "Actions"], "", ""),
        warnings=content.warnings,
        sections=sections,
        training=training,
        run_facts=content.run_facts,
        experiments=content.points,
        documents=content.documents,
        footer=content.footer,
    )


def percent(value: float, digits: int = 0) -> str:
    """A rate in per cent, or a dash for a missing one."""
    return "–" if pd.isna(value) else f"{100.0 * value:.{digits}f}%"


def duration(seconds: float) -> str:
    """A duration in a unit that suits it, or a dash for a missing one."""
    if pd.isna(seconds):
        return "–"
    if seconds < 1.0:
        return f"{1e3 * seconds:.3g} ms"
    if seconds < 120.0:
        return f"{seconds:.3g} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"


def _embedded(figure: NamedFigure) -> dict[str, Any]:
    width = round(
        figure.figure.get_size_inches()[0] * 104
    )  # the natural width: text about as large as the page's notes
    return {"name": figure.name, "caption": figure.caption, "svg": figures.to_svg(figure.figure), "width": width}


def _scene(scene: SceneVideos) -> dict[str, Any]:
    def encoded(video: Video) -> dict[str, Any]:
        data, poster = (base64.b64encode(content).decode("ascii") for content in (video.data, video.poster))
        size = {"width": video.width, "height": video.height}
        return {"label": video.label, "data": data, "poster": poster, **size}

    rows = [{"title": row.title, "videos": [encoded(video) for video in row.videos]} for row in scene.rows]
    return {"title": scene.title, "subtitle": scene.subtitle, "rows": rows}


def _description(rows: pd.DataFrame) -> str:
    densities = sorted(set(rows["scene_num_objects"].astype(str)))
    sizes = sorted(set(rows["object_size"]))
    joined = densities[0] if len(densities) == 1 else f"{', '.join(densities[:-1])} and {densities[-1]}"
    what = f"Scenes of {joined.replace('-', ' to ')} object{'' if joined == '1' else 's'} of {' and '.join(sizes)} size"
    return f"{what}, {'without noise' if set(rows['noise_level']) == {'none'} else 'with noise'}."


def _lead(main: pd.DataFrame) -> str:
    """One or two sentences that say how the first method did, and against what."""
    labelled = figures.with_labels(main)
    space = next(space for space in figures.ACTION_SPACES if space in set(labelled["action_space"]))
    rows = labelled.loc[labelled["action_space"] == space]
    rates = {row["method"]: row for row in summarize(rows, ["method"]).to_dict("records")}
    own = next(name for name in ("VisualRHP 3x3", *figures.order_methods(list(rates))) if name in rates)
    sentence = (
        f"{own} completes {percent(rates[own]['success_rate'])} of the tasks "
        f"({percent(rates[own]['success_rate_low'])} to {percent(rates[own]['success_rate_high'])}) "
        f"with {space} actions"
    )
    others = [
        f"{name} {percent(rates[name]['success_rate'])}"
        for name in ("Greedy", "CraftedHeuristicRHP 8x4", "K.RRT")
        if name in rates and name != own
    ]
    return f"{sentence}; {', '.join(others)}." if others else f"{sentence}."


def _cards(main: pd.DataFrame) -> list[dict[str, str]]:
    labelled = figures.with_labels(main)
    methods = labelled["method"].tolist()
    own = "VisualRHP 3x3" if "VisualRHP 3x3" in methods else figures.order_methods(methods)[0]
    cards = []
    for row in summarize(labelled.loc[labelled["method"] == own], ["action_space"]).to_dict("records"):
        colour = figures.method_style(own, methods).colour
        cards.append(
            {
                "label": f"Success, {row['action_space']}",
                "value": percent(row["success_rate"]),
                "range": f"{100 * row['success_rate_low']:.0f} to {percent(row['success_rate_high'])} "
                f"of {row['episodes']} tasks, {own}",
                "colour": colour,
            }
        )
    first = summarize(labelled.loc[labelled["method"] == own], ["action_space"]).to_dict("records")[0]
    own_rows = labelled.loc[(labelled["method"] == own) & (labelled["action_space"] == first["action_space"])]
    cards.append(
        {
            "label": f"Action efficiency, {first['action_space']}",
            "value": _number(first["action_efficiency"]),
            "range": "objects in the scene per action",
            "colour": "",
        }
    )
    decision = own_rows["decision_time_s"].sum() / max(1, own_rows["num_actions"].sum())
    cards.append(
        {
            "label": f"Decision time, {first['action_space']}",
            "value": duration(decision),
            "range": "per action, on one core",
            "colour": "",
        }
    )
    return cards


def _detail_tables(episodes: pd.DataFrame) -> dict[str, list[dict[str, Any]]]:
    quiet = episodes.loc[episodes["noise_level"] == "none"]
    mixed = episodes.loc[episodes["object_size"] == "mixed"]
    environments = [
        _table(
            quiet.loc[quiet["object_size"] == "mixed"],
            ["method", "action_space", "num_objects"],
            ["Method", "Actions", "Objects"],
            "By clutter density",
            "Objects of mixed size, no noise.",
        )
    ]
    if quiet["object_size"].nunique() > 1:
        environments.append(
            _table(
                quiet,
                ["method", "action_space", "object_size"],
                ["Method", "Actions", "Size"],
                "By object size",
                "All densities evaluated, no noise.",
            )
        )
    robustness = _table(
        mixed,
        ["method", "action_space", "noise_level"],
        ["Method", "Actions", "Noise"],
        "By noise level",
        "Objects of mixed size, all densities evaluated.",
    )
    return {"environments": environments, "robustness": [robustness]}


def _table(episodes: pd.DataFrame, by: list[str], keys: list[str], title: str, caption: str) -> dict[str, Any]:
    """Rows of a table of results, methods in the order of the legends, noise levels and sizes in theirs."""
    labelled = figures.with_labels(episodes)
    methods = figures.order_methods(labelled["method"].tolist())
    order = {
        "method": methods,
        "action_space": list(figures.ACTION_SPACES),
        "object_size": list(figures.SIZES),
        "noise_level": list(figures.NOISE_ORDER),
    }

    def rank(row: dict[Any, Any]) -> tuple[Any, ...]:
        return tuple(order[key].index(row[key]) if key in order else row[key] for key in by)

    decision_times: dict[Any, Any] = {
        key: group["decision_time_s"].sum() / max(1, group["num_actions"].sum()) for key, group in labelled.groupby(by)
    }
    rows = []
    previous = None
    for row in sorted(summarize(labelled, by).to_dict("records"), key=rank):
        low, high = row["success_rate_low"], row["success_rate_high"]
        group = row["method"]
        rows.append(
            {
                "labels": [str(row[key]) for key in by],
                "colour": figures.method_style(row["method"], methods).colour,
                "starts_group": previous is not None and group != previous,
                "success": percent(row["success_rate"]),
                "success_range": f"{100 * low:.0f}–{100 * high:.0f}",
                "success_percent": round(100 * row["success_rate"], 1),
                "low_percent": round(100 * low, 1),
                "width_percent": round(100 * (high - low), 1),
                "efficiency": _number(row["action_efficiency"]),
                "efficiency_range": _range(row, "action_efficiency", _number),
                "time": duration(row["execution_time_s"]),
                "time_range": _range(row, "execution_time_s", duration),
                "decision": duration(float(decision_times[tuple(row[key] for key in by)])),
                "dropped": percent(row["drop_rate"]),
                "episodes": row["episodes"],
            }
        )
        previous = group
    return {"title": title, "caption": caption, "headings": keys, "rows": rows}


def _number(value: float) -> str:
    return "–" if pd.isna(value) else f"{value:.2f}"


def _range(row: Mapping[Any, Any], name: str, write: Any) -> str:
    low, high = row[f"{name}_low"], row[f"{name}_high"]
    if pd.isna(low) or pd.isna(high):
        return ""
    first, last = write(max(0.0, low)), write(high)
    unit = last.partition(" ")[2]  # say a unit that both have once
    return f"{first.removesuffix(f' {unit}') if unit else first}–{last}"
