"""The report as one self-contained HTML page: its content as text. No files are read or written here."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import jinja2
import pandas as pd

from visualrhp.evaluation.methods import ACTION_SPACES, order_methods, with_labels
from visualrhp.evaluation.metrics import CONFIDENCE, summarize
from visualrhp.evaluation.paired import paired_table
from visualrhp.evaluation.report_figures import NamedFigure
from visualrhp.evaluation.report_tables import decision_time, detail_tables, main_table, number, paired_rows
from visualrhp.evaluation.report_videos import Attempt, SceneVideos
from visualrhp.evaluation.styles import method_style, to_svg
from visualrhp.evaluation.summaries import duration, main_rows, percent

TEMPLATES: Final = Path(__file__).parent / "templates"

_OWN_METHODS: Final = ("VisualRHP+ 3x3", "VisualRHP 3x3")
"""The headline is about the first of them that was evaluated."""

_BASELINES: Final = ("VisualRHP 3x3", "Greedy", "CraftedHeuristicRHP 8x4", "K.RRT")
"""The methods that the headline compares it with."""

_SEARCH: Final = "K.RRT closed loop"
"""The method that plans without learning, with which the lead compares the headline's method."""

_SIGNIFICANCE: Final = 0.05

_PIXELS_PER_INCH: Final = 104
"""Natural scale of a figure on the page: its text is about as large as the page's notes."""

_SECTIONS: Final = {
    "environments": (
        "Different environments",
        "Environments",
        "Success, action efficiency and time as scenes have more and larger objects (Sec. 8.1). Bars are "
        f"{CONFIDENCE:.0%} confidence intervals.",
    ),
    "robustness": (
        "Robustness to unmodelled dynamics",
        "Robustness",
        f"The planner's model is nominal, the world is not (Sec. 8.2). Bars are {CONFIDENCE:.0%} confidence intervals.",
    ),
    "sweeps": ("Learning studies", "Studies", "The effect of the data and of the algorithm (Sec. 7.4 and 7.5)."),
}
"""Identifier -> title, title in the navigation, text."""


@dataclass(frozen=True)
class Content:
    """Content of the page.

    Attributes:
        title: of the page.
        episodes: the table of episodes.
        figures: by section: "environments", "robustness", "training" and "sweeps"; sections without figures are left
            out.
        scenes: videos.
        run_facts: (name, value) pairs about how the results were made.
        points: one mapping per evaluated setting, with method, action_space, num_objects, object_size, noise_level,
            episodes, skipped and success.
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


def render(content: Content) -> str:
    """The page as a string of HTML that refers to nothing outside itself."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES), autoescape=True, undefined=jinja2.StrictUndefined
    )
    main = main_rows(content.episodes)
    tables = detail_tables(content.episodes)
    sections = [
        {
            "id": key,
            "title": title,
            "short": short,
            "text": text,
            "figures": [_embedded(figure) for figure in content.figures.get(key, ())],
            "tables": tables.get(key, []),
        }
        for key, (title, short, text) in _SECTIONS.items()
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
            f"{_description(main)} Every method is run on the same tasks. Ranges are {CONFIDENCE:.0%} confidence "
            "intervals: Wilson's for rates, bootstrap for means. Action efficiency: objects in the scene over actions "
            "until completion, averaged over completed tasks (Sec. 7.3)."
        ),
        main_table=main_table(content.episodes),
        paired=paired_rows(content.episodes),
        confidence=f"{CONFIDENCE:.0%}",
        warnings=content.warnings,
        sections=sections,
        training=training,
        run_facts=content.run_facts,
        experiments=content.points,
        documents=content.documents,
        footer=content.footer,
    )


def _embedded(figure: NamedFigure) -> dict[str, Any]:
    width = round(figure.figure.get_size_inches()[0] * _PIXELS_PER_INCH)
    return {"name": figure.name, "caption": figure.caption, "svg": to_svg(figure.figure), "width": width}


def _scene(scene: SceneVideos) -> dict[str, Any]:
    rows = [{"title": row.title, "videos": [_video(attempt) for attempt in row.attempts]} for row in scene.rows]
    return {"title": scene.title, "subtitle": scene.subtitle, "rows": rows}


