"""Imitation of a few demonstrations: resuming after a kill, networks of each observation, inputs that do not fit."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from pipelines.config import TrainILConfig
from pipelines.train_il import make_learner, train_part
from pipelines.training import Inputs, parts_of
from pipelines.workflow.app import compose
from pipelines.workflow.executor import single_threaded
from visualrhp.demonstrations.generate import generate_block
from visualrhp.demonstrations.writer import DemonstrationWriter
from visualrhp.errors import DataError
from visualrhp.heuristics.conversion import load_network
from visualrhp.planning import KinodynamicRRT
from visualrhp.scene import SceneDistribution
from visualrhp.simulation import Physics


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    with single_threaded():
        yield


@pytest.fixture(scope="module")
def demonstrations(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six demonstrations with one object."""
    folder = tmp_path_factory.mktemp("demonstrations")
    writer = DemonstrationWriter(folder, "continuous", 6)
    writer.add(
        generate_block(
            range(6),
            distribution=SceneDistribution(num_objects=(1, 1)),
            action_space="continuous",
            planner=KinodynamicRRT(),
            seed=0,
            physics=Physics(),
        )
    )
    writer.finish()
    return folder


def configure(folder: Path, *overrides: str) -> TrainILConfig:
    shared = ["scale=smoke", "tracking=none", f"demonstrations={folder}", "observation=cartesian"]
    return compose("train_il", TrainILConfig, [*shared, *overrides])


def test_a_killed_training_resumes_to_the_same_network(demonstrations: Path, tmp_path: Path) -> None:
    config = configure(demonstrations, "learner.epochs=3", "validation.num_instances=1")
    (part,) = parts_of(config)
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    rows = list(train_part(config, part, whole))
    assert [row["epoch"] for row in rows] == [1.0, 2.0, 3.0]
    training = train_part(config, part, killed)
    next(training), next(training)
    training.close()
    assert [row["epoch"] for row in train_part(config, part, killed)][-1] == 3.0
    first, second = (load_network(folder / "heuristic.safetensors")[0].state_dict() for folder in (whole, killed))
    assert all(torch.equal(first[key], second[key]) for key in first)


def test_each_observation_has_its_networks(demonstrations: Path) -> None:
    cartesian = configure(demonstrations, "observation.num_objects=[1,4]")
    assert [part.suffix for part in parts_of(cartesian)] == ["_m1", "_m4"]
    image = compose("train_il", TrainILConfig, ["scale=smoke", f"demonstrations={demonstrations}"])
    assert [part.suffix for part in parts_of(image)] == [""]


def test_demonstrations_that_do_not_fit_are_refused(demonstrations: Path, tmp_path: Path) -> None:
    other_number = configure(demonstrations, "observation.num_objects=[4]")
    with pytest.raises(DataError, match="no demonstrations"):
        make_learner(other_number, parts_of(other_number)[0])
    other_space = configure(demonstrations, "action_space=discrete")
    with pytest.raises(DataError, match="continuous"):
        make_learner(other_space, parts_of(other_space)[0])
    missing = configure(tmp_path / "nothing")
    with pytest.raises(DataError, match="nothing"):
        make_learner(missing, parts_of(missing)[0])


def test_demonstrations_that_are_replaced_meanwhile_have_no_effect(demonstrations: Path, tmp_path: Path) -> None:
    source = tmp_path / "set"
    shutil.copytree(demonstrations, source)
    inputs = Inputs({}, source, json.loads((source / "card.json").read_text())["content_hash"])
    stored = inputs.store(configure(source), tmp_path / "work")
    shutil.rmtree(source)
    content = [path.read_bytes() for path in sorted(Path(stored.demonstrations).iterdir())]
    assert content == [path.read_bytes() for path in sorted(demonstrations.iterdir())]
    shutil.copytree(demonstrations, source)
    with pytest.raises(DataError, match="was replaced while this command started"):
        replace(inputs, content_hash="another").store(configure(source), tmp_path / "other")
