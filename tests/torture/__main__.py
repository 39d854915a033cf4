"""Hostile inputs and surroundings in large numbers: ``python -m tests.torture <part>`` (``make torture`` runs all).

======================= ======================================================================================
part                    what
======================= ======================================================================================
kills                   every stage killed at random moments and file operations
damage                  every file that is read, damaged
scenes                  hostile scene files, distributions and contours
overrides               hostile arguments of the command line
environments            random calls of both environments against a model of their contract
robot                   faults of every device of a robot cell: 0 blind motions (listed as faults)
======================= ======================================================================================
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import time
from typing import Final

DEFAULTS: Final = {
    "kills": 100,
    "damage": 20_000,
    "scenes": 60_000,
    "overrides": 20_000,
    "environments": 100_000,
    "robot": 1_000,
}
FAULTS: Final = ("differences", "tracebacks", "slow", "surprises", "silent", "bad_messages", "long_messages", "faults")
"""Counts that have to be 0. Slow is what takes more than 2 s of the processor, so that other work does not count."""


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.torture", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("parts", nargs="*", metavar="part", help=f"of {', '.join(DEFAULTS)}; all by default")
    parser.add_argument("--cases", type=int, help="number of cases of each part")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    unknown = sorted(set(options.parts) - set(DEFAULTS))
    if unknown:
        parser.error(f"unknown part {unknown[0]}; choose from {', '.join(DEFAULTS)}")
    failed = 0
    for part in options.parts or DEFAULTS:
        module = importlib.import_module(f"tests.torture.{part}")
        begun = time.perf_counter()
        result = module.run(options.cases or DEFAULTS[part], options.seed)
        faults = {name: result[name] for name in FAULTS if result.get(name)}
        print(json.dumps({"part": part, "minutes": round((time.perf_counter() - begun) / 60, 1), **result}), flush=True)
        failed += bool(faults)
    return min(failed, 1)


if __name__ == "__main__":
    sys.exit(main())
