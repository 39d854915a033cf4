"""The look of methods, and figures as text and as files."""

import pytest

from tests.evaluation.samples import ablation_table
from visualrhp.evaluation import episode_figures, styles
from visualrhp.evaluation.methods import KNOWN_METHODS


@pytest.fixture(scope="module")
def episodes():
    return ablation_table()


def test_every_method_has_its_own_look():
    labels = ["a", "b", *KNOWN_METHODS]
    assert len({styles.method_style(label, labels) for label in labels}) == len(labels)


def test_svg_for_a_page_is_self_contained_and_reproducible(episodes):
    svg = styles.to_svg(episode_figures.by_num_objects(episodes))
    assert svg.startswith("<svg") and svg.endswith("</svg>")
    assert "http" not in svg
    assert "currentColor" in svg and 'id="axes' not in svg
    assert svg == styles.to_svg(episode_figures.by_num_objects(episodes))


def test_files_are_reproducible(episodes, tmp_path):
    for name in ("a.svg", "b.svg", "a.png", "b.png"):
        styles.save(episode_figures.by_size(episodes, "action_efficiency"), tmp_path / name)
    for suffix in ("svg", "png"):
        assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()
