"""The interface of observations, the input of networks: label images, Cartesian features and user-defined ones.

A new observation is a subclass of :class:`Observation` in a separate file: defining it registers its name. It names the
encoder of its networks; environments make their spaces from its shape, dtype and bounds.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from typing import Any, ClassVar, Literal, Protocol

import numpy as np
import numpy.typing as npt

from visualrhp.errors import ConfigError, SceneError
from visualrhp.scene.sampling import SceneDistribution
from visualrhp.scene.scene import Scene
from visualrhp.types import State

_REGISTER: dict[str, type[Observation]] = {}


class ObservationStore(Protocol):
    """T observations, stored compactly; indexing returns a batch."""

    def __len__(self) -> int: ...

    def __getitem__(self, rows: npt.NDArray[np.int64], /) -> npt.NDArray[Any]:
        """The observations with these indices: [B] -> [B, *shape]."""
        ...


class Observation(ABC):
    """A function of scene and state that returns an array.

    Args:
        num_objects: number of objects m in every observed scene; None for any number.

    Attributes:
        name: in configurations and network files.
        fixes_num_objects: whether the shape depends on m, so that every number of objects needs a separate network.
        num_objects: as given.
        shape: of one observation; [H, W] for a label image, [F] for features.
        dtype: of one observation.
        encoder: of its networks (:mod:`visualrhp.heuristics.networks`): ``label_image``, or ``features`` for a vector.
        low: least value of an entry.
        high: largest value of an entry.

    Raises:
        ConfigError: ``num_objects`` is missing, or given for an observation of any number of objects; in the definition
            of a subclass: its name is taken.
    """

    name: ClassVar[str]
    fixes_num_objects: ClassVar[bool] = False
    dtype: ClassVar[type[np.uint8 | np.float32]]
    low: ClassVar[float]
    high: ClassVar[float]
    encoder: ClassVar[Literal["label_image", "features"]] = "features"

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        name = cls.__dict__.get("name")
        if name is None:  # a base class of observations
            return
        known = _REGISTER.get(name)
        if known is not None and (known.__module__, known.__qualname__) != (cls.__module__, cls.__qualname__):
            raise ConfigError(
                f"the observation {name!r} is defined by {known.__module__}.{known.__qualname__}; choose another name "
                f"for {cls.__module__}.{cls.__qualname__}"
            )
        _REGISTER[name] = cls

    def __init__(self, num_objects: int | None = None) -> None:
        if self.fixes_num_objects and num_objects is None:
            raise ConfigError(
                f"{self.name.capitalize()} observations have a fixed number of objects (paper, Sec. 7.5): use scenes "
                "with one number of objects, for instance num_objects=4"
            )
        if not self.fixes_num_objects and num_objects is not None:
            raise ConfigError(f"{self.name} observations are of any number of objects, not of {num_objects}")
        self.num_objects = num_objects

    @property
    @abstractmethod
    def shape(self) -> tuple[int, ...]:
        """Shape of one observation."""

    @abstractmethod
    def __call__(self, scene: Scene, state: State) -> npt.NDArray[Any]:
        """Observe ``state``: an array of :attr:`shape` and :attr:`dtype`."""

    @abstractmethod
    def mirror(self, observations: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Observations [..., *shape] of the mirrored scenes, left and right of the gripper exchanged."""

    def store(self, observations: Iterable[npt.NDArray[Any]]) -> ObservationStore:
        """Store ``observations`` compactly; the iterable is consumed lazily."""
        return np.fromiter(observations, np.dtype((self.dtype, self.shape)))

    def check(self, scene: Scene) -> None:
        """Check that the scene has the number of objects of this observation.

        Raises:
            SceneError: it does not.
        """
        if self.num_objects not in (None, scene.num_objects):
            raise SceneError(
                f"the scene has {scene.num_objects} objects, but these are {self}; every number of objects needs its "
                "own (paper, Sec. 7.5)"
            )

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and self.num_objects == getattr(other, "num_objects", None)

    def __hash__(self) -> int:
        return hash((self.name, self.num_objects))

    def __str__(self) -> str:
        number = "any number of" if self.num_objects is None else self.num_objects
        return f"{self.name} observations of {number} objects"


def observation_class(name: str) -> type[Observation]:
    """The class of the observation ``name``.

    Raises:
        ConfigError: the name is unknown.
    """
    if name not in _REGISTER:
        raise ConfigError(f"observation is {name!r}; choose {' or '.join(sorted(_REGISTER, reverse=True))}")
    return _REGISTER[name]


def make_observation(name: str, num_objects: int | None = None) -> Observation:
    """Make the observation ``name`` for ``num_objects`` objects (None: any number); errors as the class."""
    return observation_class(name)(num_objects)


def observation_for(name: str, distribution: SceneDistribution) -> Observation:
    """Make the observation ``name`` for scenes sampled from ``distribution``.

    Raises:
        ConfigError: the name is unknown, or the observation needs a fixed number of objects and that of the scenes
            varies.
    """
    kind = observation_class(name)
    fewest, most = distribution.num_objects
    return kind(fewest if kind.fixes_num_objects and fewest == most else None)
