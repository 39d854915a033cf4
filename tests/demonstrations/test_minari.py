"""Minari data sets show what the environment shows."""

from __future__ import annotations

from pathlib import Path

import gymnasium
import numpy as np
import pytest

from visualrhp.demonstrations.dataset import DemonstrationSet
from visualrhp.demonstrations.minari import ENVIRONMENT, export_minari
from visualrhp.errors import ConfigError
from visualrhp.observation import make_observation


@pytest.mark.parametrize("observation", ["image", "cartesian"])
def test_minari_gives_back_what_the_environment_would_show(
    tmp_path: Path, stored: DemonstrationSet, observation: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    import minari

    num_objects = 2 if observation == "cartesian" else None
    name = f"visualrhp/{stored.action_space}-v0"
    count = export_minari(stored, tmp_path, name, observation, num_objects)
    chosen = [pair for pair in stored if num_objects in (None, pair[0].scene.num_objects)]
    assert count == len(chosen)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    dataset = minari.load_dataset(name)
    assert len(dataset) == count
    assert dataset.total_steps == sum(len(episode) for _, episode in chosen)
    environment = dataset.recover_environment()
    assert environment.spec is not None and environment.spec.id == ENVIRONMENT
    assert dataset.observation_space == environment.observation_space
    assert dataset.action_space == environment.action_space
    observe = make_observation(observation, num_objects if observation == "cartesian" else None)
    for (task, episode), loaded in zip(chosen, dataset.iterate_episodes(), strict=True):
        seen = loaded.observations
        expected = np.stack([observe(task.scene, state) for state in episode.states])
        assert seen["observation"].dtype == expected.dtype
        np.testing.assert_array_equal(seen["observation"], expected)
        assert seen["gripper_closed"].tolist() == [int(state.gripper_closed) for state in episode.states]
        assert all(action in environment.action_space for action in loaded.actions)
        np.testing.assert_allclose(loaded.actions, np.array(episode.actions), rtol=1e-6)
        assert loaded.rewards.tolist() == list(episode.rewards)
        assert loaded.terminations.tolist() == [False] * (len(episode) - 1) + [True]
        assert not loaded.truncations.any()
    # Its first observation is the one that the environment itself gives of that task.
    task, _ = chosen[0]
    first, _ = environment.reset(options={"scene": task.scene, "state": task.state})
    np.testing.assert_array_equal(first["observation"], next(dataset.iterate_episodes()).observations["observation"][0])
    environment.close()


def test_minari_names_that_exist_or_are_none_are_refused(tmp_path: Path, stored: DemonstrationSet) -> None:
    export_minari(stored, tmp_path, "clutter/demos-v0", num_objects=1)
    for name in ("clutter/demos-v0", "no name"):
        with pytest.raises(ConfigError, match=f"Minari cannot make a data set called '{name}'"):
            export_minari(stored, tmp_path, name, num_objects=1)


def test_the_environment_is_the_registered_one() -> None:
    assert gymnasium.spec(ENVIRONMENT).id == ENVIRONMENT
