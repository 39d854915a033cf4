"""Frames: the picture and what is added around it."""

import numpy as np
import pytest

from tests.rendering.samples import SCENE, STATE
from visualrhp.errors import ConfigError
from visualrhp.observation.label_image import PALETTE, label_image
from visualrhp.rendering.episode_renderer import episode_frames
from visualrhp.rendering.frames import render_frame
from visualrhp.rendering.imagined import ImaginedPath
from visualrhp.rendering.panels import OUTCOME_COLOURS, Caption


def test_caption_and_observation_are_added_around_the_same_picture():
    plain = render_frame(SCENE, STATE, size_px=240)
    full = render_frame(
        SCENE, STATE, size_px=240, caption=Caption("VisualRHP 3x3", 7, 49, "success"), show_observation=True
    )
    bar = full.shape[0] - 240
    assert bar > 0 and full.shape[0] % 2 == 0 and full.shape[1] % 2 == 0
    np.testing.assert_array_equal(full[bar:, :240], plain)
    assert (full[:bar] == OUTCOME_COLOURS["success"]).all(axis=2).sum() > 100
    observed = PALETTE[label_image(SCENE, STATE)]
    panel = full[bar:, 240:]
    places = [
        (row, column)
        for row in range(panel.shape[0] - 64)
        for column in range(panel.shape[1] - 64)
        if (panel[row, column : column + 64] == observed[0]).all()
        and (panel[row : row + 64, column : column + 64] == observed).all()
    ]
    assert len(places) == 1  # 240 px leave room for one pixel a label


@pytest.mark.parametrize("size_px", [64, 96, 120, 200, 321])
@pytest.mark.parametrize("outcome", [None, "success", "out of actions"])
def test_everything_at_once_fits_at_any_size(size_px, outcome):
    imagined = [ImaginedPath((STATE, STATE), -12.3, True), ImaginedPath((STATE,), -np.inf)]
    frame = render_frame(
        SCENE,
        STATE,
        size_px=size_px,
        trail=[STATE],
        imagined=imagined,
        caption=Caption("CraftedHeuristicRHP 8x4", 48, 49, outcome),
        show_legend=True,
        show_observation=True,
        show_inset=True,
    )
    assert frame.shape[0] % 2 == 0 and frame.shape[1] % 2 == 0
    caption = frame[:20].astype(int).sum(axis=2)
    assert (caption[2:, :2] > 700).all() and (caption[2:, -2:] > 700).all(), "no word is cut off"


def test_a_number_of_frames_below_one_is_refused():
    with pytest.raises(ConfigError, match="imagined_frames=0"):
        next(episode_frames(SCENE, STATE, [], imagined_frames=0))
