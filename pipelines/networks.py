"""Files of trained networks: their paths in a folder of heuristics, and copies of them for one run of a stage."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from pathlib import Path

from visualrhp.files import atomic_path


def network_path(folder: Path, action_space: str, observation: str, num_objects: int) -> Path:
    """Path of the network for scenes with ``num_objects`` objects in a folder of heuristics."""
    from visualrhp.observation import observation_class

    suffix = network_suffix(num_objects if observation_class(observation).fixes_num_objects else None)
    return folder / action_space / observation / f"heuristic{suffix}.safetensors"


def network_suffix(num_objects: int | None) -> str:
    """Suffix of the names of a network's files: empty, or ``_m4`` for a network for one number of objects."""
    return "" if num_objects is None else f"_m{num_objects}"


@dataclass(frozen=True)
class NetworkFile:
    """A network as it was when a stage started; what happens to its file later has no effect on the stage.

    Attributes:
        name: on cards.
        sha256: of the content, as hexadecimal digits.
        content: of the file.
    """

    name: str
    sha256: str
    content: bytes = field(repr=False)

    @classmethod
    def read(cls, path: Path, name: str) -> NetworkFile:
        """Read a file.

        Raises:
            CheckpointError: it cannot be read.
        """
        from visualrhp.heuristics.checkpoint import NETWORK

        NETWORK.require(path)
        content = path.read_bytes()
        return cls(name, hashlib.sha256(content).hexdigest(), content)

    def store(self, folder: Path) -> Path:
        """Write the content to a file named by its hash, unless it is there; return the path."""
        path = folder / f"{self.sha256[:16]}.safetensors"
        if not path.is_file() or path.read_bytes() != self.content:
            with atomic_path(path) as temporary:
                temporary.write_bytes(self.content)
        return path