def _video(attempt: Attempt) -> dict[str, Any]:
    film = attempt.film
    if film is None:
        return {"label": attempt.description, "data": ""}
    data, poster = (base64.b64encode(content).decode("ascii") for content in (film.data, film.poster))
    return {
        "label": attempt.description,
        "data": data,
        "poster": poster,
        "width": film.width,
        "height": film.height,
    }


def _description(rows: pd.DataFrame) -> str:
    numbers = sorted(set(rows["scene_num_objects"].astype(str)))
    sizes = sorted(set(rows["object_size"]))
    joined = numbers[0] if len(numbers) == 1 else f"{', '.join(numbers[:-1])} and {numbers[-1]}"
    what = f"Scenes of {joined.replace('-', ' to ')} object{'' if joined == '1' else 's'} of {' and '.join(sizes)} size"
    return f"{what}, {'without noise' if set(rows['noise_level']) == {'none'} else 'with noise'}."


def _lead(main: pd.DataFrame) -> str:
    """The result of the headline's method, compared with searching again if that was evaluated, and with others."""
    labelled = with_labels(main)
    space = next(space for space in ACTION_SPACES if space in set(labelled["action_space"]))
    rows = labelled.loc[labelled["action_space"] == space]
    rates = {row["method"]: row for row in summarize(rows, ["method"]).to_dict("records")}
    own = _own_method(list(rates))
    sentence = (
        f"{own} completes {percent(rates[own]['success_rate'])} of the tasks "
        f"({percent(rates[own]['success_rate_low'])} to {percent(rates[own]['success_rate_high'])}) "
        f"with {space} actions"
    )
    others = [f"{name} {percent(rates[name]['success_rate'])}" for name in _BASELINES if name in rates and name != own]
    sentence = f"{sentence}; {', '.join(others)}." if others else f"{sentence}."
    paired = paired_table(rows, (_SEARCH,))
    compared = paired.loc[paired["method"] == own].to_dict("records")
    return f"{_finding(compared[0])} {sentence}" if compared else sentence


def _finding(row: Mapping[Any, Any]) -> str:
    """What a paired comparison says about learning and searching, in words; differences count below p = 0.05."""

    def word(difference: float, p: float, more: str, less: str, equal: str) -> str:
        return equal if not p < _SIGNIFICANCE else more if difference > 0 else less

    success = word(row["success_difference"], row["success_p"], "more", "fewer", "as many")
    actions = word(row["actions_difference"], row["actions_p"], "longer", "shorter", "equally long")
    return (
        f"A learned policy that looks a few actions ahead ({row['method']}) completes {success} tasks "
        f"{'as' if success == 'as many' else 'than'} searching for a plan again ({row['reference']}), with {actions} "
        f"plans ({abs(row['actions_difference']):.1f} actions of difference)."
    )


def _own_method(methods: Sequence[str]) -> str:
    """The method of the headline."""
    return next(name for name in (*_OWN_METHODS, *order_methods(methods)) if name in methods)


def _cards(main: pd.DataFrame) -> list[dict[str, str]]:
    labelled = with_labels(main)
    methods = labelled["method"].tolist()
    own = _own_method(methods)
    rows = labelled.loc[labelled["method"] == own]
    by_space = summarize(rows, ["action_space"]).to_dict("records")
    cards = [
        {
            "label": f"Success, {row['action_space']}",
            "value": percent(row["success_rate"]),
            "range": f"{100 * row['success_rate_low']:.0f} to {percent(row['success_rate_high'])} "
            f"of {row['episodes']} tasks, {own}",
            "colour": method_style(own, methods).colour,
        }
        for row in by_space
    ]
    first = by_space[0]
    cards.append(
        {
            "label": f"Action efficiency, {first['action_space']}",
            "value": number(first["action_efficiency"]),
            "range": "objects in the scene per action",
            "colour": "",
        }
    )
    cards.append(
        {
            "label": f"Decision time, {first['action_space']}",
            "value": duration(decision_time(rows.loc[rows["action_space"] == first["action_space"]])),
            "range": "per action, on one core",
            "colour": "",
        }
    )
    return cards
