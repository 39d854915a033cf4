"""A short run of the damage to files; ``python -m tests.torture`` makes a long one."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tests.torture.contents import json_changes
from tests.torture.damage import Tally, judge, replace, run, ways_to_damage
from tests.torture.victims import Victim, make_victims
from visualrhp.errors import DataError


def test_damaged_files_are_refused_in_one_sentence(tmp_path: Path) -> None:
    every = sum(len(ways_to_damage(victim)) for victim in make_victims(tmp_path))
    found = run(every, seed=0)
    print(found)
    assert not found["failures"], found["examples"]
    assert found["cases"] == every and found["refused"] > 0.8 * every
    assert found["slowest_s"] < 2.0


def test_the_harness_notices_what_it_should(tmp_path: Path) -> None:
    """A reader without any check has tracebacks, accepts in silence, and says too little or too much."""
    path = tmp_path / "a.json"
    path.write_text('{"a": [1, 2]}')

    def tally_of(read: Callable[[], Any]) -> Counter[str]:
        victim = Victim("careless", path, read, *json_changes(("a",)), has_checksum=True)
        tally = Tally()
        rng = np.random.default_rng(0)
        expected, content = read(), path.read_bytes()
        for way in ways_to_damage(victim):
            if way.name != "pipe":
                replace(path, content)
                way.apply(path, content, rng, tmp_path)
                judge(victim, way, expected, tally)
        replace(path, content)
        return tally.counts

    def vague() -> Any:
        try:
            return json.loads(path.read_text())["a"][0]
        except Exception as error:
            raise DataError("something is wrong") from error

    assert tally_of(lambda: json.loads(path.read_text())["a"][0])["tracebacks"] > 10
    assert tally_of(lambda: path.is_file() and path.read_bytes())["silent"] > 10
    assert tally_of(vague)["bad_messages"] > 10
