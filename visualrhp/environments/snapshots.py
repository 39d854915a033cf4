"""Snapshots of a batched environment: tensors from which it, or another one with the same arguments, resumes.

They hold what the tasks are a function of, too, so that no pose is put into a scene of another seed or distribution.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from visualrhp.environments.arguments import shown
from visualrhp.environments.slots import SlotArrays, TaskFamily
from visualrhp.errors import CheckpointError, ConfigError
from visualrhp.scene.gripper import Gripper
from visualrhp.types import Column, FloatArray

_RUNNING, _GOAL, _DROPPED, _TRUNCATED = range(4)
_KEYS = ("state", "instance", "num_actions", "next_index", "ended", "arguments")


@dataclass(frozen=True)
class Snapshot:
    """The content of a snapshot of N tasks.

    Attributes:
        states: [N, 5 + 3 max m], zero beyond a scene's own objects.
        instances: N indices of task instances.
        seeds: their N seeds; an older one than that of the environment where ``set_seed`` was not followed by a reset.
        num_actions: actions taken in the N episodes.
        next_indices: N indices of the instances that start next.
        ended: [N] uint8, how the episodes ended: not yet, at the goal, with a drop, or truncated.
    """

    states: FloatArray
    instances: list[int]
    seeds: list[int]
    num_actions: list[int]
    next_indices: list[int]
    ended: np.ndarray

    def mark_ended(self, arrays: SlotArrays) -> None:
        """Write the flags of the last step."""
        arrays.is_goal[:] = self.ended == _GOAL
        arrays.is_dropped[:] = self.ended == _DROPPED
        arrays.terminated[:] = arrays.is_goal | arrays.is_dropped
        arrays.truncated[:] = self.ended == _TRUNCATED


def take_snapshot(
    family: TaskFamily, seed: int, seeds: Sequence[int], next_indices: Sequence[int], arrays: SlotArrays
) -> dict[str, torch.Tensor]:
    """The tensors of a snapshot, for :func:`read_snapshot`.

    Args:
        family: shared parameters of the tasks.
        seed: of the task instances that start next.
        seeds: of the N running task instances.
        next_indices: N indices of the instances that start next.
        arrays: the states of the tasks.
    """
    ended = np.where(arrays.truncated, _TRUNCATED, _RUNNING)
    ended = np.where(arrays.is_dropped, _DROPPED, np.where(arrays.is_goal, _GOAL, ended)).astype(np.uint8)
    text = json.dumps({**_arguments(family, len(ended), seed), "seeds": [hex(each) for each in seeds]})
    return {
        "state": torch.from_numpy(arrays.state.copy()),
        "instance": torch.from_numpy(arrays.instance.copy()),
        "num_actions": torch.from_numpy(arrays.num_actions.copy()),
        "next_index": torch.tensor(list(next_indices), dtype=torch.int64),
        "ended": torch.from_numpy(ended),
        "arguments": torch.from_numpy(np.frombuffer(text.encode(), np.uint8).copy()),
    }


def _arguments(family: TaskFamily, num_slots: int, seed: int) -> dict[str, Any]:
    """What the tasks of an environment are a function of, as JSON has it."""
    values = {
        "num_envs": num_slots,
        "seed": hex(seed),  # of any length
        "split": int(family.split),
        "action_space": family.action_space,
        "observation": str(family.observe),
        "distribution": dataclasses.asdict(family.distribution),
        "physics": dataclasses.asdict(family.physics),
    }
    return json.loads(json.dumps(values))


def read_snapshot(family: TaskFamily, num_slots: int, seed: int, snapshot: Any) -> Snapshot:
    """Check a snapshot before anything is resumed from it.

    Args:
        family: shared parameters of the tasks of the environment that resumes.
        num_slots: its N.
        seed: its seed.
        snapshot: as given; further entries are ignored.

    Raises:
        CheckpointError: an entry is missing or damaged, or the snapshot is of an environment with other arguments.
    """
    if not isinstance(snapshot, Mapping):
        raise CheckpointError(f"a snapshot of an environment is a dictionary of tensors, not {shown(snapshot)}")
    missing = [key for key in _KEYS if not isinstance(snapshot.get(key), torch.Tensor)]
    if "state" not in missing:
        _check_shape(snapshot["state"], (num_slots, family.state_dimension))
    if missing:
        raise CheckpointError(
            f"the snapshot of the environment has no tensor {' and no tensor '.join(missing)}: it is damaged, or was "
            "written by an earlier version; start anew"
        )
    seeds = _check_arguments(snapshot["arguments"], _arguments(family, num_slots, seed))
    states = _array(snapshot, "state", "f", (num_slots, family.state_dimension)).astype(np.float64)
    rows = {
        key: _array(snapshot, key, "iu", (num_slots,)) for key in ("instance", "num_actions", "next_index", "ended")
    }
    if any((row < 0).any() for row in rows.values()) or rows["ended"].max() > _TRUNCATED:
        raise CheckpointError("the snapshot of the environment is damaged: an index or a number of actions is negative")
    _check_states(states)
    if len(seeds) != num_slots:
        raise CheckpointError(f"the snapshot of the environment is damaged: it has {len(seeds)} seeds, not {num_slots}")
    instances, num_actions, next_indices, _ = (row.tolist() for row in rows.values())
    return Snapshot(states, instances, seeds, num_actions, next_indices, rows["ended"])


def _check_shape(states: torch.Tensor, expected: tuple[int, ...]) -> None:
    if tuple(states.shape) != expected:
        raise CheckpointError(
            f"the checkpoint holds environment states of shape {list(states.shape)}, and this environment needs "
            f"{list(expected)}: it was written with another number of environments or objects"
        )


def _array(snapshot: Mapping[str, torch.Tensor], key: str, kinds: str, shape: tuple[int, ...]) -> np.ndarray:
    array = snapshot[key].detach().cpu().numpy()
    if array.dtype.kind not in kinds or array.shape != shape:
        raise CheckpointError(
            f"the snapshot of the environment is damaged: {key} is of {list(array.shape)} {array.dtype}, not of the "
            f"shape {list(shape)}"
        )
    return array


def _check_arguments(content: torch.Tensor, expected: dict[str, Any]) -> list[int]:
    """Compare the arguments that the snapshot was taken with to ``expected``; return the seeds of its tasks."""
    try:
        found = json.loads(bytes(content.cpu().numpy().astype(np.uint8)))
        seeds = [int(each, 16) for each in found.pop("seeds")]
    except Exception as error:  # whatever was written there
        raise CheckpointError("the snapshot of the environment is damaged: its arguments cannot be read") from error
    for name, value in expected.items():
        here, there = value, found.get(name)
        if here == there:
            continue
        if isinstance(here, dict) and isinstance(there, dict):  # show the parameter that differs
            part = next(part for part in {**here, **there} if here.get(part) != there.get(part))
            name, here, there = f"{name}.{part}", here.get(part), there.get(part)
        elif name == "seed":
            here, there = (_decimal(each) for each in (here, there))
        raise CheckpointError(
            f"the snapshot was taken in an environment with {name}={shown(there)}, and this one has {shown(here)}: its "
            "tasks are others. Restore it in an environment made with the same arguments (and set_seed called as there)"
        )
    return seeds


def _decimal(seed: Any) -> Any:
    return int(seed, 16) if isinstance(seed, str) and len(seed) < 1000 else seed


def _check_states(states: FloatArray) -> None:
    """Check what every state fulfils, so that no worker refuses it after others have resumed."""
    closed, openings = states[:, Column.CLOSED], states[:, Column.OPENING]
    gripper = Gripper()
    if (
        not np.isfinite(states).all()
        or not np.isin(closed, (0.0, 1.0)).all()
        or any(gripper.opening_fault(opening) is not None for opening in openings.tolist())
    ):
        raise CheckpointError(
            "the snapshot of the environment is damaged: a state has a number that is not finite, or an impossible "
            "opening of the gripper"
        )


def checked_states(instances: Any, states: Any, dimension: int) -> tuple[list[int], FloatArray]:
    """K indices of task instances and [K, dimension] states, from tensors.

    Raises:
        ConfigError: the tensors have other shapes or types, an index is negative, or a state is not finite.
    """
    try:
        indices, rows = (tensor.detach().cpu().numpy() for tensor in (instances, states))
        is_valid = indices.dtype.kind == "i" and indices.ndim == 1 and (indices >= 0).all()
        is_valid = is_valid and rows.dtype == np.float64 and rows.shape == (len(indices), dimension)
        if is_valid and np.isfinite(rows).all():
            return indices.tolist(), rows
    except Exception:  # no tensors: raised below
        pass
    raise ConfigError(
        f"earlier states are indices of task instances, [K] int64 and 0 or more, and states, [K, {dimension}] float64 "
        f"and finite, not {shown(instances)} and {shown(states)}"
    )
