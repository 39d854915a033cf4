"""Shards: attempts of the planner as plain arrays in npz files.

Each shard holds scenes, states, actions and rewards as plain arrays (npz without objects; float64 is exact), with
ragged parts concatenated:

=================  ==========  ==================  ==========================================================
array              dtype       shape               content
=================  ==========  ==================  ==========================================================
``index``          int64       [D]                 index of the task instance (consecutive)
``solved``         bool        [D]                 a demonstration, or a recorded failure of the planner
``length``         int64       [D]                 actions L; 0 for a failure
``num_objects``    int64       [D]                 objects m
``states``         float64     [sum (L+1)(5+3m)]   state vectors (see :class:`visualrhp.types.State`), s_0 first
``actions``        int64       [sum L]             discrete; float64 [sum L, 4] in the continuous space
``rewards``        float64     [sum L]             r_1 ... r_L
``target``         float64     [D, 3]              target region: x, y, radius [m]
``gripper``        float64     [D, 7]              fields of :class:`visualrhp.scene.Gripper`
``num_edges``      int64       [D]                 vertices E of the surface
``edges``          float64     [sum E, 2]          vertices of the surface [m]
``num_vertices``   int64       [sum m]             vertices V of each object
``outlines``       float64     [sum V, 2]          outlines in the body frames [m]
``materials``      float64     [sum m, 2]          density [kg/m^2] and friction of each object
``num_simulated``  int64       [D]                 actions simulated by the search
``num_nodes``      int64       [D]                 nodes of the search tree
=================  ==========  ==================  ==========================================================
"""

from __future__ import annotations

import dataclasses
import math
import struct
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from visualrhp.documents import FileKind, brief
from visualrhp.errors import DataError
from visualrhp.files import atomic_path
from visualrhp.scene.gripper import Gripper
from visualrhp.scene.scene import ObjectShape, Scene, TargetRegion, TaskInstance
from visualrhp.simulation.action_spaces import ContinuousActionSpace
from visualrhp.types import Action, ActionSpaceName, Episode, FloatArray, IntArray, Outcome, State, state_dimension

if TYPE_CHECKING:
    from visualrhp.demonstrations.generate import Attempt

Arrays = dict[str, npt.NDArray[Any]]

_ZIP_HEADER = struct.Struct("<4s5H3I2H")
"""Local header of a member of a zip file, up to the lengths of its name and its extra field."""

_GRIPPER_FIELDS = len(dataclasses.fields(Gripper))

_COLUMNS: Final = {
    "index": (np.int64,),
    "solved": (np.bool_,),
    "length": (np.int64,),
    "num_objects": (np.int64,),
    "states": (np.float64,),
    "actions": (np.float64, ContinuousActionSpace.DIMENSION),
    "rewards": (np.float64,),
    "target": (np.float64, 3),
    "gripper": (np.float64, _GRIPPER_FIELDS),
    "num_edges": (np.int64,),
    "edges": (np.float64, 2),
    "num_vertices": (np.int64,),
    "outlines": (np.float64, 2),
    "materials": (np.float64, 2),
    "num_simulated": (np.int64,),
    "num_nodes": (np.int64,),
}
"""Type of every array, and its shape after the first axis."""

_MOST_ROWS: Final = 1 << 32

SHARD: Final = FileKind(
    "a shard of demonstrations (an npz file)",
    "rerun the command that made the set (python -m pipelines.generate_demos), which repairs it",
    missing="is missing",
)


