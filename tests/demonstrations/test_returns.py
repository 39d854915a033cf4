"""Monte Carlo returns (Eq. 4)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.demonstrations.conftest import write
from visualrhp.demonstrations.dataset import DemonstrationSet
from visualrhp.demonstrations.generate import Attempt
from visualrhp.demonstrations.returns import monte_carlo_returns
from visualrhp.types import ActionSpaceName


def test_returns_of_eq_4() -> None:
    """L = 3, gamma = 1/2, rewards -1: -1 - 1/2 - 1/4, -1 - 1/2, -1."""
    assert monte_carlo_returns([-1.0, -1.0, -1.0], 0.5).tolist() == [-1.75, -1.5, -1.0]
    assert monte_carlo_returns([], 0.5).tolist() == []


def test_returns_follow_the_order_of_the_demonstrations(
    tmp_path: Path, attempts: dict[ActionSpaceName, list[Attempt]]
) -> None:
    stored = DemonstrationSet.open(write(tmp_path, attempts["discrete"], "discrete"))
    expected = np.concatenate([monte_carlo_returns(episode.rewards, 0.9) for _, episode in stored])
    assert np.array_equal(stored.returns(0.9), expected)
