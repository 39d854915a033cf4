"""Parameters of the segmentation network check themselves."""

from __future__ import annotations

from typing import Any

import pytest

from visualrhp.embodiment.segmentation.configs import (
    Augmentation,
    FrameSampling,
    NetworkConfig,
    SegmenterTrainingConfig,
)
from visualrhp.errors import ConfigError


@pytest.mark.parametrize(
    ("kind", "values", "words"),
    [
        (FrameSampling, {"frames_per_cell": 0}, "frames_per_cell=0"),
        (FrameSampling, {"grasp": 1.5}, "grasp=1.5"),
        (NetworkConfig, {"blocks": (1, 2)}, r"blocks=\[1, 2\] should have one number for each of the 4 stages"),
        (NetworkConfig, {"widths": (8, 8), "blocks": (1,)}, "at least two"),
        (Augmentation, {"noise": 200.0}, "noise=200"),
        (SegmenterTrainingConfig, {"lr": 0.0}, "lr=0"),
        (SegmenterTrainingConfig, {"validation_fraction": 1.0}, "validation_fraction=1"),
    ],
)
def test_values_out_of_range_are_named(kind: Any, values: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        kind(**values)


def test_lists_are_accepted_for_the_sizes() -> None:
    given: Any = {"widths": [8, 16, 32], "blocks": [1, 2]}
    assert NetworkConfig(**given).widths == (8, 16, 32)
