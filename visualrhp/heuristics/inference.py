"""The networks of Sec. 7.2 for planning, in NumPy: a few states at a time, many times a second.

A decision of receding horizon planning asks the network h + 1 times about 1 to n states, and the physics in between
leaves nothing of it in the processor's cache. The arithmetic of a state takes some 20 microseconds; what else there is
to pay, a few microseconds an operation in PyTorch and the tables that follow from the weights, would be many times
that. So the tables are computed once for the weights as they are, and the rest is few and simple operations on maps
with the channels last:

- The first layer adds up twelve rows of a table for every cell of several labels, as in
  :mod:`visualrhp.heuristics.label_convolution`; that sum alone is PyTorch's.
- A convolution is one matrix product for every image, of its 3 x 3 patches and the kernel; what it makes of CoordConv's
  coordinates is a constant.

Every product and sum is over one state. **The answer for a state is the same to the bit, whichever others are asked
about with it**, which the networks themselves, as PyTorch computes them, are to seven digits only.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
import torch
from torch import nn
from torch.nn import functional

from visualrhp.heuristics.label_convolution import LabelConvolution, cell_windows
from visualrhp.heuristics.networks import MAX_STD, MIN_STD, RETURN_SCALE, ActorCritic, CoordConv, ImageEncoder, QNetwork
from visualrhp.rendering.label_image import IMAGE_SIZE, PALETTE, Label

Array = npt.NDArray[np.float32]

_CHUNK: Final = 16
"""States computed at a time: what they need then stays in the processor's cache."""

_LABELS: Final = len(PALETTE)
_CODES: Final = _LABELS**3
_SLOPE: Final = np.float32(0.01)
"""Of a leaky ReLU below zero."""


class FastNetwork:
    """What a network answers, with the weights that it had when this was made.

    Args:
        network: on any device.
    """

    def __init__(self, network: QNetwork | ActorCritic) -> None:
        self._encoder = _ImageEncoder(network.encoder) if isinstance(network.encoder, ImageEncoder) else None
        self._body = _dense_layers(network.body)
        if isinstance(network, QNetwork):
            self._heads = (_dense_layers(network.q_head),)
        else:
            self._heads = (_dense_layers(network.policy_head), _dense_layers(network.value_head))

    def __call__(self, observations: np.ndarray, gripper_closed: npt.NDArray[np.bool_]) -> tuple[Array, ...]:
        """Action values, or policy and value.

        Args:
            observations: [B, 64, 64] uint8 labels or [B, 4 m + 6] float32 features.
            gripper_closed: [B].

        Returns:
            As the network's: action values [B, 8]; or means [B, 4], standard deviations [B, 4] and values [B].
        """
        chunks = range(0, len(observations), _CHUNK)
        outputs = [self._answer(observations[k : k + _CHUNK], gripper_closed[k : k + _CHUNK]) for k in chunks]
        return outputs[0] if len(outputs) == 1 else tuple(map(np.concatenate, zip(*outputs, strict=True)))

    def _answer(self, observations: np.ndarray, gripper_closed: npt.NDArray[np.bool_]) -> tuple[Array, ...]:
        encoded = observations if self._encoder is None else self._encoder(observations)
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


