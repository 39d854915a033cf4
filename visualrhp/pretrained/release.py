"""The files of the released networks, and loading them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final, Literal, get_args

from visualrhp.errors import ConfigError
from visualrhp.heuristics.checkpoint import load_heuristic
from visualrhp.heuristics.learned import DEFAULT_TEMPERATURE, LearnedHeuristic
from visualrhp.observation import make_observation, observation_class
from visualrhp.types import ActionSpaceName

Procedure = Literal["best", "paper"]
"""How a network was trained: ``best``, with expert iteration; ``paper``, as in the paper."""

PROCEDURES: Final[tuple[Procedure, ...]] = get_args(Procedure)


def load_pretrained(
    action_space: ActionSpaceName,
    observation: str = "image",
    num_objects: int | None = None,
    procedure: Procedure = "best",
    temperature: float = DEFAULT_TEMPERATURE,
) -> LearnedHeuristic:
    """Load a released network as a heuristic. The file's checksum is verified; torch is not imported.

    Args:
        action_space: ``continuous`` or ``discrete``.
        observation: ``image``, or ``cartesian``, which has one network for each number of objects (Sec. 7.5).
        num_objects: m, for Cartesian features only.
        procedure: ``best`` or ``paper``.
        temperature: tau of Eq. 2 (discrete action space).

    Raises:
        CheckpointError: the file is damaged.
        ConfigError: there is no such network, or the temperature is not positive.
    """
    path = pretrained_path(action_space, observation, num_objects, procedure)
    fixes_num_objects = observation_class(observation).fixes_num_objects
    expected = make_observation(observation, num_objects if fixes_num_objects else None)
    return load_heuristic(path, action_space, temperature, expected)


def pretrained_folder(procedure: Procedure = "best") -> Path:
    """The folder with the networks of a procedure, ``<action space>/<observation>/heuristic*.safetensors``.

    Raises:
        ConfigError: the procedure is unknown.
    """
    if procedure not in PROCEDURES:
        raise ConfigError(f"procedure is {procedure!r}; choose {' or '.join(PROCEDURES)}")
    return Path(__file__).parent / procedure


def pretrained_path(
    action_space: ActionSpaceName,
    observation: str = "image",
    num_objects: int | None = None,
    procedure: Procedure = "best",
) -> Path:
    """File of a released network; its card is the JSON file of the same name.

    Arguments and errors: :func:`load_pretrained`.
    """
    folder = pretrained_folder(procedure)
    suffix = ""
    if observation_class(observation).fixes_num_objects:
        if num_objects is None:
            raise ConfigError(f"num_objects is missing: every number of objects has its own {observation} network")
        suffix = f"_m{num_objects}"
    path = folder / action_space / observation / f"heuristic{suffix}.safetensors"
    if not os.path.lexists(path):
        known = sorted(str(file.relative_to(folder).with_suffix("")) for file in folder.rglob("*.safetensors"))
        raise ConfigError(
            f"there is no released network {path.relative_to(folder).with_suffix('')} of the procedure {procedure!r}; "
            f"choose from {', '.join(known)}"
        )
    return path
