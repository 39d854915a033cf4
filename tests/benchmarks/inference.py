"""The network of a decision, a few states at a time: ours, in NumPy, against PyTorch and ONNX Runtime.

The others have the plain first layer: convolutions of coloured images are what compilers know, and soonest done for one
image. Eager PyTorch is also shown with the layer that is made for training. All are asked about the same states, give
the same answers, and have one thread.
"""

from __future__ import annotations

import contextlib
import copy
import importlib
import importlib.util
import io
import logging
import shutil
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import nn

from tests.benchmarks.timing import Effort, Stopwatch, compare, numbered, show_title, timed
from tests.benchmarks.walks import random_walks
from tests.heuristics.plain_convolution import PlainLabelConvolution
from visualrhp.heuristics.conversion import weights_of
from visualrhp.heuristics.inference import InferenceNetwork
from visualrhp.heuristics.label_convolution import LabelConvolution
from visualrhp.heuristics.networks import ActorCritic, ImageEncoder, QNetwork, make_network
from visualrhp.observation import make_observation
from visualrhp.types import ActionSpaceName

_BATCHES = (1, 3, 6)
_DISTURBANCE = np.empty(2_000_000, dtype=np.uint8)
"""As large as a processor's second cache: to pass over it leaves as little of the network there as the physics does."""

_Network = QNetwork | ActorCritic
_Answer = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, ...]]
"""Observations [B, ...] and closed grippers [B] to the outputs of the network."""


def run(effort: Effort) -> None:
    for space in ("continuous", "discrete"):
        for observation in ("image", "cartesian"):
            _show(effort, space, observation)


def _show(effort: Effort, space: ActionSpaceName, observation: str) -> None:
    torch.manual_seed(0)
    function = make_observation("image") if observation == "image" else make_observation("cartesian", 7)
    network = make_network(space, function).requires_grad_(False).eval()
    walk = random_walks(7, 6, space)[0]
    states = walk.states[: max(_BATCHES)]
    assert len(states) == max(_BATCHES)
    observations = np.stack([function(walk.scene, state) for state in states])
    closed = np.array([state.gripper_closed for state in states])
    fast = InferenceNetwork(weights_of(network), space)
    show_title(f"Network, {space}, {observation}, 7 objects, one thread, against")
    for name, answer in _answers(effort, network, observations, closed).items():
        for ours, theirs in zip(fast(observations, closed), answer(observations, closed), strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-3, atol=1e-3)
        for batch in _BATCHES:
            asked = observations[:batch], closed[:batch]
            compare(numbered(batch, "state"), _cold(fast, asked), _cold(answer, asked), name, 10 * effort.repetitions)


def _cold(answer: _Answer, asked: tuple[np.ndarray, np.ndarray]) -> Stopwatch:
    """Time of an answer when something else has had the cache, as in a decision."""
    stopwatch = timed(lambda: answer(*asked))

    def after_something_else() -> float:
        _DISTURBANCE[...] += 1
        return stopwatch()

    return after_something_else


def _answers(effort: Effort, network: _Network, observations: np.ndarray, closed: np.ndarray) -> dict[str, _Answer]:
    plain = _plain(network)
    answers = {"PyTorch, eager": _torch_answer(plain)}
    if isinstance(network.encoder, ImageEncoder):
        answers["PyTorch, eager, first layer of training"] = _torch_answer(network)
    if effort.repetitions > 1:  # compiling takes a minute
        if shutil.which("c++"):
            answers["PyTorch, compiled"] = _torch_answer(torch.compile(plain, dynamic=False))
        else:
            print("There is no C++ compiler: PyTorch compiled is left out.")
    if importlib.util.find_spec("onnxruntime") and importlib.util.find_spec("onnxscript"):
        answers["ONNX Runtime"] = _onnx_answer(plain, observations, closed)
    else:
        print('ONNX Runtime is not installed and left out. Install it with pip install -e ".[onnx]"')
    return answers


def _plain(network: _Network) -> _Network:
    plain = copy.deepcopy(network)
    if isinstance(plain.encoder, ImageEncoder):
        first = plain.encoder.layers[0]
        assert isinstance(first, LabelConvolution)
        plain.encoder.layers[0] = PlainLabelConvolution(first)
    return plain


def _torch_answer(network: nn.Module) -> _Answer:
    def answer(observations: np.ndarray, closed: np.ndarray) -> tuple[np.ndarray, ...]:
        with torch.inference_mode():
            outputs = network(torch.from_numpy(observations), torch.from_numpy(closed))
        return tuple(output.numpy() for output in (outputs if isinstance(outputs, tuple) else (outputs,)))

    return answer


def _onnx_answer(network: nn.Module, observations: np.ndarray, closed: np.ndarray) -> _Answer:
    """One model for each number of states: what is fixed can be optimized."""
    onnxruntime: Any = importlib.import_module("onnxruntime")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    sessions = {}
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    names = []
    for batch in _BATCHES:
        file = io.BytesIO()
        arguments = torch.from_numpy(observations[:batch]), torch.from_numpy(closed[:batch])
        with warnings.catch_warnings(), contextlib.redirect_stdout(None), contextlib.redirect_stderr(None):
            warnings.simplefilter("ignore")  # the exporter's, of its own old names
            torch.onnx.export(network, arguments, file, verbose=False)
        sessions[batch] = onnxruntime.InferenceSession(file.getvalue(), options, providers=["CPUExecutionProvider"])
        names = [entry.name for entry in sessions[batch].get_inputs()]

    return lambda *asked: tuple(sessions[len(asked[0])].run(None, dict(zip(names, asked, strict=True))))
