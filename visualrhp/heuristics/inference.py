"""Inference of the networks of Sec. 7.2 in NumPy, for a few states at a time. Does not import torch.

A decision of receding horizon planning evaluates the network h + 1 times for 1 to n states, and the simulation in
between evicts it from the processor cache. The arithmetic for a state takes about 20 microseconds; the overhead of
PyTorch's operations, and of the tables that depend on the weights, would be many times that. The tables are therefore
computed once, and inference consists of a few simple operations on maps with the channels last:

- The first layer adds rows of a table for every cell with several labels (:class:`_LabelConvolution`), as
  :mod:`visualrhp.heuristics.label_convolution` does in training.
- A convolution is one matrix product per image, of its 3 x 3 patches and the kernel; the contribution of CoordConv's
  coordinates is a constant.

All products and sums are over one state, so **the output for a state does not depend on the other states in the
batch**. It agrees with the networks in PyTorch to seven digits.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from visualrhp.heuristics.architecture import (
    CELLS,
    MAX_STD,
    MIN_STD,
    NEGATIVE_SLOPE,
    NORMALIZATION_EPS,
    NUM_CODES,
    NUM_LABELS,
    PATCH,
    POOLING,
    RETURN_SCALE,
    Array,
    axis_coordinates,
    cell_centres,
    cell_offsets,
    cell_windows,
    code_colours,
    kernel_offsets,
    label_colours,
)
from visualrhp.observation import Observation
from visualrhp.observation.label_image import IMAGE_SIZE, Label
from visualrhp.simulation.action_spaces import ContinuousActionSpace, DiscreteActionSpace

Weights = Mapping[str, npt.NDArray[np.floating]]
"""The weights of a network by their names in PyTorch's state dict."""

_CHUNK: Final = 16
"""Number of states computed at a time, so that their data stays in the processor cache."""

_HEADS: Final = {"discrete": ("q_head",), "continuous": ("policy_head", "value_head")}
_OUTPUTS: Final = {
    "discrete": ((DiscreteActionSpace.NUM_ACTIONS,),),
    "continuous": ((ContinuousActionSpace.DIMENSION,), (ContinuousActionSpace.DIMENSION,), ()),
}
"""Shapes of the outputs for one state."""


class InferenceNetwork:
    """Computes the outputs of a network with fixed weights.

    Args:
        weights: of a network of :mod:`visualrhp.heuristics.networks`; copied, in single precision.
        action_space: of the network.

    Attributes:
        action_space: as given.
        encoder: label images to features; None for a network that reads features.

    Raises:
        KeyError: a weight is missing.
    """

    def __init__(self, weights: Weights, action_space: str) -> None:
        weights = {name: np.array(values, dtype=np.float32) for name, values in weights.items()}
        self.action_space = action_space
        has_encoder = any(name.startswith("encoder.") for name in weights)
        self.encoder = ImageEncoderInference(_within(weights, "encoder.layers")) if has_encoder else None
        self._body = _dense_layers(_within(weights, "body"))
        self._heads = [_dense_layers(_within(weights, head)) for head in _HEADS[action_space]]

    def __call__(self, observations: npt.NDArray, gripper_closed: npt.NDArray[np.bool_]) -> tuple[Array, ...]:
        """Action values, or policy and value.

        Args:
            observations: [B, 64, 64] uint8 labels or [B, F] float32 features.
            gripper_closed: [B].

        Returns:
            As the network's: action values [B, 8]; or means [B, 4], standard deviations [B, 4] and values [B].
        """
        chunks = range(0, len(observations), _CHUNK)
        outputs = [self._evaluate(observations[k : k + _CHUNK], gripper_closed[k : k + _CHUNK]) for k in chunks]
        return outputs[0] if len(outputs) == 1 else tuple(map(np.concatenate, zip(*outputs, strict=True)))

    def check(self, observation: Observation) -> None:
        """Check that the weights match, by evaluating two observations, of zeros and of ones.

        Raises:
            ValueError: they do not match, the number of outputs is not that of the action space, or an output is not
                finite.
        """
        observations = np.zeros((2, *observation.shape), observation.dtype)
        observations[1] = 1
        with np.errstate(all="ignore"):
            outputs = self(observations, np.array([False, True]))
        found = tuple(output.shape[1:] for output in outputs)
        if found != _OUTPUTS[self.action_space]:
            raise ValueError(f"its outputs have the shapes {found}, not {_OUTPUTS[self.action_space]}")
        if not all(np.isfinite(output).all() for output in outputs):
            raise ValueError("its outputs are not finite, since its weights are too large")

    def _evaluate(self, observations: npt.NDArray, gripper_closed: npt.NDArray[np.bool_]) -> tuple[Array, ...]:
        encoded = observations if self.encoder is None else self.encoder(observations)
        features = np.empty((len(encoded), 1, encoded.shape[1] + 1), dtype=np.float32)
        features[:, 0, :-1] = encoded
        features[:, 0, -1] = gripper_closed
        shared = _leaky(_apply(self._body, features))
        heads = [_apply(head, shared)[:, 0] for head in self._heads]
        if len(heads) == 1:
            return (np.float32(RETURN_SCALE) * heads[0],)
        policy, value = heads
        mean, spread = np.split(policy, 2, axis=1)
        std = np.float32(MIN_STD) + np.float32(MAX_STD - MIN_STD) / (1.0 + np.exp(-spread))
        return np.tanh(mean), std, np.float32(RETURN_SCALE) * value[:, 0]