class _ImageEncoder:
    """:class:`visualrhp.heuristics.networks.ImageEncoder`: [B, 64, 64] uint8 to [B, 256]."""

    def __init__(self, encoder: ImageEncoder) -> None:
        first, *rest = encoder.layers
        assert isinstance(first, LabelConvolution)
        self._first = _LabelConvolution(first)
        self._convolutions = [_CoordConv(layer) for layer in rest if isinstance(layer, CoordConv)]
        sizes = [IMAGE_SIZE // 4, *(layer.size // 2 for layer in self._convolutions)]
        norms = [layer for layer in rest if isinstance(layer, nn.GroupNorm)]
        self._norms = [_Normalization(norm, size) for norm, size in zip(norms, sizes, strict=True)]

    def __call__(self, labels: npt.NDArray[np.uint8]) -> Array:
        maps = _leaky(self._norms[0](self._first(labels)))
        for convolve, normalize in zip(self._convolutions, self._norms[1:], strict=True):
            maps = _leaky(normalize(convolve(maps)))
        return maps.transpose(0, 3, 1, 2).reshape(len(maps), -1)


class _LabelConvolution:
    """[B, 64, 64] uint8 to [B, 16, 16, out]."""

    def __init__(self, layer: LabelConvolution) -> None:
        with torch.no_grad():
            self._table = layer.table().flatten(0, 1).float().cpu().contiguous()  # [12 * 216, 16 out]
            _, _, uniform, plane = layer.parts()
        self._plane = _array(plane).reshape(-1)  # [256 out]
        # The pooled values of a cell that is one label, from the code of its first three pixels.
        self._uniform = np.zeros((_CODES, layer.out_channels), dtype=np.float32)
        of_one_label = np.arange(_LABELS) * (_CODES - 1) // (_LABELS - 1)
        self._uniform[of_one_label] = _array(uniform)
        self._is_mixed = np.ones(_CODES, dtype=np.bool_)
        self._is_mixed[of_one_label] = False
        corners, within = cell_windows()
        self._corners, self._within = corners.numpy(), within.numpy()
        self._windows = self._within[:, None] + self._corners
        self._places = np.arange(len(within)) * _CODES
        self._starts = torch.arange(_CHUNK * len(corners)) * len(within)

    def __call__(self, labels: npt.NDArray[np.uint8]) -> Array:
        batch, size = len(labels), IMAGE_SIZE
        padded = np.full((batch, size + 2, size + 2), Label.EDGE, dtype=np.uint8)
        padded[:, 1:-1, 1:-1] = labels
        codes = padded[:, :, :-2] * np.uint8(_LABELS**2)  # of three neighbouring pixels [B, 66, 64]
        codes += padded[:, :, 1:-1] * np.uint8(_LABELS)
        codes += padded[:, :, 2:]
        codes = codes.reshape(batch, -1)

        of_cells = codes.take(self._windows, axis=1)  # [B, 12, 256]
        first = of_cells[:, 0]
        image, cell = ((of_cells != of_cells[:, :1]).any(axis=1) | self._is_mixed[first]).nonzero()
        starts = image * codes.shape[1] + self._corners[cell]
        rows = codes.reshape(-1).take(starts[:, None] + self._within) + self._places  # [n, 12]
        values = functional.embedding_bag(
            torch.from_numpy(rows.reshape(-1)), self._table, self._starts[: len(rows)], mode="sum"
        ).numpy()  # [n, 16 out]
        maps = self._uniform.take(first, axis=0)  # [B, 256, out]
        while values.shape[1] > maps.shape[2]:  # halve until the 16 pixels of a cell are one
            middle = values.shape[1] // 2
            values = np.maximum(values[:, :middle], values[:, middle:])
        maps[image, cell] = values
        maps.reshape(batch, -1)[...] += self._plane
        return maps.reshape(batch, size // 4, size // 4, -1)


class _CoordConv:
    """[B, s, s, in] to [B, s / 2, s / 2, out]."""

    def __init__(self, layer: CoordConv) -> None:
        kernel, plane = layer.parts()
        self._kernel = np.ascontiguousarray(_array(kernel).transpose(2, 3, 1, 0)).reshape(-1, kernel.shape[0])
        self._plane = np.ascontiguousarray(_array(plane)[0].transpose(1, 2, 0)).reshape(-1, kernel.shape[0])
        self.size = plane.shape[-1]

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


class _Normalization:
    """Over all channels and pixels of a state: maps [B, s, s, c] of the same shape."""

    def __init__(self, norm: nn.GroupNorm, size: int) -> None:
        assert norm.num_groups == 1
        self._weight, self._bias = (np.tile(_array(values), size * size) for values in (norm.weight, norm.bias))
        self._eps = np.float32(norm.eps)

    def __call__(self, maps: Array) -> Array:
        flat = maps.reshape(len(maps), -1)
        share = np.float32(1.0 / flat.shape[1])
        centred = flat - np.add.reduce(flat, axis=1, keepdims=True) * share
        variance = np.add.reduce(centred * centred, axis=1, keepdims=True) * share
        centred *= 1.0 / np.sqrt(variance + self._eps)
        centred *= self._weight
        centred += self._bias
        return centred.reshape(maps.shape)


def _dense_layers(module: nn.Module) -> list[tuple[Array, Array]]:
    """Weights [in, out] and biases [out] of the linear layers in ``module``, leaky ReLUs between them."""
    linear = [layer for layer in module.modules() if isinstance(layer, nn.Linear)]
    return [(np.ascontiguousarray(_array(layer.weight).T), _array(layer.bias)) for layer in linear]


def _apply(layers: list[tuple[Array, Array]], vectors: Array) -> Array:
    """[B, 1, in] to [B, 1, out]: a product of its own for every state."""
    for number, (weight, bias) in enumerate(layers):
        vectors = (_leaky(vectors) if number else vectors) @ weight
        vectors += bias
    return vectors


def _leaky(values: Array) -> Array:
    return np.maximum(values, _SLOPE * values)


def _array(tensor: torch.Tensor) -> Array:
    """A copy in single precision."""
    return np.array(tensor.detach().float().cpu().numpy())
