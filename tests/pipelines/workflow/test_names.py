"""Names made from texts of the user."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipelines.workflow.names import MAX_LENGTH, metric_name, path_name

AWKWARD = [
    "nets/a/b",
    "nets/a_b",
    "nets a b",
    "a",
    "A",
    "ä",
    "a?",
    "a#",
    "a%",
    "(a)",
    "[a]",
    ".",
    "..",
    "x" * 300,
    "x" * 301,
]


def test_awkward_texts_get_different_valid_names() -> None:
    names = [path_name(text) for text in AWKWARD]
    assert len(set(names)) == len(AWKWARD)
    for name in names:
        assert len(name.encode()) <= MAX_LENGTH
        assert "/" not in name and name not in ("", ".", "..")


def test_plain_names_are_kept() -> None:
    assert path_name("planner=greedy,scene.num_objects=[1,7],seed=0") == "planner=greedy,scene.num_objects=[1,7],seed=0"
    assert metric_name("success_rate/VisualRHP+ 3x3") == "success_rate/VisualRHP plus 3x3"
    assert metric_name("progress/a_b-c.d: e") == "progress/a_b-c.d: e"


@given(st.lists(st.text(min_size=1), min_size=2, max_size=2, unique=True))
def test_different_texts_have_different_names(texts: list[str]) -> None:
    for name in (path_name, metric_name):
        assert name(texts[0]) != name(texts[1])


@pytest.mark.parametrize("pair", [("a+", "a plus"), ("(a)", "[a]"), ("a//b", "a/b"), ("../a", "a"), ("/a", "a")])
def test_names_of_metrics_are_told_apart(pair: tuple[str, str]) -> None:
    assert metric_name(pair[0]) != metric_name(pair[1])


@settings(deadline=None)  # MLflow is imported
@given(st.text(min_size=1))
def test_mlflow_takes_every_name(text: str) -> None:
    from mlflow.utils.validation import _validate_metric_name

    _validate_metric_name(metric_name(text))