class ImageEncoderInference:
    """:class:`visualrhp.heuristics.networks.ImageEncoder`: [B, 64, 64] uint8 to [B, 256].

    Args:
        weights: of its layers by number: convolutions, each followed by a normalization.
    """

    def __init__(self, weights: Weights) -> None:
        numbers = sorted({int(name.partition(".")[0]) for name in weights})
        first, *convolutions = (number for number in numbers if f"{number}.convolution.weight" in weights)
        self._first = _LabelConvolution(_within(weights, f"{first}.convolution"))
        sizes = [CELLS]
        self._convolutions = []
        for number in convolutions:
            self._convolutions.append(_CoordConv(_within(weights, f"{number}.convolution"), sizes[-1]))
            sizes.append(sizes[-1] // 2)
        norms = [_within(weights, str(number)) for number in numbers if f"{number}.weight" in weights]
        self._norms = [_Normalization(norm, size) for norm, size in zip(norms, sizes, strict=True)]

    def __call__(self, labels: npt.NDArray[np.uint8]) -> Array:
        return self.maps(labels)[-1].transpose(0, 3, 1, 2).reshape(len(labels), -1)

    def maps(self, labels: npt.NDArray[np.uint8]) -> list[Array]:
        """The activated maps after every convolution, [B, s, s, channels] each."""
        maps = [_leaky(self._norms[0](self._first(labels)))]
        for convolve, normalize in zip(self._convolutions, self._norms[1:], strict=True):
            maps.append(_leaky(normalize(convolve(maps[-1]))))
        return maps


class _LabelConvolution:
    """:class:`visualrhp.heuristics.label_convolution.LabelConvolution`: [B, 64, 64] uint8 to [B, 16, 16, out].

    A row of a pooling cell (4 positions) depends on three rows of pixels, each with two codes of three pixels. Six
    tables, for (row of the kernel, left or right code), hold the contributions of every code to the values of the four
    positions; they are added in this order.
    """

    def __init__(self, weights: Weights) -> None:
        weight = weights["weight"]  # [out, colours and coordinates, 3, 3]
        out = len(weight)
        kernel, coordinate_kernel = weight[:, :3], weight[:, 3:]
        slope = _sum_by_lanes(coordinate_kernel.reshape(out, 2, 9)).T  # [2, out]
        self._offsets = _product(cell_offsets(), slope)  # [16, out] added at the positions of a cell
        centre = _sum_by_lanes((coordinate_kernel * kernel_offsets()).reshape(out, 18))
        plane = _product(cell_centres(), slope) + centre + weights["bias"]  # [256, out] added to every cell
        uniform = _product(label_colours(), _sum_by_lanes(kernel.reshape(out, 3, 9)).T) + self._offsets.max(axis=0)
        self._offsets = self._offsets.reshape(POOLING, POOLING * out)
        self._plane = plane.reshape(-1)
        self._tables = _tables(kernel)
        # The pooled values of a cell with a single label, from the code of its first three pixels.
        self._uniform = np.zeros((NUM_CODES, out), dtype=np.float32)
        of_one_label = np.arange(NUM_LABELS) * (NUM_CODES - 1) // (NUM_LABELS - 1)
        self._uniform[of_one_label] = uniform
        self._is_mixed = np.ones(NUM_CODES, dtype=np.bool_)
        self._is_mixed[of_one_label] = False
        self._corners, within = cell_windows()
        self._windows = within[:, None] + self._corners
        self._within = np.ascontiguousarray(within.reshape(PATCH, 2).T)[:, :, None]  # [2 codes, 6 rows, 1]

    def __call__(self, labels: npt.NDArray[np.uint8]) -> Array:
        batch, size = len(labels), IMAGE_SIZE
        padded = np.full((batch, size + 2, size + 2), Label.EDGE, dtype=np.uint8)
        padded[:, 1:-1, 1:-1] = labels
        codes = padded[:, :, :-2] * np.uint8(NUM_LABELS**2)  # of three neighbouring pixels [B, 66, 64]
        codes += padded[:, :, 1:-1] * np.uint8(NUM_LABELS)
        codes += padded[:, :, 2:]
        codes = codes.reshape(batch, -1)

        of_cells = codes.take(self._windows, axis=1)  # [B, 12, 256]
        first = of_cells[:, 0]
        image, cell = ((of_cells != of_cells[:, :1]).any(axis=1) | self._is_mixed[first]).nonzero()
        corners = image * codes.shape[1] + self._corners[cell]
        maps = self._uniform.take(first, axis=0)  # [B, 256, out]
        maps[image, cell] = self._pooled(codes.reshape(-1).take(self._within + corners).astype(np.intp))
        maps.reshape(batch, -1)[...] += self._plane
        return maps.reshape(batch, CELLS, CELLS, -1)

    def _pooled(self, codes: npt.NDArray[np.intp]) -> Array:
        """[n, out] the values of n cells, from their codes [2, 6, n]."""
        values = self._tables[0].take(codes[0, :POOLING], axis=0, mode="clip")  # [4, n, 4 out]
        values += self._offsets[:, None]
        shares = np.empty_like(values)
        for number, table in enumerate(self._tables[1:], start=1):
            row, half = divmod(number, 2)
            table.take(codes[half, row : row + POOLING], axis=0, out=shares, mode="clip")
            values += shares
        values = np.maximum(values[:2], values[2:])
        values = np.maximum(values[0], values[1])
        while values.shape[1] > self._uniform.shape[1]:  # halve until one of the four positions remains
            middle = values.shape[1] // 2
            values = np.maximum(values[:, :middle], values[:, middle:])
        return values


def _tables(kernel: Array) -> list[Array]:
    """Six tables [216, 4 out]: contributions of a code to a row of positions, by (kernel row, left or right code).

    Args:
        kernel: [out, colour, row, column].
    """
    colours, tables = code_colours(), []
    for row in range(3):
        for half in range(2):
            shares = np.zeros((3, 3, POOLING, len(kernel)), dtype=np.float32)  # pixel, colour, position, filter
            for pixel in range(3):
                for position in range(POOLING):
                    column = 3 * half + pixel - position
                    if 0 <= column < 3:
                        shares[pixel, :, position] = kernel[:, :, row, column].T
            tables.append(_fused_product(colours, shares.reshape(9, -1)))
    return tables


class _CoordConv:
    """:class:`visualrhp.heuristics.networks.CoordConv`: [B, s, s, in] to [B, s / 2, s / 2, out]."""

    def __init__(self, weights: Weights, size: int) -> None:
        weight = weights["weight"]  # [out, in + 2, 3, 3]
        kernel, coordinate_kernel = weight[:, :-2], weight[:, -2:]
        self._kernel = np.ascontiguousarray(kernel.transpose(2, 3, 1, 0)).reshape(-1, len(weight))
        self._plane = _coordinate_plane(coordinate_kernel, weights["bias"], size)

    def __call__(self, maps: Array) -> Array:
        batch, size, _, channels = maps.shape
        padded = np.zeros((batch, size + 2, size + 2, channels), dtype=np.float32)
        padded[:, 1:-1, 1:-1] = maps
        image, row, column, channel = padded.strides
        patches = np.ndarray(  # row, column; row of the kernel, (column of the kernel, channel)
            (batch, size, size, 3, 3 * channels), np.float32, padded, strides=(image, row, column, row, channel)
        )
        full = patches.reshape(batch, size * size, 9 * channels) @ self._kernel  # [B, s * s, out]
        full += self._plane
        full = full.reshape(batch, size // 2, 2, -1)
        full = np.maximum(full[:, :, 0], full[:, :, 1]).reshape(batch, size // 2, size // 2, 2, -1)
        return np.maximum(full[:, :, :, 0], full[:, :, :, 1])


def _coordinate_plane(kernel: Array, bias: Array, size: int) -> Array:
    """[s s, out] contribution of CoordConv's coordinates and the bias to every pixel, for ``kernel`` [out, 2, 3, 3]."""
    axis = axis_coordinates(size)
    coordinates = np.pad(np.stack(np.meshgrid(axis, axis, indexing="ij")), ((0, 0), (1, 1), (1, 1)))
    plane = np.zeros((size, size, len(kernel)), dtype=np.float32)
    for channel in range(2):
        for row in range(3):
            for column in range(3):
                shifted = coordinates[channel, row : row + size, column : column + size, None]
                plane = _fused_add(shifted, kernel[:, channel, row, column], plane)
    return (plane + bias).reshape(size * size, -1)


class _Normalization:
    """Normalization of maps [B, s, s, c] over all channels and pixels of a state."""

    def __init__(self, weights: Weights, size: int) -> None:
        self._weight, self._bias = (np.tile(weights[name], size * size) for name in ("weight", "bias"))

    def __call__(self, maps: Array) -> Array:
        flat = maps.reshape(len(maps), -1)
        share = np.float32(1.0 / flat.shape[1])
        centred = flat - np.add.reduce(flat, axis=1, keepdims=True) * share
        variance = np.add.reduce(centred * centred, axis=1, keepdims=True) * share
        centred *= 1.0 / np.sqrt(variance + np.float32(NORMALIZATION_EPS))
        centred *= self._weight
        centred += self._bias
        return centred.reshape(maps.shape)


def _within(weights: Weights, prefix: str) -> dict[str, npt.NDArray]:
    """The weights whose names begin with ``prefix`` and a dot, which are removed from the names."""
    return {name[len(prefix) + 1 :]: values for name, values in weights.items() if name.startswith(f"{prefix}.")}


def _dense_layers(weights: Weights) -> list[tuple[Array, Array]]:
    """Weights [in, out] and biases [out] of fully connected layers, in order."""
    names = [name.removesuffix("weight") for name in weights if name.endswith("weight")]
    names.sort(key=lambda name: [int(number) for number in re.findall(r"\d+", name)])
    return [(np.ascontiguousarray(weights[f"{name}weight"].T), weights[f"{name}bias"]) for name in names]


def _apply(layers: Sequence[tuple[Array, Array]], vectors: Array) -> Array:
    """[B, 1, in] to [B, 1, out]: a separate product for every state."""
    for number, (weight, bias) in enumerate(layers):
        vectors = (_leaky(vectors) if number else vectors) @ weight
        vectors += bias
    return vectors


def _leaky(values: Array) -> Array:
    return np.maximum(values, np.float32(NEGATIVE_SLOPE) * values)


# The constants that depend on the weights are bit-exact with PyTorch's kernels (oneDNN, AVX), so results do not depend
# on which of the two computed them. Every step below is elementwise, and therefore the same on every machine.
def _fused_add(left: Array, right: Array, total: Array) -> Array:
    """left * right + total with a single rounding."""
    return (left.astype(np.float64) * right + total).astype(np.float32)


def _fused_product(left: Array, right: Array) -> Array:
    """[n, k] times [k, m] by fused multiply-adds, in the order of k."""
    product = np.zeros((len(left), right.shape[1]), dtype=np.float32)
    for k in range(len(right)):
        product = _fused_add(left[:, k, None], right[k], product)
    return product


def _product(left: Array, right: Array) -> Array:
    """[n, k] times [k, m] by separately rounded multiplications and additions, in the order of k."""
    product = left[:, 0, None] * right[0]
    for k in range(1, len(right)):
        product = product + left[:, k, None] * right[k]
    return product


def _sum_by_lanes(values: Array) -> Array:
    """Sum over the last axis [.., n]: lanes of eight, then the rest, then the lanes one by one."""
    lanes = values.shape[-1] // 8
    total = np.zeros(values.shape[:-1], dtype=np.float32)
    for k in range(8 * lanes, values.shape[-1]):
        total = total + values[..., k]
    columns = values[..., : 8 * lanes].reshape(*values.shape[:-1], lanes, 8)
    summed = columns[..., 0, :]
    for lane in range(1, lanes):
        summed = summed + columns[..., lane, :]
    for k in range(8):
        total = total + summed[..., k]
    return total
