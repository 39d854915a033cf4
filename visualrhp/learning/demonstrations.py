"""Demonstrations of the kinodynamic RRT (Sec. 6.1): generating, storing and reading them.

A demonstration set is a folder of a few shard files and a JSON card. A shard holds scenes, states, actions and rewards
as plain arrays (npz without objects; float64 survives to the bit), ragged parts one after the other:

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

The task instances of a set are those with the indices 0, 1, 2, ... up to the one that completes the wanted number of
demonstrations. An instance that the planner failed on is kept as a failure and thereby replaced by the next index, so
that the content of a set depends on (configuration, seed) alone: neither on the number of workers nor on interruptions.
"""

from __future__ import annotations

import dataclasses
import hashlib
import struct
import time
import zipfile
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from visualrhp.errors import ActionError, DataError, SceneError, SimulationError
from visualrhp.files import atomic_path, read_json, write_json
from visualrhp.planning.kinodynamic_rrt import KinodynamicRRT
from visualrhp.scene.gripper import Gripper
from visualrhp.scene.sampling import SceneDistribution, Split, generator_for, sample_task_instance
from visualrhp.scene.scene import ObjectShape, Scene, TargetRegion, TaskInstance
from visualrhp.simulation.action_spaces import make_action_space
from visualrhp.simulation.physics import Physics
from visualrhp.simulation.task import DISCOUNT
from visualrhp.simulation.transition_model import TransitionModel
from visualrhp.types import Action, ActionSpaceName, Episode, FloatArray, IntArray, State

CARD_FILE = "card.json"
FORMAT = 1

_PLANNING_STREAM = 1

Arrays = dict[str, npt.NDArray[Any]]


@dataclass(frozen=True, slots=True)
class Attempt:
    """What the planner made of one task instance: a demonstration, or a failure.

    Attributes:
        index: index of the task instance.
        task: the task instance.
        episode: the demonstration, or None if the planner found no plan within its budget.
        num_simulated: actions simulated by the search.
        num_nodes: nodes of the search tree.
        search_time_s: wall-clock time of the search [s]; not part of a stored set, because it never repeats.
    """

    index: int
    task: TaskInstance
    episode: Episode | None
    num_simulated: int
    num_nodes: int
    search_time_s: float


def generate_demonstration(
    distribution: SceneDistribution,
    action_space: ActionSpaceName,
    planner: KinodynamicRRT,
    seed: int,
    index: int,
    physics: Physics | None = None,
    split: Split = Split.DEMONSTRATIONS,
) -> Attempt:
    """Plan task instance ``index`` of ``split`` with the kinodynamic RRT: a function of the arguments alone.

    That holds as long as ``planner`` has no time limit, or does not reach it.
    """
    task = sample_task_instance(distribution, seed, split, index)
    model = TransitionModel(task.scene, make_action_space(action_space), physics or Physics())
    started = time.perf_counter()
    found = planner.search(model, task.state, generator_for(seed, split, index, _PLANNING_STREAM))
    elapsed = time.perf_counter() - started
    return Attempt(index, task, found.episode, found.num_simulated, found.num_nodes, elapsed)


def generate_block(
    indices: Sequence[int],
    distribution: SceneDistribution,
    action_space: ActionSpaceName,
    planner: KinodynamicRRT,
    seed: int,
    physics: Physics | None = None,
) -> Arrays:
    """Attempt the task instances ``indices`` one after the other; a unit of parallel work that is cheap to send around.

    Returns:
        The packed attempts (see :func:`pack`), and ``search_time_s`` [D], which is not part of a stored set.
    """
    attempts = [generate_demonstration(distribution, action_space, planner, seed, index, physics) for index in indices]
    times = np.array([attempt.search_time_s for attempt in attempts])
    return {**pack(attempts, action_space), "search_time_s": times}


def monte_carlo_returns(rewards: npt.ArrayLike, discount: float = DISCOUNT) -> FloatArray:
    r"""Return :math:`\sum_{k=0}^{L-l-1} \gamma^k r_{l+k+1}` for every step l of a demonstration (Eq. 4), [L]."""
    returns = np.array(rewards, dtype=np.float64)
    for step in range(len(returns) - 2, -1, -1):
        returns[step] += discount * returns[step + 1]
    return returns


