"""A short run of the hostile scenes; ``python -m tests.torture scenes`` makes a long one."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from tests.torture.scenes import CHARACTERS, KINDS, WrongResult, attempt, run
from visualrhp.errors import SceneError


def test_hostile_scenes_are_read_or_refused() -> None:
    found = run(600, seed=0)
    print(found)
    assert found["cases"] == 600
    for fault in ("tracebacks", "surprises", "long_messages"):
        assert not found[fault], found["examples"]
    assert found["slowest_s"] < 10.0, "under load; 2 s alone"
    for kind in KINDS:
        assert found["outcomes"][f"{kind}: accepted"] > 3 and found["outcomes"][f"{kind}: refused"] > 3


def test_the_harness_notices_what_it_should(tmp_path: Path) -> None:
    def failing(error: Exception):
        def case(rng: np.random.Generator, folder: Path) -> None:
            raise error

        return attempt(case, np.random.default_rng(0), tmp_path)[0]

    started = time.perf_counter()
    assert failing(SceneError("wrong")) == "refused"
    assert failing(SceneError("x" * (CHARACTERS + 1))) == failing(SceneError("")) == "long_messages"
    assert failing(TypeError("wrong")) == failing(RuntimeWarning("overflow")) == "tracebacks"
    assert failing(WrongResult("wrong")) == "surprises"
    assert time.perf_counter() - started < 5.0
