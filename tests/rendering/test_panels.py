"""Captions fit into their bar."""

import numpy as np

from tests.rendering.samples import SCENE, STATE
from visualrhp.rendering.frames import render_frame
from visualrhp.rendering.panels import OUTCOME_COLOURS, Caption


def test_a_long_title_stays_clear_of_the_outcome():
    def bar(title):
        frame = render_frame(SCENE, STATE, size_px=160, caption=Caption(title, 12, 49, "out of actions"))
        return frame[: frame.shape[0] - 160]

    long = bar("a planner with a name that no bar is wide enough for")
    outcome = (bar("x") == OUTCOME_COLOURS["out of actions"]).all(axis=2)
    np.testing.assert_array_equal(outcome, (long == OUTCOME_COLOURS["out of actions"]).all(axis=2))


def test_the_words_of_a_small_caption_do_not_touch():
    """Outcome first, then the step, then what fits of the title: each apart from the next by columns of paper."""
    for size_px in (96, 128, 160, 240):
        frame = render_frame(SCENE, STATE, size_px=size_px, caption=Caption("Crafted", 48, 49, "out of actions"))
        bar = frame[2:20]
        badge = np.flatnonzero((bar == OUTCOME_COLOURS["out of actions"]).all(axis=2).any(axis=0))
        assert badge.max() < size_px - 4
        left = badge.min()
        assert left < 4 or (bar[:, left - 4 : left - 1].astype(int).sum(axis=2) > 700).all()
