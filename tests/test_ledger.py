"""The ledger of departures in the README says what the configuration says, and ``scale=paper`` is the paper's."""

from __future__ import annotations

import re
from pathlib import Path

import hydra
import pytest
import yaml
from omegaconf import OmegaConf

ROOT = Path(__file__).parents[1]
_KEY = re.compile(r"`(?P<pipeline>\w+) (?P<overrides>(?:[\w=/.]+ )*)(?P<key>[\w.]+)`")
_VALUE = re.compile(r"`([^`]*)`")


def ledger() -> list[dict[str, str]]:
    """Rows of the table under "Departures from the paper"."""
    section = (
        (ROOT / "README.md").read_text(encoding="utf-8").split("## Departures from the paper")[1].split("\n## ")[0]
    )
    rows = [
        [cell.strip() for cell in line.strip().strip("|").split("|")]
        for line in section.splitlines()
        if line.startswith("|")
    ]
    return [dict(zip(rows[0], row, strict=True)) for row in rows[2:]]


def checked_rows() -> list[dict[str, str]]:
    return [row for row in ledger() if row["key"]]


def composed(pipeline: str, overrides: list[str], key: str) -> object:
    with hydra.initialize_config_dir(version_base="1.3", config_dir=str(ROOT / "conf")):
        config = hydra.compose(pipeline, overrides)
    value = OmegaConf.select(config, key, throw_on_missing=True, default="absent")
    assert not (isinstance(value, str) and value == "absent"), f"{pipeline} has no key {key}"
    return OmegaConf.to_container(value, resolve=True) if OmegaConf.is_config(value) else value


def test_every_departure_is_complete() -> None:
    rows = ledger()
    assert len(rows) >= 10
    for row in rows:
        assert re.search(r"Sec\.|Eq\.|Alg\.|footnote", row["paper"]), row
        assert row["ours"], row
        assert row["why"], row


@pytest.mark.parametrize("row", checked_rows(), ids=lambda row: row["key"])
def test_our_value_is_the_configurations(row: dict[str, str]) -> None:
    match = _KEY.fullmatch(row["key"])
    assert match, f"{row['key']} should be `pipeline [group=option ...] key`"
    pipeline, overrides, key = match["pipeline"], match["overrides"].split(), match["key"]
    (ours,) = _VALUE.findall(row["ours"])
    assert composed(pipeline, overrides, key) == yaml.safe_load(ours)
    if "scale=paper" in row["why"]:
        (theirs,) = _VALUE.findall(row["paper"])
        assert composed(pipeline, [*overrides, "scale=paper"], key) == yaml.safe_load(theirs)