def pack(attempts: Sequence[Attempt], action_space: ActionSpaceName) -> Arrays:
    """Return the arrays of a shard (see the module) holding ``attempts``."""
    episodes = [attempt.episode for attempt in attempts]
    scenes = [attempt.task.scene for attempt in attempts]
    shapes = [shape for scene in scenes for shape in scene.objects]
    states = [
        state.vector
        for attempt in attempts
        for state in (attempt.episode.states if attempt.episode else (attempt.task.state,))
    ]
    actions = [action for episode in episodes if episode for action in episode.actions]
    if any(shape.turning_resistance != 1.0 for shape in shapes):
        raise DataError(
            "demonstrations store density and friction of an object, not turning_resistance, which should be 1.0"
        )
    rewards = [reward for episode in episodes if episode for reward in episode.rewards]
    return {
        "index": integers(attempt.index for attempt in attempts),
        "solved": np.array([episode is not None for episode in episodes], dtype=np.bool_),
        "length": integers(len(episode) if episode else 0 for episode in episodes),
        "num_objects": integers(scene.num_objects for scene in scenes),
        "states": np.concatenate([np.empty(0), *states]),
        "actions": _pack_actions(actions, action_space),
        "rewards": np.array(rewards, dtype=np.float64),
        "target": np.array([[*scene.target.position, scene.target.radius] for scene in scenes]).reshape(-1, 3),
        "gripper": np.array([dataclasses.astuple(scene.gripper) for scene in scenes]).reshape(-1, _GRIPPER_FIELDS),
        "num_edges": integers(len(scene.edges) for scene in scenes),
        "edges": np.concatenate([np.empty((0, 2)), *(scene.edges for scene in scenes)]),
        "num_vertices": integers(len(shape.outline) for shape in shapes),
        "outlines": np.concatenate([np.empty((0, 2)), *(shape.outline for shape in shapes)]),
        "materials": np.array([[shape.density, shape.friction] for shape in shapes]).reshape(-1, 2),
        "num_simulated": integers(attempt.num_simulated for attempt in attempts),
        "num_nodes": integers(attempt.num_nodes for attempt in attempts),
    }


class Shard:
    """The attempts in the arrays of one shard (see the module), unpacked one at a time."""

    def __init__(self, arrays: Mapping[str, npt.NDArray[Any]]) -> None:
        self.arrays = arrays
        length, num_objects = arrays["length"], arrays["num_objects"]
        self._states = offsets((length + 1) * state_dimension(num_objects))
        self._steps = offsets(length)
        self._edges = offsets(arrays["num_edges"])
        self._objects = offsets(num_objects)
        self._vertices = offsets(arrays["num_vertices"])

    def __len__(self) -> int:
        return len(self.arrays["index"])

    @cached_property
    def demonstrations(self) -> IntArray:
        """Positions of the solved attempts."""
        return np.flatnonzero(self.arrays["solved"])

    @property
    def num_transitions(self) -> int:
        """Number of stored actions."""
        return int(self._steps[-1])

    def task(self, position: int) -> TaskInstance:
        """The task instance of an attempt."""
        return TaskInstance(self.scene(position), self.states(position)[0])

    def scene(self, position: int) -> Scene:
        """The scene of an attempt."""
        arrays = self.arrays
        objects = []
        for number in range(self._objects[position], self._objects[position + 1]):
            outline = arrays["outlines"][self._vertices[number] : self._vertices[number + 1]]
            density, friction = arrays["materials"][number].tolist()
            objects.append(ObjectShape(outline, density, friction))
        x, y, radius = arrays["target"][position].tolist()
        return Scene(
            target=TargetRegion(np.array([x, y]), radius),
            objects=tuple(objects),
            edges=arrays["edges"][self._edges[position] : self._edges[position + 1]],
            gripper=Gripper(*arrays["gripper"][position].tolist()),
        )

    def states(self, position: int) -> tuple[State, ...]:
        """L + 1 states of an attempt."""
        length = int(self.arrays["length"][position])
        vectors = self.arrays["states"][self._states[position] : self._states[position + 1]].reshape(length + 1, -1)
        return tuple(State(vector) for vector in vectors)

    def episode(self, position: int) -> Episode | None:
        """The demonstration of an attempt, or None for a failure."""
        if not self.arrays["solved"][position]:
            return None
        steps = slice(self._steps[position], self._steps[position + 1])
        return Episode(
            states=self.states(position),
            actions=_unpack_actions(self.arrays["actions"][steps]),
            rewards=tuple(self.arrays["rewards"][steps].tolist()),
            outcome=Outcome.SUCCESS,
        )

    def rewards(self, position: int) -> FloatArray:
        """[L] rewards of an attempt."""
        return self.arrays["rewards"][self._steps[position] : self._steps[position + 1]]