def replays_exactly(task: TaskInstance, episode: Episode, model: TransitionModel) -> bool:
    """Whether the actions, simulated from the first state, give all states and rewards to the bit, and the goal."""
    return replay_difference(task, episode, model) is None


def replay_difference(task: TaskInstance, episode: Episode, model: TransitionModel) -> str | None:
    """What is first found to differ when the actions are simulated from the first state: a state or reward by a single
    bit, or a last state that is no goal; None for a demonstration that replays exactly."""
    state = task.state
    if state != episode.states[0]:
        return "state 0 is not that of the task instance"
    is_goal = False
    steps = zip(episode.actions, episode.rewards, episode.states[1:], strict=True)
    for step, (action, reward, expected) in enumerate(steps, start=1):
        try:
            transition = model.simulate(state, action)
        except (ActionError, SceneError, SimulationError) as error:
            return f"action {step} of {len(episode)} cannot be simulated: {error}"
        if transition.next_state != expected:
            distance = np.abs(transition.next_state.vector - expected.vector).max()
            return f"state {step} of {len(episode)} is another one, by {distance:.3g}"
        if transition.reward != reward:
            return f"reward {step} of {len(episode)} is {transition.reward:g}, not {reward:g}"
        state, is_goal = transition.next_state, transition.is_goal
    return None if is_goal else f"the last of {len(episode)} states is no goal"


def replay_block(
    arrays: Mapping[str, npt.NDArray[Any]], physics: Physics | None = None
) -> tuple[int, int, list[tuple[int, str]]]:
    """Replay the demonstrations in the arrays of a shard; a unit of parallel work that is cheap to send around.

    Returns:
        demonstrations that replay exactly, their transitions, and (index of the task instance, what differs) of the
        others (see :func:`replay_difference`).
    """
    shard = Shard(arrays)
    space: ActionSpaceName = "discrete" if arrays["actions"].ndim == 1 else "continuous"
    num_exact = num_transitions = 0
    differing = []
    for position in shard.demonstrations:
        episode = shard.episode(position)
        assert episode is not None  # only solved attempts have a position
        index = int(arrays["index"][position])
        try:
            task = shard.task(position)
            difference = replay_difference(
                task, episode, TransitionModel(task.scene, make_action_space(space), physics or Physics())
            )
        except SceneError as error:
            difference = f"the scene cannot be simulated: {error}"
        if difference is None:
            num_exact, num_transitions = num_exact + 1, num_transitions + len(episode)
        else:
            differing.append((index, difference))
    return num_exact, num_transitions, differing


# --- storing ----------------------------------------------------------------------------------------------------------


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
    rewards = [reward for episode in episodes if episode for reward in episode.rewards]
    return {
        "index": _integers(attempt.index for attempt in attempts),
        "solved": np.array([episode is not None for episode in episodes], dtype=np.bool_),
        "length": _integers(len(episode) if episode else 0 for episode in episodes),
        "num_objects": _integers(scene.num_objects for scene in scenes),
        "states": np.concatenate([np.empty(0), *states]),
        "actions": _pack_actions(actions, action_space),
        "rewards": np.array(rewards, dtype=np.float64),
        "target": np.array([[*scene.target.position, scene.target.radius] for scene in scenes]).reshape(-1, 3),
        "gripper": np.array([dataclasses.astuple(scene.gripper) for scene in scenes]).reshape(-1, _GRIPPER_FIELDS),
        "num_edges": _integers(len(scene.edges) for scene in scenes),
        "edges": np.concatenate([np.empty((0, 2)), *(scene.edges for scene in scenes)]),
        "num_vertices": _integers(len(shape.outline) for shape in shapes),
        "outlines": np.concatenate([np.empty((0, 2)), *(shape.outline for shape in shapes)]),
        "materials": np.array([[shape.density, shape.friction] for shape in shapes]).reshape(-1, 2),
        "num_simulated": _integers(attempt.num_simulated for attempt in attempts),
        "num_nodes": _integers(attempt.num_nodes for attempt in attempts),
    }


