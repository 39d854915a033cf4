"""Demonstrations as Minari data sets.

The data set belongs to the registered environment ``visualrhp/ClutterManipulation-v0``: it has the observations of the
environment (label image or Cartesian features, and the state of the gripper), its actions (float32, the dtype of the
action space, where the set has float64), rewards, and ``terminated`` at the goal.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from visualrhp.demonstrations.dataset import DemonstrationSet
from visualrhp.errors import ConfigError
from visualrhp.observation import make_observation, observation_class
from visualrhp.types import Episode

ENVIRONMENT = "visualrhp/ClutterManipulation-v0"


def export_minari(
    demonstrations: DemonstrationSet,
    folder: str | Path,
    dataset_id: str,
    observation: str = "image",
    num_objects: int | None = None,
) -> int:
    """Write a Minari data set (see the module), stored as HDF5; ``MINARI_DATASETS_PATH=<folder>`` finds it.

    Args:
        demonstrations: the demonstrations to export.
        folder: of Minari data sets; created if missing.
        dataset_id: name in Minari: ``(namespace/)(environment/)name-v0``.
        observation: name of the observation.
        num_objects: number of objects whose demonstrations are exported; None for all (Cartesian features need one).

    Returns:
        Number of demonstrations.

    Raises:
        ConfigError: Minari is not installed, ``dataset_id`` is not a valid name or exists in ``folder``, or
            Cartesian features are requested for all numbers of objects.
        DataError: there is no demonstration with that number of objects.
    """
    try:
        import minari
        from minari.data_collector import EpisodeBuffer
    except ImportError as error:
        raise ConfigError("the package minari is not installed: pip install '.[minari]'") from error
    positions = demonstrations.positions(num_objects)
    present = demonstrations.num_objects
    bounds = (int(present.min()), int(present.max())) if num_objects is None else (num_objects, num_objects)
    observe = make_observation(observation, num_objects if observation_class(observation).fixes_num_objects else None)
    arguments = {"action_space": demonstrations.action_space, "observation": observation, "num_objects": bounds}
    environment = gymnasium.make(ENVIRONMENT, **arguments)

    def buffer(position: int) -> EpisodeBuffer:
        task, episode = demonstrations[position]
        actions: Any = _environment_actions(episode, environment.action_space)  # an array, as Minari stores it
        return EpisodeBuffer(
            observations={
                "observation": np.stack([observe(task.scene, state) for state in episode.states]),
                "gripper_closed": np.array([state.gripper_closed for state in episode.states], dtype=np.int64),
            },
            actions=actions,
            rewards=list(episode.rewards),
            terminations=[False] * (len(episode) - 1) + [True],
            truncations=[False] * len(episode),
        )

    with _minari_folder(Path(folder)), warnings.catch_warnings():
        # There is no e-mail address or code link to set.
        warnings.filterwarnings("ignore", "`(author_email|code_permalink)` is set to None", UserWarning)
        try:
            # One file (Arrow would write two files per episode). Labels are not intensities: JPEG would change them.
            dataset = minari.create_dataset_from_buffers(
                dataset_id,
                [buffer(positions[0])],
                env=environment.spec,
                eval_env=environment.spec,
                algorithm_name="kinodynamic RRT",
                author="The VisualRHP authors",
                description=f"Demonstrations, content hash {demonstrations.card['content_hash']}",
                data_format="hdf5",
                jpeg_encoding=False,
            )
        except ValueError as error:
            raise ConfigError(f"Minari cannot make a data set called {dataset_id!r} in {folder}: {error}") from error
        dataset.storage.update_episodes(buffer(position) for position in positions[1:])  # one at a time
    environment.close()
    return len(positions)


def _environment_actions(episode: Episode, space: gymnasium.Space[Any]) -> npt.NDArray[Any]:
    actions = np.array(episode.actions)
    if isinstance(space, gymnasium.spaces.Box):
        return actions.astype(np.float32).clip(space.low, space.high)
    return actions


@contextmanager
def _minari_folder(folder: Path) -> Iterator[None]:
    """Set the folder of Minari, which reads it only from an environment variable."""
    name = "MINARI_DATASETS_PATH"
    before = os.environ.get(name)
    os.environ[name] = str(folder.absolute())
    try:
        yield
    finally:
        del os.environ[name]
        if before is not None:
            os.environ[name] = before
