"""A scene to draw."""

import numpy as np

from visualrhp.rendering.drawing import MARGIN
from visualrhp.scene import ObjectShape, Scene, TargetRegion
from visualrhp.types import State

SQUARE = np.array([[-0.03, -0.03], [0.03, -0.03], [0.03, 0.03], [-0.03, 0.03]])
SCENE = Scene(TargetRegion(np.array([0.12, 0.12])), (ObjectShape(SQUARE), ObjectShape(SQUARE)))
STATE = State.create([-0.15, -0.15, 0.0], 0.085, False, [[-0.1, 0.15, 0.3], [0.15, -0.1, 0.0]])


def pixel(position, size_px):
    """(row, column) of a position [m] in a frame without caption: a square view, MARGIN around the 0.5 m surface."""
    extent = 0.5 + 2 * MARGIN
    return round((extent / 2 - position[1]) / extent * size_px), round((position[0] + extent / 2) / extent * size_px)