class Shard:
    """The attempts in the arrays of one shard (see the module), unpacked one at a time."""

    def __init__(self, arrays: Mapping[str, npt.NDArray[Any]]) -> None:
        self.arrays = arrays
        length, num_objects = arrays["length"], arrays["num_objects"]
        self._states = _offsets((length + 1) * (5 + 3 * num_objects))
        self._steps = _offsets(length)
        self._edges = _offsets(arrays["num_edges"])
        self._objects = _offsets(num_objects)
        self._vertices = _offsets(arrays["num_vertices"])

    def __len__(self) -> int:
        return len(self.arrays["index"])

    @cached_property
    def demonstrations(self) -> IntArray:
        """[.] positions of the solved attempts."""
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
            is_goal=True,
            is_dropped=False,
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
        "states": int(((length + 1) * (5 + 3 * num_objects)).sum()),
        "actions": int(length.sum()),
        "rewards": int(length.sum()),
        "edges": int(num_edges.sum()),
        "num_vertices": objects,
        "materials": objects,
        "outlines": int(arrays["num_vertices"][:objects].sum()),
    }
    return {name: array[: sizes.get(name, count)] for name, array in arrays.items()}


def between(arrays: Mapping[str, npt.NDArray[Any]], start: int, stop: int) -> Arrays:
    """Return the arrays of the attempts at the positions ``start`` up to ``stop`` of a shard."""
    return _tail(head(arrays, stop), start)


def write_arrays(path: Path, arrays: Mapping[str, npt.NDArray[Any]]) -> None:
    """Write arrays to an npz file, atomically; the same bytes for the same arrays."""
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def read_arrays(path: Path) -> Arrays:
    """Read all arrays of an npz file (its own checksums are verified on the way).

    Raises:
        DataError: the file is missing or damaged.
    """
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except FileNotFoundError:
        raise DataError(f"{path} is missing; it should be a shard of demonstrations.") from None
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, zipfile.LargeZipFile) as error:
        raise DataError(f"{path} is damaged and cannot be read as npz ({error}); make it again.") from error


def map_arrays(path: Path) -> Arrays:
    """Map the arrays of an npz file that :func:`write_arrays` wrote into memory: read from the disk as they are used.

    The operating system holds what is in use and lets go of it when memory is short. Nothing is verified.

    Raises:
        DataError: the file is missing or damaged.
    """
    arrays: Arrays = {}
    try:
        with path.open("rb") as file, zipfile.ZipFile(file) as archive:
            for member in archive.infolist():
                if member.compress_type != zipfile.ZIP_STORED:
                    raise ValueError(f"{member.filename} is compressed")
                file.seek(member.header_offset)
                header = file.read(_ZIP_HEADER.size)
                *_, name_length, extra_length = _ZIP_HEADER.unpack(header)
                file.seek(member.header_offset + _ZIP_HEADER.size + name_length + extra_length)
                version = np.lib.format.read_magic(file)
                read_header = {
                    (1, 0): np.lib.format.read_array_header_1_0,
                    (2, 0): np.lib.format.read_array_header_2_0,
                }[version]
                shape, _, dtype = read_header(file)
                if dtype.hasobject:
                    raise ValueError(f"{member.filename} holds objects")
                name = member.filename.removesuffix(".npy")
                if 0 in shape:  # nothing to map
                    arrays[name] = np.empty(shape, dtype)
                else:
                    arrays[name] = np.memmap(file, dtype, mode="r", offset=file.tell(), shape=shape)
    except FileNotFoundError:
        raise DataError(f"{path} is missing; it should be a shard of demonstrations.") from None
    except (OSError, ValueError, EOFError, KeyError, struct.error, zipfile.BadZipFile) as error:
        raise DataError(f"{path} is damaged and cannot be read as npz ({error}); make it again.") from error
    return arrays


