"""Constants that PyTorch and NumPy share have the bits of PyTorch's own."""

import numpy as np
import pytest
import torch

from visualrhp.heuristics.architecture import (
    axis_coordinates,
    cell_centres,
    cell_offsets,
    cell_windows,
    code_colours,
    kernel_offsets,
    label_colours,
    weight_shapes,
)
from visualrhp.heuristics.networks import make_network
from visualrhp.observation import make_observation
from visualrhp.observation.label_image import PALETTE


@pytest.mark.parametrize("size", [8, 16, 64])
def test_coordinates_are_those_of_linspace(size):
    np.testing.assert_array_equal(axis_coordinates(size), torch.linspace(-1.0, 1.0, size).numpy())


def test_colours_of_codes():
    np.testing.assert_array_equal(label_colours(), (torch.from_numpy(PALETTE) / 127.5 - 1.0).numpy())
    colours = code_colours()
    assert colours.shape == (216, 9)
    code = 4 * 36 + 0 * 6 + 5  # desired object, background, gripper
    np.testing.assert_array_equal(colours[code], label_colours()[[4, 0, 5]].reshape(-1))


def test_a_pixel_is_its_cells_centre_and_its_offset():
    axis = axis_coordinates(64)
    centres, offsets = cell_centres().reshape(16, 16, 2), cell_offsets().reshape(4, 4, 2)
    for row, column in [(0, 0), (13, 40), (63, 63)]:
        found = centres[row // 4, column // 4] + offsets[row % 4, column % 4]
        np.testing.assert_allclose(found, [axis[row], axis[column]], atol=1e-6)
    np.testing.assert_allclose(kernel_offsets()[:, 1, 2], [0.0, axis[1] - axis[0]], atol=1e-6)


def test_windows_are_two_codes_in_each_of_six_rows():
    corners, within = cell_windows()
    assert corners[17] == 4 * 64 + 4 and len(corners) == 256
    assert within.tolist() == [row * 64 + column for row in range(6) for column in (0, 3)]


@pytest.mark.parametrize("action_space", ["continuous", "discrete"])
@pytest.mark.parametrize(("name", "num_objects"), [("image", None), ("cartesian", 1), ("cartesian", 7)])
def test_the_weights_are_those_of_the_networks(action_space, name, num_objects):
    observation = make_observation(name, num_objects)
    weights = make_network(action_space, observation).state_dict()
    assert weight_shapes(action_space, observation) == {key: tuple(values.shape) for key, values in weights.items()}
