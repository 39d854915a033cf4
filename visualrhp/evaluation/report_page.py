"""The report as one self-contained HTML page: its content as text. No files are read or written here."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import jinja2
import pandas as pd

from visualrhp.evaluation.methods import method_description, with_labels
from visualrhp.evaluation.metrics import CONFIDENCE, summarize
from visualrhp.evaluation.report_figures import NamedFigure
from visualrhp.evaluation.report_findings import SIGNIFICANCE, findings, own_method, success_sentence
from visualrhp.evaluation.report_tables import decision_time, detail_tables, main_table, number, paired_rows
from visualrhp.evaluation.report_videos import Attempt, SceneVideos
from visualrhp.evaluation.styles import LineStyle, css_colour, css_colours, key_svg, method_styles, to_svg
from visualrhp.evaluation.summaries import duration, main_rows, percent

TEMPLATES: Final = Path(__file__).parent / "templates"

_SYMBOLS: Final = (
    ("n×h", "After the name of a method: it compares n roll-outs of h actions in every state."),
    ("Success rate", "Share of the tasks that are completed in under 50 actions with nothing dropped."),
    (
        "Efficiency",
        "Action efficiency: objects in the scene over actions until completion, mean over the completed tasks "
        "(Sec. 7.3).",
    ),
    ("Time per run", "Time to choose all actions of a run and to simulate them, mean over all runs, on this machine."),
    ("Decision", "Mean time to choose an action, on one core."),
    ("Dropped", "Share of the tasks in which an object falls off the table."),
    (
        "Small numbers",
        f"{CONFIDENCE:.0%} confidence intervals: Wilson's for rates, bootstrap for means. The bars of the figures, and "
        "the two marks on the bar of a success rate in the tables, show the same.",
    ),
    (
        "p",
        f"The probability of such a difference, or a larger one, if the methods were equal. From {SIGNIFICANCE:g} "
        "a difference is not called significant: there may be none, or too few tasks to show it.",
    ),
)
"""What is to be known to read the tables and figures."""

_PIXELS_PER_INCH: Final = 104
"""Natural scale of a figure on the page: its text is about as large as the page's notes."""

_SECTIONS: Final = {
    "environments": (
        "Different environments",
        "Environments",
        "Success, action efficiency and time as scenes have more and larger objects (Sec. 8.1). Symbols stand side by "
        f"side for one number or size of objects; bars are {CONFIDENCE:.0%} confidence intervals.",
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
    styles = method_styles(content.episodes)
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
        lead=" ".join(findings(main)) or success_sentence(main),
        facts=content.facts,
        cards=_cards(main),
        scenes=[_scene(scene) for scene in content.scenes],
        results_note=(f"{success_sentence(main)} {_description(main)} Every method is run on the same tasks."),
        methods=_methods(content.episodes, styles),
        keys={name: key_svg(style) for name, style in styles.items()},
        colours={name: css_colour(style.colour) for name, style in styles.items()},
        light=css_colours("light"),
        dark=css_colours("dark"),
        symbols=_SYMBOLS,
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


def _methods(episodes: pd.DataFrame, styles: Mapping[str, LineStyle]) -> list[tuple[str, str]]:
    """The evaluated methods with what they do, in the order of legends."""
    planners = dict(with_labels(episodes)[["method", "planner"]].itertuples(index=False, name=None))
    return [(name, method_description(planners[name])) for name in styles]


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


def _cards(main: pd.DataFrame) -> list[dict[str, str]]:
    labelled = with_labels(main)
    own = own_method(labelled["method"].tolist())
    rows = labelled.loc[labelled["method"] == own]
    by_space = summarize(rows, ["action_space"]).to_dict("records")
    cards = [
        {
            "label": f"Success, {row['action_space']}",
            "value": percent(row["success_rate"]),
            "range": f"{100 * row['success_rate_low']:.0f} to {percent(row['success_rate_high'])} "
            f"of {row['episodes']} tasks, {own}",
            "method": own,
        }
        for row in by_space
    ]
    first = by_space[0]
    cards.append(
        {
            "label": f"Action efficiency, {first['action_space']}",
            "value": number(first["action_efficiency"]),
            "range": "objects in the scene per action",
            "method": "",
        }
    )
    cards.append(
        {
            "label": f"Decision time, {first['action_space']}",
            "value": duration(decision_time(rows.loc[rows["action_space"] == first["action_space"]])),
            "range": "per action, on one core",
            "method": "",
        }
    )
    return cards
