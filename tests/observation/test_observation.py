"""The interface of observations: names, numbers of objects, storage, and observations that a user defines."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from visualrhp.errors import ConfigError, SceneError
from visualrhp.observation import (
    CartesianObservation,
    LabelImageObservation,
    Observation,
    make_observation,
    observation_class,
    observation_for,
)
from visualrhp.scene import Scene, SceneDistribution, sample_task_instance
from visualrhp.streams import Split
from visualrhp.types import State


class Opening(Observation):
    """An observation that a user defines: the opening of the gripper [m], in a column and its mirror image."""

    name = "opening"
    dtype = np.float32
    low, high = 0.0, 0.1

    @property
    def shape(self) -> tuple[int, ...]:
        return (1, 2)

    def __call__(self, scene: Scene, state: State) -> npt.NDArray[np.float32]:
        return np.array([[state.gripper_opening, 0.0]], np.float32)

    def mirror(self, observations: npt.NDArray[Any]) -> npt.NDArray[Any]:
        return observations[..., ::-1]


OBSERVATIONS = [make_observation("image"), make_observation("cartesian", 3), make_observation("opening")]
TASKS = [sample_task_instance(SceneDistribution(num_objects=3), 0, Split.TUNING, index) for index in range(4)]


def test_a_class_is_found_by_its_name() -> None:
    for kind in (LabelImageObservation, CartesianObservation, Opening):
        assert observation_class(kind.name) is kind
    assert type(make_observation("opening")) is Opening


def test_an_unknown_name_is_answered_with_the_known_ones() -> None:
    with pytest.raises(ConfigError, match=r"observation is 'picture'; choose .*image.* or cartesian$") as caught:
        make_observation("picture")
    assert "opening" in str(caught.value)


@pytest.mark.parametrize("observe", OBSERVATIONS, ids=str)
def test_an_observation_has_the_shape_type_and_bounds_that_it_announces(observe: Observation) -> None:
    for task in TASKS:
        observed = observe(task.scene, task.state)
        assert observed.shape == observe.shape and observed.dtype == observe.dtype
        assert (observed >= observe.low).all() and (observed <= observe.high).all()


@pytest.mark.parametrize("observe", OBSERVATIONS, ids=str)
def test_mirroring_a_batch_is_mirroring_each_and_twice_is_the_identity(observe: Observation) -> None:
    batch = np.stack([observe(task.scene, task.state) for task in TASKS])
    mirrored = observe.mirror(batch)
    np.testing.assert_array_equal(mirrored, np.stack([observe.mirror(observed) for observed in batch]))
    np.testing.assert_array_equal(observe.mirror(mirrored), batch)
    assert not np.array_equal(mirrored, batch)


@pytest.mark.parametrize("observe", OBSERVATIONS, ids=str)
def test_what_is_stored_comes_back_in_any_order(observe: Observation) -> None:
    batch = np.stack([observe(task.scene, task.state) for task in TASKS])
    store = observe.store(iter(batch))  # an iterator can be read only once
    assert len(store) == len(TASKS)
    for rows in ([2, 0, 2, 3], [1], []):
        stored = store[np.array(rows, dtype=np.int64)]
        assert stored.dtype == observe.dtype and stored.shape == (len(rows), *observe.shape)
        np.testing.assert_array_equal(stored, batch[rows])
    assert len(observe.store([])) == 0


def test_the_number_of_objects_is_given_where_it_is_needed() -> None:
    with pytest.raises(ConfigError, match=r"^Cartesian observations have a fixed number of objects .*num_objects=4"):
        make_observation("cartesian")
    with pytest.raises(ConfigError, match="image observations are of any number of objects, not of 4"):
        make_observation("image", 4)


def test_the_shape_follows_the_number_of_objects() -> None:
    """Four numbers for each object, two for the target and four for the gripper (Sec. 7.5)."""
    assert [make_observation("cartesian", m).shape for m in (1, 2, 7)] == [(10,), (14,), (34,)]


@pytest.mark.parametrize(
    ("name", "num_objects", "expected"),
    [("cartesian", (4, 4), 4), ("image", (4, 4), None), ("image", (1, 7), None), ("opening", (2, 3), None)],
)
def test_the_number_of_objects_is_that_of_the_scenes(
    name: str, num_objects: tuple[int, int], expected: int | None
) -> None:
    observe = observation_for(name, SceneDistribution(num_objects=num_objects))
    assert (observe.name, observe.num_objects) == (name, expected)


def test_a_varying_number_of_objects_is_refused_where_it_has_to_be_fixed() -> None:
    with pytest.raises(ConfigError, match="scenes with one number of objects"):
        observation_for("cartesian", SceneDistribution(num_objects=(3, 4)))
    with pytest.raises(ConfigError, match="observation is 'picture'"):
        observation_for("picture", SceneDistribution())


def test_a_network_of_another_number_of_objects_is_refused() -> None:
    scene = TASKS[0].scene
    for observe in OBSERVATIONS:
        observe.check(scene)
    with pytest.raises(SceneError, match="the scene has 3 objects, but these are cartesian observations of 2 objects"):
        make_observation("cartesian", 2).check(scene)


def test_observations_are_equal_if_they_read_the_same() -> None:
    assert make_observation("cartesian", 3) == make_observation("cartesian", 3) != make_observation("cartesian", 4)
    assert make_observation("image") == make_observation("image") != make_observation("opening")
    assert make_observation("image") != "image"
    assert len({*OBSERVATIONS, make_observation("image"), make_observation("cartesian", 3)}) == 3


def test_an_observation_describes_itself() -> None:
    assert [str(observe) for observe in OBSERVATIONS] == [
        "image observations of any number of objects",
        "cartesian observations of 3 objects",
        "opening observations of any number of objects",
    ]


def test_a_name_is_registered_once_and_by_the_class_that_defines_it() -> None:
    class Base(Observation):  # without a name
        pass

    with pytest.raises(ConfigError, match=r"'image' is defined by visualrhp\.observation\.label_image"):

        class Other(Base):
            name = "image"

    assert observation_class("image") is LabelImageObservation