def concatenate(parts: Sequence[Mapping[str, npt.NDArray[Any]]]) -> Arrays:
    """Join the arrays of consecutive shards."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def head(arrays: Mapping[str, npt.NDArray[Any]], count: int) -> Arrays:
    """Return the arrays of the first ``count`` attempts of a shard."""
    length, num_objects, num_edges = (arrays[name][:count] for name in ("length", "num_objects", "num_edges"))
    objects = int(num_objects.sum())
    sizes = {
        "states": int(((length + 1) * state_dimension(num_objects)).sum()),
        "actions": int(length.sum()),
        "rewards": int(length.sum()),
        "edges": int(num_edges.sum()),
        "num_vertices": objects,
        "materials": objects,
        "outlines": int(arrays["num_vertices"][:objects].sum()),
    }
    return {name: array[: sizes.get(name, count)] for name, array in arrays.items()}


def tail(arrays: Mapping[str, npt.NDArray[Any]], count: int) -> Arrays:
    """Return the arrays without the first ``count`` attempts."""
    skipped = head(arrays, count)
    return {name: array[len(skipped[name]) :] for name, array in arrays.items()}


def between(arrays: Mapping[str, npt.NDArray[Any]], start: int, stop: int) -> Arrays:
    """Return the arrays of the attempts at the positions ``start`` up to ``stop`` of a shard."""
    return tail(head(arrays, stop), start)


def write_arrays(path: Path, arrays: Mapping[str, npt.NDArray[Any]]) -> None:
    """Write arrays to an npz file, atomically; equal arrays give equal bytes."""
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def read_arrays(path: Path, kind: FileKind = SHARD) -> Arrays:
    """Read all arrays of an npz file, verifying its checksums.

    Args:
        path: of the file.
        kind: of the file, for the messages.

    Raises:
        DataError: the file is missing or damaged.
    """
    kind.require(path)
    arrays: Arrays = {}
    try:
        with path.open("rb") as file, zipfile.ZipFile(file) as archive:
            for member in archive.infolist():
                with archive.open(member) as content:
                    arrays[_array_name(member, arrays)] = np.lib.format.read_array(content, allow_pickle=False)
                    if content.read(1):  # at the end, the checksum is compared
                        raise ValueError(f"{member.filename} has more than an array")
    except Exception as error:  # zipfile and NumPy raise almost anything for bytes that they did not write
        raise kind.damaged(path, f"it cannot be read as npz ({brief(error)})") from error
    return arrays


def map_arrays(path: Path, kind: FileKind = SHARD) -> Arrays:
    """Memory-map the arrays of an npz file of :func:`write_arrays`; they are read from the disk when they are used.

    The operating system keeps the parts in use and evicts them when memory is short. Nothing is verified.

    Raises:
        DataError: the file is missing or damaged.
    """
    kind.require(path)
    arrays: Arrays = {}
    try:
        with path.open("rb") as file, zipfile.ZipFile(file) as archive:
            for member in archive.infolist():
                if member.compress_type != zipfile.ZIP_STORED:
                    raise ValueError(f"{member.filename} is compressed")
                file.seek(member.header_offset)
                header = file.read(_ZIP_HEADER.size)
                *_, name_length, extra_length = _ZIP_HEADER.unpack(header)
                start = member.header_offset + _ZIP_HEADER.size + name_length + extra_length
                file.seek(start)
                version = np.lib.format.read_magic(file)
                read_header = {
                    (1, 0): np.lib.format.read_array_header_1_0,
                    (2, 0): np.lib.format.read_array_header_2_0,
                }[version]
                shape, _, dtype = read_header(file)
                if dtype.hasobject:
                    raise ValueError(f"{member.filename} holds objects")
                if file.tell() - start + math.prod(shape) * dtype.itemsize != member.file_size:
                    raise ValueError(f"{member.filename} has another length than its array")
                name = _array_name(member, arrays)
                if 0 in shape:  # nothing to map
                    arrays[name] = np.empty(shape, dtype)
                else:
                    arrays[name] = np.memmap(file, dtype, mode="r", offset=file.tell(), shape=shape)
    except Exception as error:  # as above
        raise kind.damaged(path, f"it cannot be read as npz ({brief(error)})") from error
    return arrays


def check_arrays(path: Path, arrays: Mapping[str, npt.NDArray[Any]], kind: FileKind = SHARD) -> None:
    """Check the names, types and shapes of the arrays of a shard or a block (see the module), which a file holds.

    Raises:
        DataError: they are not those of a shard.
    """
    try:
        _check_arrays(arrays)
    except (ValueError, TypeError, IndexError) as error:
        raise kind.damaged(path, error) from error


def _check_arrays(arrays: Mapping[str, npt.NDArray[Any]]) -> None:
    for name, (dtype, *columns) in _COLUMNS.items():
        if name not in arrays:
            raise ValueError(f"the array {name} is missing")
        array = arrays[name]
        if name == "actions" and array.ndim == 1:  # discrete
            dtype, columns = np.int64, []
        if array.dtype != dtype or list(array.shape[1:]) != columns or array.ndim == 0:
            right = " x ".join(map(str, ["N", *columns]))
            raise ValueError(f"{name} is {array.dtype} of shape {list(array.shape)}, not {np.dtype(dtype)} of {right}")
    length, num_objects, num_edges = (arrays[name] for name in ("length", "num_objects", "num_edges"))
    num_vertices = arrays["num_vertices"]
    for name, least in (("length", 0), ("num_objects", 1), ("num_edges", 3), ("num_vertices", 3)):
        if not ((arrays[name] >= least) & (arrays[name] < _MOST_ROWS)).all():
            raise ValueError(f"{name} has numbers below {least} or too large")
    count = len(arrays["index"])
    sizes = dict.fromkeys(_COLUMNS, count) | {
        "num_vertices": int(num_objects[:count].sum()),
        "materials": int(num_objects[:count].sum()),
        "actions": int(length.sum()),
        "rewards": int(length.sum()),
        "edges": int(num_edges.sum()),
        "outlines": int(num_vertices.sum()),
    }
    del sizes["states"]
    for name, size in sizes.items():
        if len(arrays[name]) != size:
            raise ValueError(f"{name} has {len(arrays[name])} rows, not {size}")
    if len(arrays["states"]) != (size := int(((length + 1) * state_dimension(num_objects)).sum())):
        raise ValueError(f"states has {len(arrays['states'])} numbers, not {size}")


def _array_name(member: zipfile.ZipInfo, others: Mapping[str, Any]) -> str:
    name = member.filename.removesuffix(".npy")
    if name == member.filename or name in others:
        raise ValueError(f"{member.filename} is no array, or is there twice")
    return name


def integers(values: Iterable[int]) -> IntArray:
    """An int64 array."""
    return np.array(list(values), dtype=np.int64)


def offsets(sizes: IntArray) -> IntArray:
    """[N + 1] start of each of N consecutive parts, and end of the last one."""
    return np.concatenate([np.zeros(1, np.int64), np.cumsum(sizes)])


def _pack_actions(actions: Sequence[Action], action_space: ActionSpaceName) -> npt.NDArray[Any]:
    if action_space == "discrete":
        return np.array(actions, dtype=np.int64)
    return np.array(actions, dtype=np.float64).reshape(-1, ContinuousActionSpace.DIMENSION)


def _unpack_actions(actions: npt.NDArray[Any]) -> tuple[Action, ...]:
    return tuple(actions.tolist()) if actions.ndim == 1 else tuple(action.copy() for action in actions)
