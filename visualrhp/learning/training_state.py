"""Files from which an interrupted training is resumed bit-exactly.

A training state is a mapping from names to parts. Objects with internal state (``nn.Module``, ``Optimizer``,
``torch.Generator``, ``numpy.random.Generator``) are restored in place; tensors, arrays and JSON values (counters, lists
of metrics) are returned. Everything is in one safetensors file with a JSON header (no pickle)::

    save_training_state(path, {"network": network, "optimizer": optimizer, "shuffle": generator, "epoch": 3})
    ...
    epoch = load_training_state(path, {"network": network, "optimizer": optimizer, "shuffle": generator})["epoch"]
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import nn
from torch.optim import Optimizer

from visualrhp.errors import CheckpointError
from visualrhp.heuristics.tensor_file import read_tensor_file, write_tensor_file

_SEPARATOR = "/"


def save_training_state(path: str | os.PathLike[str], parts: Mapping[str, Any]) -> None:
    """Write ``parts`` to one file, atomically; if killed at any moment, the file is either the previous or the new one.

    Args:
        path: file to write (``.safetensors``).
        parts: name -> ``nn.Module``, ``Optimizer``, ``torch.Generator``, ``numpy.random.Generator``, tensor, numpy
            array, or any JSON value. Names must not contain a slash.

    Raises:
        TypeError: a part has another type.
    """
    tensors: dict[str, torch.Tensor] = {}
    document: dict[str, Any] = {}
    for name, part in parts.items():
        if _SEPARATOR in name:
            raise ValueError(f"the name of a part must not contain {_SEPARATOR!r}: {name!r}")
        kind, part_tensors, content = _pack(part)
        tensors.update({f"{name}{_SEPARATOR}{key}": tensor for key, tensor in part_tensors.items()})
        document[name] = {"kind": kind, "content": content}
    write_tensor_file(path, {name: tensor.detach().cpu().numpy() for name, tensor in tensors.items()}, document)


def load_training_state(path: str | os.PathLike[str], parts: Mapping[str, Any]) -> dict[str, Any]:
    """Restore ``parts`` in place from ``path``, and return the tensors, arrays and values in the file.

    Names, kinds, shapes and numbers of parameters are compared first; nothing is changed if the file does not match.

    Args:
        path: a file of :func:`save_training_state`.
        parts: name -> module, optimizer or generator to restore; all those in the file are required.

    Raises:
        CheckpointError: the file is missing or damaged, or does not match ``parts``.
    """
    arrays, document = read_tensor_file(path)
    tensors = {name: torch.from_numpy(array) for name, array in arrays.items()}
    values: dict[str, Any] = {}
    restorable: set[str] = set()
    contents: dict[str, tuple[str, dict[str, torch.Tensor], Any]] = {}
    for name, entry in document.items():
        prefix = name + _SEPARATOR
        part_tensors = {key.removeprefix(prefix): tensor for key, tensor in tensors.items() if key.startswith(prefix)}
        kind = entry["kind"]
        if kind == "tensor":
            values[name] = part_tensors["value"]
        elif kind == "array":
            values[name] = part_tensors["value"].numpy()
        elif kind == "value":
            values[name] = entry["content"]
        else:
            restorable.add(name)
            contents[name] = kind, part_tensors, entry["content"]
    if restorable != set(parts):
        raise CheckpointError(
            f"{path} holds the state of {sorted(restorable)}, but this training consists of {sorted(parts)}; it was "
            "written by another kind of training"
        )
    for name, part in parts.items():
        _check_fits(path, name, part, *contents[name])
    for name, part in parts.items():
        _restore(part, *contents[name])
    return values


def _pack(part: Any) -> tuple[str, dict[str, torch.Tensor], Any]:
    """Split a part into its kind, its tensors and its JSON content."""
    if isinstance(part, nn.Module):
        return "module", dict(part.state_dict()), None
    if isinstance(part, Optimizer):
        return "optimizer", *_pack_optimizer(part)
    if isinstance(part, torch.Generator):
        return "torch_generator", {"state": part.get_state()}, None
    if isinstance(part, np.random.Generator):
        return "numpy_generator", {}, _plain(part.bit_generator.state)
    if isinstance(part, torch.Tensor):
        return "tensor", {"value": part}, None
    if isinstance(part, np.ndarray):
        return "array", {"value": torch.from_numpy(np.ascontiguousarray(part))}, None
    return "value", {}, _plain(part)


def _pack_optimizer(optimizer: Optimizer) -> tuple[dict[str, torch.Tensor], Any]:
    """Flatten an optimizer: tensors as ``<parameter index>.<name>``, everything else as JSON."""
    state = optimizer.state_dict()
    tensors: dict[str, torch.Tensor] = {}
    scalars: dict[str, dict[str, Any]] = {}
    for index, entries in state["state"].items():
        for key, value in entries.items():
            if isinstance(value, torch.Tensor):
                tensors[f"{index}.{key}"] = value
            else:
                scalars.setdefault(str(index), {})[key] = _plain(value)
    return tensors, {"scalars": scalars, "groups": _plain(state["param_groups"])}


def _check_fits(
    path: str | os.PathLike[str], name: str, part: Any, kind: str, tensors: dict[str, torch.Tensor], content: Any
) -> None:
    own_kind, own_tensors, own_content = _pack(part)
    if own_kind != kind:
        raise CheckpointError(f"{path}: {name!r} is the state of a {kind}, but should be that of a {own_kind}")
    if kind == "module":
        expected = {key: list(tensor.shape) for key, tensor in own_tensors.items()}
        found = {key: list(tensor.shape) for key, tensor in tensors.items()}
        if expected != found:
            different = sorted(key for key in expected.keys() | found if expected.get(key) != found.get(key))
            raise CheckpointError(
                f"{path}: {name!r} has another architecture; these parameters differ in presence or shape: "
                + ", ".join(f"{key} (file {found.get(key)}, here {expected.get(key)})" for key in different[:4])
            )
    elif kind == "optimizer":
        expected = [len(group["params"]) for group in own_content["groups"]]
        found = [len(group["params"]) for group in content["groups"]]
        if expected != found:
            raise CheckpointError(
                f"{path}: {name!r} optimizes groups of {found} parameters, but here there are groups of {expected}"
            )
    elif kind == "numpy_generator" and own_content["bit_generator"] != content["bit_generator"]:
        raise CheckpointError(
            f"{path}: {name!r} is a {content['bit_generator']}, but here it is a {own_content['bit_generator']}"
        )


def _restore(part: Any, kind: str, tensors: dict[str, torch.Tensor], content: Any) -> None:
    if kind == "module":
        part.load_state_dict(tensors)
    elif kind == "optimizer":
        _restore_optimizer(part, tensors, content)
    elif kind == "torch_generator":
        part.set_state(tensors["state"])
    elif kind == "numpy_generator":
        part.bit_generator.state = content


def _restore_optimizer(optimizer: Optimizer, tensors: dict[str, torch.Tensor], content: Any) -> None:
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    state: dict[int, dict[str, Any]] = {int(index): dict(entries) for index, entries in content["scalars"].items()}
    for key, tensor in tensors.items():
        index, name = key.split(".", 1)
        parameter = parameters[int(index)]
        if tensor.shape == parameter.shape:  # with the strides of the parameter, which fused optimizers require
            tensor = torch.empty_like(parameter, dtype=tensor.dtype, requires_grad=False).copy_(tensor)
        state.setdefault(int(index), {})[name] = tensor
    groups = [
        {key: tuple(value) if isinstance(value, list) and key != "params" else value for key, value in group.items()}
        for group in content["groups"]
    ]
    optimizer.load_state_dict({"state": state, "param_groups": groups})


def _plain(value: Any) -> Any:
    """Convert ``value`` to types that JSON preserves (tuples become lists, numpy scalars numbers)."""
    if isinstance(value, dict):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, torch.Tensor) and value.ndim == 0:  # a tensor learning rate
        return value.item()
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"a training state cannot hold a {type(value).__name__}")
