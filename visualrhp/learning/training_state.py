"""Files from which an interrupted training is resumed bit-exactly.

A training state is a mapping from names to parts. Objects with internal state (``nn.Module``, ``Optimizer``,
``torch.Generator``, ``numpy.random.Generator``) are restored in place; tensors, arrays and JSON values (counters, lists
of metrics) are returned. Everything is in one safetensors file with a JSON header (no pickle)::

    save_training_state(path, {"network": network, "optimizer": optimizer, "shuffle": generator, "epoch": 3})
    ...
    epoch = load_training_state(path, {"network": network, "optimizer": optimizer, "shuffle": generator})["epoch"]
"""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping
from typing import Any, Final, Literal

import numpy as np
import torch
from torch import nn
from torch.optim import Optimizer

from visualrhp.documents import FileKind, brief, conform, document
from visualrhp.errors import CheckpointError
from visualrhp.heuristics.tensor_file import read_tensor_file, write_tensor_file

STATE: Final = FileKind(
    "the state of an unfinished training (a safetensors file)",
    "delete this file and rerun the command: the training starts again from its beginning",
    CheckpointError,
)

MISFITS: Final = (CheckpointError, KeyError, TypeError, ValueError, IndexError, RuntimeError, OverflowError)
"""Errors of objects that are restored from content that is not theirs."""

_SEPARATOR = "/"
_LARGE = 1e20
"""No learning rate has this size, at which single precision overflows."""


@document
class _Part:
    """A part of a state in the document of a file; its tensors are separate."""

    kind: Literal["module", "optimizer", "torch_generator", "numpy_generator", "tensor", "array", "value"]
    content: Any


@document
class _Group:
    """A group of parameters of an optimizer."""

    params: tuple[int, ...]


@document
class _OptimizerContent:
    """What is not a tensor in the state of an optimizer."""

    scalars: dict[str, dict[str, Any]]
    groups: tuple[_Group, ...]


class _DoesNotFit(Exception):
    """The content of a file does not fit a part; the message says why."""


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


def load_training_state(
    path: str | os.PathLike[str], parts: Mapping[str, Any], values: Any = dict[str, Any]
) -> dict[str, Any]:
    """Restore ``parts`` in place from ``path``, and return the tensors, arrays and values in the file.

    Everything is compared first; nothing is changed if the file does not match.

    Args:
        path: a file of :func:`save_training_state`.
        parts: name -> module, optimizer or generator to restore; all those in the file are required.
        values: schema of the values (:mod:`visualrhp.documents`).

    Raises:
        CheckpointError: the file is missing or damaged, or does not match ``parts`` or ``values``; the message says
            which file to delete.
    """
    arrays, document = read_tensor_file(path, STATE)
    stored: dict[str, _Part] = STATE.check(path, dict[str, _Part], document)
    try:
        tensors = {name: torch.from_numpy(array) for name, array in arrays.items()}
        of_parts = {name: _with_prefix(tensors, name) for name in stored}
        restorable = {name for name, part in stored.items() if part.kind not in ("tensor", "array", "value")}
        if restorable != set(parts):
            raise _DoesNotFit(
                f"holds the state of {sorted(restorable)}, but this training consists of {sorted(parts)}; it was "
                "written by another kind of training"
            )
        for name, part in parts.items():
            _check_fits(name, part, stored[name].kind, of_parts[name], stored[name].content)
        others = {name: _value_of(part, of_parts[name]) for name, part in stored.items() if name not in parts}
    except _DoesNotFit as error:
        raise STATE.unusable(path, str(error)) from error
    except MISFITS as error:
        raise STATE.damaged(path, f"its content does not fit this training ({_words(error)})") from error
    STATE.check(path, values, {name: part.content for name, part in stored.items() if part.kind == "value"})
    for name, part in parts.items():
        _restore(part, stored[name].kind, of_parts[name], stored[name].content)
    return others


def misfit(path: str | os.PathLike[str], error: Exception) -> CheckpointError:
    """The error for a state whose values do not fit the training that loads it."""
    return CheckpointError(str(STATE.unusable(path, f"does not fit this training: {_words(error)}")))


def _words(error: Exception) -> str:
    return brief(error) if isinstance(error, CheckpointError) else brief(f"{type(error).__name__}: {error}")


