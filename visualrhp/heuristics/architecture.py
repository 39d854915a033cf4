"""Constants of Sec. 7.2 and fixed coordinates, for the networks in PyTorch and their inference in NumPy.

The layers are defined once, in :mod:`visualrhp.heuristics.networks`; the inference finds them by the names and shapes
of their weights. :func:`weight_shapes` lists these, so that a file can be checked without PyTorch.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from visualrhp.observation import Observation
from visualrhp.observation.label_image import IMAGE_SIZE, PALETTE
from visualrhp.simulation.action_spaces import ContinuousActionSpace, DiscreteActionSpace
from visualrhp.types import ActionSpaceName

Array = npt.NDArray[np.float32]

RETURN_SCALE: Final = 20.0
"""Unit of the returns that the value heads predict: returns are of the order of -20, the outputs of a layer of 1."""

MIN_STD: Final = 0.05
MAX_STD: Final = 1.0
"""Range of the policy's standard deviations, in units of the action range: the limits of the sigmoid."""

NEGATIVE_SLOPE: Final = 0.01
"""Negative slope of the leaky ReLU."""

NORMALIZATION_EPS: Final = 1e-5
"""Added to the variance in normalization."""

POOLING: Final = 4
"""Side of a pooling cell of the first layer [pixels]."""

CELLS: Final = IMAGE_SIZE // POOLING
"""Pooling cells per side."""

NUM_LABELS: Final = len(PALETTE)
NUM_CODES: Final = NUM_LABELS**3
"""Number of codes of three neighbouring pixels; the last label changes fastest."""

PATCH: Final = POOLING + 2
"""Side of a pooling cell including a border of one pixel [pixels]."""

_SPACING: Final = np.float32(2.0 / (IMAGE_SIZE - 1))


_ENCODER: Final = {
    "encoder.layers.0.convolution": (8, 5, 3, 3),
    "encoder.layers.1": (8,),
    "encoder.layers.3.convolution": (8, 10, 3, 3),
    "encoder.layers.4": (8,),
    "encoder.layers.6.convolution": (16, 10, 3, 3),
    "encoder.layers.7": (16,),
}
_LAYERS: Final = {
    "discrete": {"body.2": (128, 128), "q_head": (DiscreteActionSpace.NUM_ACTIONS, 128)},
    "continuous": {
        "body.2": (128, 256),
        "policy_head.0.0": (128, 128),
        "policy_head.1": (2 * ContinuousActionSpace.DIMENSION, 128),
        "value_head.0.0": (64, 128),
        "value_head.1": (1, 64),
    },
}


def weight_shapes(action_space: ActionSpaceName, observation: Observation) -> dict[str, tuple[int, ...]]:
    """Shapes of the weights of a network, by their names in PyTorch's state dict."""
    is_image = observation.encoder == "label_image"
    layers = dict(_LAYERS[action_space])
    num_features = 256 if is_image else observation.shape[0]
    layers["body.0"] = (layers["body.2"][1], num_features + 1)  # and the state of the gripper
    if is_image:
        layers |= _ENCODER
    return {
        f"{layer}.{name}": shape
        for layer, weight in layers.items()
        for name, shape in (("weight", weight), ("bias", weight[:1]))
    }


def axis_coordinates(size: int) -> Array:
    """[size] coordinates of the pixels of an axis, from -1 to 1; bit-exact with ``torch.linspace``."""
    index = np.arange(size)
    spacing = np.float64(np.float32(2.0) / np.float32(size - 1))
    low, high = -1.0 + spacing * index, 1.0 - spacing * (size - 1 - index)
    return np.where(index < size // 2, low.astype(np.float32), high.astype(np.float32))


def grid(rows: Array, columns: Array) -> Array:
    """[R C, 2] row and column coordinate of every point of a grid, row by row."""
    return np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)


def label_colours() -> Array:
    """[6, 3] colour of each label as input of a network, from -1 to 1."""
    return PALETTE.astype(np.float32) / np.float32(127.5) - np.float32(1.0)


def code_colours() -> Array:
    """[216, 9] the colours of every code: (pixel, colour)."""
    return label_colours()[np.indices((NUM_LABELS,) * 3).reshape(3, -1).T].reshape(NUM_CODES, 9)


def cell_centres() -> Array:
    """[256, 2] row and column of the centre of every pooling cell."""
    centres = axis_coordinates(IMAGE_SIZE).reshape(CELLS, POOLING).mean(axis=1)
    return grid(centres, centres)


def cell_offsets() -> Array:
    """[16, 2] row and column of the pixels of a pooling cell, from its centre."""
    within = (np.arange(POOLING) - 0.5 * (POOLING - 1)).astype(np.float32) * _SPACING
    return grid(within, within)


def kernel_offsets() -> Array:
    """[2, 3, 3] row and column of the entries of a 3 x 3 kernel, from its centre."""
    taps = np.arange(-1, 2).astype(np.float32) * _SPACING
    return np.stack(np.meshgrid(taps, taps, indexing="ij"))


def cell_windows() -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Positions of the codes of a cell in the flat map of codes [66 * 64].

    Returns:
        [256] the first code of each cell; [12] the codes of a cell relative to its first: two in each of six rows.
    """
    steps = np.arange(0, IMAGE_SIZE, POOLING)
    within = np.arange(PATCH)[:, None] * IMAGE_SIZE + np.arange(0, PATCH, 3)
    return (steps[:, None] * IMAGE_SIZE + steps).reshape(-1), within.reshape(-1)
