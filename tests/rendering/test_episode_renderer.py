"""Frames of an episode."""

import numpy as np

from tests.rendering.samples import SCENE, SQUARE, STATE
from visualrhp.observation.label_image import PALETTE, label_image
from visualrhp.rendering.episode_renderer import EpisodeRenderer, episode_frames
from visualrhp.rendering.frames import render_frame
from visualrhp.rendering.imagined import ImaginedPath
from visualrhp.rendering.panels import OUTCOME_COLOURS
from visualrhp.scene import ObjectShape, Scene
from visualrhp.types import State


def test_an_episode_becomes_a_picture_of_each_state_and_a_held_end():
    frames = list(
        episode_frames(
            SCENE, STATE, [[STATE] * 4] * 2, title="Greedy", outcome="dropped", max_steps=49, size_px=96, hold=4
        )
    )
    assert len(frames) == 1 + 2 * 3 + 4
    assert len({frame.shape for frame in frames}) == 1
    badges = [(frame == OUTCOME_COLOURS["dropped"]).all(axis=2).any() for frame in frames]
    assert badges == [False] * 6 + [True] * 5


def test_the_label_image_is_that_of_the_state_at_rest_and_of_the_planners_model():
    wide = Scene(SCENE.target, (ObjectShape(1.5 * SQUARE), ObjectShape(SQUARE)))
    moved = State.create([-0.05, -0.15, 0.0], 0.085, False, [[-0.1, 0.15, 0.3], [0.15, -0.1, 0.0]])
    between = State.create([-0.1, -0.15, 0.0], 0.085, False, [[-0.1, 0.15, 0.3], [0.15, -0.1, 0.0]])
    renderer = EpisodeRenderer(SCENE, STATE, size_px=128, show_observation=True, believed_scene=wide)

    def observed(frame):
        panel = frame[:128, 128:]
        return [
            (panel[row : row + 64, column : column + 64] == expected).all()
            for expected in (PALETTE[label_image(wide, STATE)], PALETTE[label_image(wide, moved)])
            for row, column in [np.argwhere((panel == PALETTE[1]).all(axis=2)).min(axis=0)]
        ]

    first = observed(renderer.still())
    frames = [observed(frame) for frame in renderer.move([STATE, between, between, moved])]
    assert first == [True, False]
    assert frames == [[True, False], [True, False], [False, True]]


def test_what_is_imagined_is_shown_before_each_action():
    """One picture of the start, then for each action 2 of the roll-outs and 3 of the motion, then 4 of the end."""
    moved = State.create([-0.05, -0.15, 0.0], 0.085, False, [[-0.1, 0.15, 0.3], [0.15, -0.1, 0.0]])
    imagined = [[ImaginedPath((STATE, moved), -3.0, True)], []]
    motions = [[STATE, moved, STATE, moved], [moved] * 4]
    frames = list(episode_frames(SCENE, STATE, motions, imagined=imagined, size_px=96, imagined_frames=2, hold=4))
    assert len(frames) == 1 + (2 + 3) + 3 + 4
    assert len({frame.shape for frame in frames}) == 1
    pictures = [frame[:96] for frame in frames]
    np.testing.assert_array_equal(pictures[1], render_frame(SCENE, STATE, size_px=96, imagined=imagined[0])[:96])
    np.testing.assert_array_equal(pictures[1], pictures[2])
    assert (pictures[0] == render_frame(SCENE, STATE, size_px=96)).all()
    assert (pictures[5] == render_frame(SCENE, moved, size_px=96, trail=[STATE])).all()
    assert (pictures[3] == render_frame(SCENE, moved, size_px=96, trail=[STATE])).all(), "the motion as it is given"
    assert (frames[3][96:] == frames[1][96:]).all(), "the legend stays"
