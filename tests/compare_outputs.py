"""Compare the artefacts of two versions of the code: ``python -m tests.compare_outputs before/outputs after/outputs``.

For changes that should not affect results. Compares, bit for bit, the content hashes of the demonstrations, the weights
of the networks (of format 1 or 2) and all columns of the episodes but times. Exits with 1 if anything differs.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from safetensors.numpy import load_file

TIMES = ("decision_time_s", "mean_decision_time_s", "max_decision_time_s", "simulation_time_s", "execution_time_s")


def demonstrations(before: Path, after: Path) -> Iterator[tuple[str, bool]]:
    for card in sorted(before.glob("generate_demos/*/card.json")):
        name = card.relative_to(before)
        first, second = (json.loads((folder / name).read_text())["content_hash"] for folder in (before, after))
        yield f"{name}: content hash {first[:12]} and {second[:12]}", first == second


def networks(before: Path, after: Path) -> Iterator[tuple[str, bool]]:
    for path in sorted(before.glob("train_*/**/*.safetensors")):
        name = path.relative_to(before)
        first, second = load_file(path), load_file(after / name)
        is_equal = first.keys() == second.keys() and all(np.array_equal(first[key], second[key]) for key in first)
        yield f"{name}: {len(first)} tensors", is_equal


def episodes(before: Path, after: Path, renamed: dict[str, str]) -> Iterator[tuple[str, bool]]:
    name = Path("evaluate/episodes.parquet")
    first, second = (pd.read_parquet(folder / name) for folder in (before, after))
    first["experiment"] = first["experiment"].replace(renamed)
    columns = [column for column in first.columns if column not in TIMES]
    missing = set(first.columns) ^ set(second.columns)
    yield f"{name}: columns {len(first.columns)} and {len(second.columns)}", not missing
    yield f"{name}: rows {len(first)} and {len(second)}", len(first) == len(second)
    if not missing and len(first) == len(second):
        for column in columns:
            is_equal = first[column].equals(second[column])
            yield f"{name}: {len(first)} values of {column}", is_equal


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.compare_outputs", description=__doc__)
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("--renamed", nargs="*", default=[], metavar="OLD=NEW", help="experiments with a new name")
    options = parser.parse_args()
    renamed = dict(entry.split("=") for entry in options.renamed)
    before, after = options.before, options.after
    found = [*demonstrations(before, after), *networks(before, after), *episodes(before, after, renamed)]
    for text, is_equal in found:
        print("equal  " if is_equal else "DIFFERS", text)
    differing = sum(not is_equal for _, is_equal in found)
    print(f"{len(found)} comparisons, {differing} differ")
    return min(differing, 1)


if __name__ == "__main__":
    sys.exit(main())