class DemonstrationWriter:
    """Writes a demonstration set: consecutive attempts in, shards and finally the card out.

    Args:
        folder: where the set goes; created.
        action_space: the action space of the attempts.
        count: wanted number of demonstrations; attempts beyond the one that completes them are left out.
        shard_size: demonstrations per shard file.
    """

    def __init__(self, folder: Path, action_space: ActionSpaceName, count: int, shard_size: int = 1000) -> None:
        self._folder = folder
        self._action_space: ActionSpaceName = action_space
        self._missing = count
        self._shard_size = shard_size
        self._pending: list[Arrays] = []
        self._num_pending = 0
        self._shards: list[dict[str, Any]] = []
        self._next_index = 0
        self._lengths: Counter[int] = Counter()
        self._solved: Counter[int] = Counter()
        self._failed: Counter[int] = Counter()
        self._failed_indices: list[int] = []

    @property
    def is_complete(self) -> bool:
        """Whether the wanted number of demonstrations has been added."""
        return self._missing == 0

    @property
    def num_attempts(self) -> int:
        """Attempts added so far, failures included."""
        return self._next_index

    @property
    def num_missing(self) -> int:
        """Demonstrations that are still to be added."""
        return self._missing

    def add(self, arrays: Mapping[str, npt.NDArray[Any]]) -> None:
        """Add the next attempts, packed (see :func:`pack`); their indices continue those added so far.

        Search times are left out, since they would differ from one generation to the next.

        Raises:
            DataError: the indices do not continue, or the actions are of another space.
        """
        arrays = {name: array for name, array in arrays.items() if name != "search_time_s"}
        while len(arrays["index"]) and not self.is_complete:
            room = min(self._missing, self._shard_size - self._num_pending)
            solved = np.cumsum(arrays["solved"])
            taken = int(np.searchsorted(solved, room)) + 1 if solved[-1] >= room else len(solved)
            part = head(arrays, taken)
            self._append(part)
            arrays = _tail(arrays, taken)

    def finish(self, **provenance: Any) -> dict[str, Any]:
        """Write what is pending and the card, and return the card.

        Args:
            provenance: further entries of the card (config, seed, commit).

        Raises:
            DataError: the wanted number of demonstrations is not complete.
        """
        if not self.is_complete:
            raise DataError(
                f"{self._folder} lacks {self._missing} demonstrations; add attempts until the set is complete."
            )
        self._flush()
        content = hashlib.sha256("".join(shard["sha256"] for shard in self._shards).encode()).hexdigest()
        densities = sorted(self._solved | self._failed)
        card = {
            "kind": "demonstrations",
            "format": FORMAT,
            "action_space": self._action_space,
            "num_demonstrations": sum(self._solved.values()),
            "num_attempts": self._next_index,
            "num_transitions": sum(length * number for length, number in self._lengths.items()),
            "failed_indices": self._failed_indices,
            "densities": {str(m): {"solved": self._solved[m], "failed": self._failed[m]} for m in densities},
            "lengths": {str(length): self._lengths[length] for length in sorted(self._lengths)},
            "shards": self._shards,
            "content_hash": content,
            **provenance,
        }
        write_json(self._folder / CARD_FILE, card)
        known = {shard["file"] for shard in self._shards}
        for path in self._folder.glob("shard-*.npz"):  # of a larger set that was here
            if path.name not in known:
                path.unlink()
        return card

    def _append(self, part: Arrays) -> None:
        expected = np.arange(self._next_index, self._next_index + len(part["index"]))
        if not np.array_equal(part["index"], expected):
            raise DataError(
                f"the attempts added to {self._folder} should continue with the indices {expected[0]} to "
                f"{expected[-1]}, but have {part['index'].tolist()}"
            )
        _check_action_space(part, self._action_space, f"the attempts added to {self._folder}")
        solved = part["solved"]
        self._next_index += len(solved)
        self._missing -= int(solved.sum())
        self._lengths.update(part["length"][solved].tolist())
        self._solved.update(part["num_objects"][solved].tolist())
        self._failed.update(part["num_objects"][~solved].tolist())
        self._failed_indices += part["index"][~solved].tolist()
        self._pending.append(part)
        self._num_pending += int(solved.sum())
        if self._num_pending == self._shard_size:
            self._flush()

    def _flush(self) -> None:
        if not self._pending:
            return
        arrays = concatenate(self._pending)
        path = self._folder / f"shard-{len(self._shards):05d}.npz"
        write_arrays(path, arrays)
        self._shards.append(
            {
                "file": path.name,
                "bytes": path.stat().st_size,
                "sha256": file_hash(path),
                "first_index": int(arrays["index"][0]),
                "num_attempts": len(arrays["index"]),
                "num_demonstrations": int(arrays["solved"].sum()),
                "num_transitions": int(arrays["length"].sum()),
            }
        )
        self._pending, self._num_pending = [], 0


