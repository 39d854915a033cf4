"""Files of trained heuristics: the weights of the network in safetensors, with a JSON card.

The card is stored in the file, from which it is read, and in a separate JSON file for people and other programs
(``heuristic.json``). This module does not import torch; :mod:`visualrhp.heuristics.conversion` writes and reads
networks in PyTorch.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from visualrhp.documents import FileKind, brief, document, shown_path
from visualrhp.errors import CheckpointError, ConfigError, LearningError
from visualrhp.files import write_json
from visualrhp.heuristics.architecture import weight_shapes
from visualrhp.heuristics.learned import DEFAULT_TEMPERATURE, LearnedHeuristic
from visualrhp.heuristics.tensor_file import read_tensor_file, write_tensor_file
from visualrhp.observation import Observation, make_observation
from visualrhp.parameters import Count
from visualrhp.types import ActionSpaceName

NETWORK: Final = FileKind(
    "a trained network (a safetensors file)",
    "train the network again, or use the released ones (heuristics=pretrained)",
    CheckpointError,
)

_FORMAT = "visualrhp-heuristic-2"
_MOST_NAMED = 3


@document
class _Document:
    """What is read of the document in a file, and of its card."""

    format: str
    action_space: ActionSpaceName
    observation: str
    num_objects: Count | None
    card: dict[str, Any]


@dataclass(frozen=True)
class StoredNetwork:
    """The content of a file.

    Attributes:
        weights: by their names in PyTorch's state dict.
        action_space: of the network.
        observation: that the network reads.
        card: origin of the network (config, seed, commit, data hash, metrics); JSON values only.
    """

    weights: Mapping[str, npt.NDArray[Any]]
    action_space: ActionSpaceName
    observation: Observation
    card: Mapping[str, Any]


def write_network(path: str | os.PathLike[str], network: StoredNetwork) -> None:
    """Write ``network`` to ``path`` (``*.safetensors``) and its card to ``*.json``, each atomically.

    Raises:
        LearningError: a weight is not finite.
    """
    require_finite(network.weights)
    path = Path(path)
    document = {
        "format": _FORMAT,
        "action_space": network.action_space,
        "observation": network.observation.name,
        "num_objects": network.observation.num_objects,
        "card": dict(network.card),
    }
    write_tensor_file(path, network.weights, document)
    write_json(path.with_suffix(".json"), document)


def read_network(
    path: str | os.PathLike[str],
    expect_action_space: ActionSpaceName | None = None,
    expect_observation: Observation | None = None,
) -> StoredNetwork:
    """Read a file of :func:`write_network`.

    Args:
        path: of the file.
        expect_action_space: that the network must have; None for any.
        expect_observation: that the network must read, with its number of objects; None for any.

    Raises:
        CheckpointError: the file is missing or damaged, or is not a trained heuristic; the network has another action
            space or observation than expected, or another architecture than in this version; a weight is not a finite
            floating-point number.
    """
    weights, document = read_tensor_file(path, NETWORK)
    if document.get("format") != _FORMAT:
        raise NETWORK.unusable(
            path,
            f"is not a trained heuristic of this version (its format is {brief(document.get('format'))!r}, not "
            f"{_FORMAT!r})",
        )
    content: _Document = NETWORK.check(path, _Document, document)
    action_space = content.action_space
    if expect_action_space is not None and action_space != expect_action_space:
        raise CheckpointError(
            f"{shown_path(path)} was trained in the {action_space} action space, but the {expect_action_space} one is "
            f"needed; set action_space={action_space}, or use a heuristic for the {expect_action_space} action space"
        )
    try:
        observation = make_observation(content.observation, content.num_objects)
    except ConfigError as error:
        raise other_architecture(path, error) from error
    if expect_observation is not None and observation != expect_observation:
        other = f", or choose a planner whose heuristic has observation={observation.name}"
        raise CheckpointError(
            f"{shown_path(path)} is a network for {observation}, but one for {expect_observation} is needed here; use "
            "a folder that has one, such as heuristics=pretrained"
            f"{other if observation.name != expect_observation.name else ''}"
        )
    _check_weights(path, weights, weight_shapes(action_space, observation))
    return StoredNetwork(weights, action_space, observation, content.card)


def load_heuristic(
    path: str | os.PathLike[str],
    expect_action_space: ActionSpaceName | None = None,
    temperature: float = DEFAULT_TEMPERATURE,
    expect_observation: Observation | None = None,
) -> LearnedHeuristic:
    """Load the heuristic in a file; arguments as of :func:`read_network`, and tau of Eq. 2.

    Raises:
        CheckpointError: as :func:`read_network`, or the outputs of the network are not finite.
        ConfigError: the temperature is not positive.
    """
    stored = read_network(path, expect_action_space, expect_observation)
    heuristic = LearnedHeuristic(stored.weights, stored.action_space, stored.observation, temperature)
    check_outputs(path, heuristic)
    return heuristic


def check_outputs(path: str | os.PathLike[str], heuristic: LearnedHeuristic) -> None:
    """Check that the outputs of the network in a file are finite.

    Raises:
        CheckpointError: they are not.
    """
    try:
        heuristic.network.check(heuristic.observation)
    except ValueError as error:
        raise NETWORK.unusable(path, f"holds no network that can be used: {error}") from error


def require_finite(weights: Mapping[str, npt.NDArray[Any]]) -> None:
    """Check the weights of a network before it is used or written.

    Raises:
        LearningError: a weight is not finite.
    """
    if names := _not_finite(weights):
        raise LearningError(
            f"the training diverged: the weights {_listed(names)} of the network are not finite; use a smaller "
            "learning rate (learner.lr)"
        )


def other_architecture(path: str | os.PathLike[str], error: object) -> CheckpointError:
    """The error for a file whose network has another architecture than in this version."""
    reason = f"has another architecture than the networks of this version: {brief(error)}"
    return CheckpointError(str(NETWORK.unusable(path, reason)))


def _check_weights(
    path: str | os.PathLike[str], weights: Mapping[str, npt.NDArray[Any]], shapes: Mapping[str, tuple[int, ...]]
) -> None:
    """Compare names, shapes and types of weights with those of the architecture."""
    found = {name: values.shape for name, values in weights.items()}
    if found != shapes:
        different = sorted(name for name in found.keys() | shapes if found.get(name) != shapes.get(name))
        words = [
            f"{brief(name)[:80]} ({_shape(found.get(name))}, not {_shape(shapes.get(name))})" for name in different
        ]
        raise other_architecture(path, f"these weights differ: {_listed(words)}")
    if others := [name for name, values in weights.items() if not np.issubdtype(values.dtype, np.floating)]:
        raise NETWORK.unusable(
            path,
            f"holds no network: its weights {_listed(others)} are {weights[others[0]].dtype}, but weights are "
            "floating-point numbers (float32)",
        )
    if names := _not_finite(weights):
        raise NETWORK.unusable(
            path, f"holds no network: its weights {_listed(names)} are not finite (in single precision)"
        )


def _not_finite(weights: Mapping[str, npt.NDArray[Any]]) -> list[str]:
    """Names of the weights with values that are not finite in single precision."""
    with np.errstate(over="ignore"):
        return [
            name for name, values in weights.items() if not np.isfinite(values.astype(np.float32, copy=False)).all()
        ]


def _shape(shape: tuple[int, ...] | None) -> str:
    return "absent" if shape is None else str(list(shape))[:80]


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return f"{', '.join(names[:_MOST_NAMED])}{more}"
