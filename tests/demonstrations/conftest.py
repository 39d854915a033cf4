"""A few attempts in both action spaces, and how to store them."""

from __future__ import annotations

from pathlib import Path

import pytest

from visualrhp.demonstrations.dataset import DemonstrationSet
from visualrhp.demonstrations.generate import Attempt, generate_block, generate_demonstration
from visualrhp.demonstrations.shards import pack
from visualrhp.demonstrations.writer import DemonstrationWriter
from visualrhp.planning import KinodynamicRRT
from visualrhp.scene import SceneDistribution
from visualrhp.types import ActionSpaceName

SEED = 3
DISTRIBUTION = SceneDistribution(num_objects=(1, 3))
STORED_COUNT = 9
ACTION_SPACES: tuple[ActionSpaceName, ...] = ("continuous", "discrete")


def attempt(action_space: ActionSpaceName, index: int, planner: KinodynamicRRT | None = None) -> Attempt:
    return generate_demonstration(DISTRIBUTION, action_space, planner or KinodynamicRRT(), SEED, index)


@pytest.fixture(scope="module")
def attempts() -> dict[ActionSpaceName, list[Attempt]]:
    """Seven attempts a space; those with the indices 1 and 4 fail because they have no budget."""
    hopeless = KinodynamicRRT(max_simulations=1)
    return {
        space: [attempt(space, index, hopeless if index in (1, 4) else None) for index in range(7)]
        for space in ACTION_SPACES
    }


def write(folder: Path, attempts: list[Attempt], space: ActionSpaceName, count: int = 5, **settings: int) -> Path:
    writer = DemonstrationWriter(folder, space, count, **settings)
    writer.add(pack(attempts, space))
    writer.finish(seed=SEED, commit="0" * 40, config={"count": count})
    return folder


@pytest.fixture(scope="package", params=["continuous", "discrete"])
def stored(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> DemonstrationSet:
    space: ActionSpaceName = request.param
    folder = tmp_path_factory.mktemp(space)
    writer = DemonstrationWriter(folder, space, STORED_COUNT, shard_size=4)
    planner = KinodynamicRRT(max_simulations=600)
    writer.add(generate_block(range(14), SceneDistribution(num_objects=(1, 3)), space, planner, 5))
    writer.finish()
    return DemonstrationSet.open(folder)