# --- reading ----------------------------------------------------------------------------------------------------------


def read_card(folder: str | Path) -> dict[str, Any]:
    """Read the card of the demonstration set in ``folder``.

    Raises:
        DataError: it is missing, damaged, or something else; the message names the file.
    """
    path = Path(folder) / CARD_FILE
    if not path.is_file():
        raise DataError(f"{path} is missing: there is no finished set of demonstrations there; generate one first.")
    card = read_json(path)
    if not isinstance(card, dict) or card.get("kind") != "demonstrations" or card.get("format") != FORMAT:
        raise DataError(f"{path} is not the card of a demonstration set of format {FORMAT}; generate the set again.")
    return card


def damaged_shards(folder: str | Path, card: Mapping[str, Any]) -> dict[int, str]:
    """Number of every shard that is missing, truncated or altered -> what is wrong, with the name of the file."""
    damages = {}
    for number, shard in enumerate(card["shards"]):
        damage = _damage(Path(folder) / shard["file"], shard)
        if damage is not None:
            damages[number] = damage
    return damages


class DemonstrationSet:
    """Stored demonstrations. Opening reads the card and verifies the checksums; the shards are mapped into memory, and
    a demonstration is read from the disk when it is asked for.

    Iterating yields (TaskInstance, Episode); positions run from 0 to ``len(set) - 1`` and leave failures out.
    """

    def __init__(self, folder: Path, card: Mapping[str, Any]) -> None:
        self._folder = folder
        self._shards: dict[int, Shard] = {}
        self._firsts = _offsets(_integers(shard["num_demonstrations"] for shard in card["shards"]))
        self.card = card

    @classmethod
    def open(cls, folder: str | Path, action_space: ActionSpaceName | None = None) -> DemonstrationSet:
        """Open the set in ``folder``.

        Args:
            folder: where it was written.
            action_space: the action space it must be of, if that matters.

        Raises:
            DataError: the card or a shard is missing, truncated or altered, or the set is of another action space or
                format; the message names the file.
        """
        folder = Path(folder)
        path = folder / CARD_FILE
        card = read_card(folder)
        if action_space is not None and card["action_space"] != action_space:
            raise DataError(
                f"{path} belongs to demonstrations in the {card['action_space']} action space; the {action_space} "
                "action space needs its own."
            )
        for damage in damaged_shards(folder, card).values():
            raise DataError(damage)
        return cls(folder, card)

    @property
    def action_space(self) -> ActionSpaceName:
        """The action space of the demonstrations."""
        return self.card["action_space"]

    @property
    def num_transitions(self) -> int:
        """Actions of all demonstrations together."""
        return int(self.card["num_transitions"])

    @cached_property
    def lengths(self) -> IntArray:
        """[len(self)] actions L of each demonstration."""
        return self._collect("length")

    @cached_property
    def num_objects(self) -> IntArray:
        """[len(self)] objects m of each demonstration."""
        return self._collect("num_objects")

    @cached_property
    def indices(self) -> IntArray:
        """[len(self)] index of the task instance of each demonstration."""
        return self._collect("index")

    def __len__(self) -> int:
        return int(self._firsts[-1])

    def __getitem__(self, position: int) -> tuple[TaskInstance, Episode]:
        if not -len(self) <= position < len(self):
            raise IndexError(f"position {position} in a set of {len(self)} demonstrations")
        shard, attempt = self._locate(position % len(self))
        episode = shard.episode(attempt)
        assert episode is not None  # only solved attempts have a position
        return TaskInstance(shard.scene(attempt), episode.states[0]), episode

    def __iter__(self) -> Iterator[tuple[TaskInstance, Episode]]:
        for position in range(len(self)):
            yield self[position]

    def returns(self, discount: float = DISCOUNT) -> FloatArray:
        """[num_transitions] Monte Carlo returns (Eq. 4), demonstration after demonstration."""
        parts = [np.empty(0)]
        for position in range(len(self)):
            shard, attempt = self._locate(position)
            parts.append(monte_carlo_returns(shard.rewards(attempt), discount))
        return np.concatenate(parts)

    def shard(self, number: int) -> Shard:
        """The shard file ``number``, mapped into memory on first use.

        Raises:
            DataError: the file was damaged since the set was opened.
        """
        if number not in self._shards:
            path = self._folder / self.card["shards"][number]["file"]
            arrays = map_arrays(path)
            _check_action_space(arrays, self.action_space, str(path))
            self._shards[number] = Shard(arrays)
        return self._shards[number]

    def _locate(self, position: int) -> tuple[Shard, int]:
        number = int(np.searchsorted(self._firsts, position, side="right")) - 1
        shard = self.shard(number)
        return shard, int(shard.demonstrations[position - self._firsts[number]])

    def _collect(self, name: str) -> IntArray:
        shards = (self.shard(number) for number in range(len(self.card["shards"])))
        return np.concatenate([np.empty(0, np.int64), *(shard.arrays[name][shard.demonstrations] for shard in shards)])