def _with_prefix(tensors: Mapping[str, torch.Tensor], name: str) -> dict[str, torch.Tensor]:
    prefix = name + _SEPARATOR
    return {key.removeprefix(prefix): tensor for key, tensor in tensors.items() if key.startswith(prefix)}


def _value_of(part: _Part, tensors: Mapping[str, torch.Tensor]) -> Any:
    if part.kind == "value":
        return part.content
    return tensors["value"] if part.kind == "tensor" else tensors["value"].numpy()


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


def _check_fits(name: str, part: Any, kind: str, tensors: dict[str, torch.Tensor], content: Any) -> None:
    """Check that the stored part can be restored into ``part``, which is not changed.

    Raises:
        _DoesNotFit: it cannot. Other exceptions: the content is not that of such a part.
    """
    own_kind, own_tensors, own_content = _pack(part)
    if own_kind != kind:
        raise _DoesNotFit(f"has the state of a {kind} as {name!r}, but should have that of a {own_kind}")
    if kind == "module":
        _check_module(name, own_tensors, tensors)
    elif kind == "optimizer":
        _check_optimizer(name, part, own_content, tensors, content)
    elif kind == "torch_generator":
        torch.Generator(part.device).set_state(tensors["state"])
    elif kind == "numpy_generator":
        if own_content["bit_generator"] != content["bit_generator"]:
            raise _DoesNotFit(
                f"has a {content['bit_generator']} as {name!r}, but here it is a {own_content['bit_generator']}"
            )
        copy.deepcopy(part).bit_generator.state = content


def _check_module(name: str, own: Mapping[str, torch.Tensor], tensors: Mapping[str, torch.Tensor]) -> None:
    expected, found = ({key: list(tensor.shape) for key, tensor in some.items()} for some in (own, tensors))
    if expected != found:
        different = sorted(key for key in expected.keys() | found if expected.get(key) != found.get(key))
        raise _DoesNotFit(
            f"has another architecture as {name!r}; these parameters differ in presence or shape: "
            + ", ".join(f"{key} (file {found.get(key)}, here {expected.get(key)})" for key in different[:4])
        )
    for key, tensor in tensors.items():
        if tensor.dtype != own[key].dtype:
            raise _DoesNotFit(f"has {name}.{key} as {tensor.dtype}, but it should be {own[key].dtype}")
        if tensor.is_floating_point() and not torch.isfinite(tensor).all():
            raise _DoesNotFit(f"has values in {name}.{key} that are not finite")


def _check_optimizer(name: str, part: Optimizer, own: Any, tensors: Mapping[str, torch.Tensor], content: Any) -> None:
    checked: _OptimizerContent = conform(_OptimizerContent, content)
    expected, found = ([len(group["params"]) for group in groups] for groups in (own["groups"], content["groups"]))
    if expected != found:
        raise _DoesNotFit(f"has, as {name!r}, groups of {found} parameters, but here there are groups of {expected}")
    for mine, group in zip(own["groups"], content["groups"], strict=True):
        unlike = sorted(key for key in mine.keys() | group if key != "lr" and mine.get(key, ...) != group.get(key, ...))
        if unlike or not _is_learning_rate(group.get("lr")):  # which a schedule may have changed
            raise _DoesNotFit(f"has other settings of {name!r} than this training: {', '.join(unlike) or 'lr'}")
    parameters = [parameter for group in part.param_groups for parameter in group["params"]]
    moments: dict[str, set[str]] = {index: set(entries) for index, entries in checked.scalars.items()}
    for key in tensors:
        moments.setdefault(key.partition(".")[0], set()).add(key.partition(".")[2])
    for index, names in moments.items():
        if not index.isdecimal() or int(index) >= len(parameters) or names != next(iter(moments.values())):
            raise _DoesNotFit(f"has as {name!r} moments of {len(parameters)} parameters that do not fit together")
    for key, tensor in tensors.items():
        shape = parameters[int(key.partition(".")[0])].shape
        if tensor.shape not in (shape, torch.Size([])) or not tensor.is_floating_point():
            raise _DoesNotFit(f"has {name}.{key} as {tensor.dtype} {list(tensor.shape)}, of a parameter {list(shape)}")
        if not torch.isfinite(tensor).all():
            raise _DoesNotFit(f"has values in {name}.{key} that are not finite")


def _is_learning_rate(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0.0 <= value < _LARGE


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