# --- helpers ----------------------------------------------------------------------------------------------------------

_ZIP_HEADER = struct.Struct("<4s5H3I2H")
"""Local header of a member of a zip file, up to the lengths of its name and its extra field."""

_GRIPPER_FIELDS = len(dataclasses.fields(Gripper))
_ACTION_DIMENSION = 4


def _damage(path: Path, expected: Mapping[str, Any]) -> str | None:
    """What is wrong with a shard file; None if it is what the card says."""
    if not path.is_file():
        return f"{path} is missing, but the card beside it lists it; the command that made the set makes it again."
    size = path.stat().st_size
    if size != expected["bytes"]:
        return (
            f"{path} has {size} bytes where the card says {expected['bytes']}: it is damaged; the command that made "
            "the set makes it again."
        )
    if file_hash(path) != expected["sha256"]:
        return (
            f"{path} does not have the SHA-256 checksum that the card says: it is damaged; the command that made the "
            "set makes it again."
        )
    return None


def _check_action_space(arrays: Mapping[str, npt.NDArray[Any]], action_space: ActionSpaceName, what: str) -> None:
    found = "discrete" if arrays["actions"].ndim == 1 else "continuous"
    if found != action_space:
        raise DataError(f"{what} holds {found} actions where {action_space} ones are expected.")


def _pack_actions(actions: Sequence[Action], action_space: ActionSpaceName) -> npt.NDArray[Any]:
    if action_space == "discrete":
        return np.array(actions, dtype=np.int64)
    return np.array(actions, dtype=np.float64).reshape(-1, _ACTION_DIMENSION)


def _unpack_actions(actions: npt.NDArray[Any]) -> tuple[Action, ...]:
    return tuple(actions.tolist()) if actions.ndim == 1 else tuple(action.copy() for action in actions)


def _tail(arrays: Mapping[str, npt.NDArray[Any]], count: int) -> Arrays:
    """Return the arrays without the first ``count`` attempts."""
    skipped = head(arrays, count)
    return {name: array[len(skipped[name]) :] for name, array in arrays.items()}


def _integers(values: Iterable[int]) -> IntArray:
    return np.array(list(values), dtype=np.int64)


def _offsets(sizes: IntArray) -> IntArray:
    """[N + 1] where each of N consecutive parts starts, and where the last one ends."""
    return np.concatenate([np.zeros(1, np.int64), np.cumsum(sizes)])


def file_hash(path: Path) -> str:
    """SHA-256 of the content of a file, as on the card."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
