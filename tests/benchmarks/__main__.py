"""How fast the parts are on this machine: ``python -m tests.benchmarks [section ...]``, or ``make bench``.

Everything is measured beside a reference in the same run, in turn: the engine's raw loop, or what a user would pick
instead. The tables show median times, the median of the ratios, and the ratio of the least times, which other work on
the machine disturbs least. Work of one thread is timed by the processor's clock, that of several processes by the one
on the wall. Each section runs in a process of its own and says its peak memory.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

from tests.benchmarks.sections import SECTIONS, run_apart
from tests.benchmarks.timing import FULL, QUICK


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sections", nargs="*", metavar="section", help=f"of {', '.join(SECTIONS)}; all by default")
    parser.add_argument("--quick", action="store_true", help="hardly any repetitions: to see that it works")
    parser.add_argument("--instances", type=int, help="task instances a density, for rrt and rrt_beside_ompl")
    parser.add_argument("--time-limit", type=float, metavar="S", help="of a search, for rrt and rrt_beside_ompl [s]")
    options = parser.parse_args()
    unknown = [name for name in options.sections if name not in SECTIONS]
    if unknown:
        parser.error(f"no section {', '.join(unknown)}; there are {', '.join(SECTIONS)}")
    effort = QUICK if options.quick else FULL
    if options.instances is not None:
        effort = replace(effort, instances=options.instances)
    if options.time_limit is not None:
        effort = replace(effort, time_limit_s=options.time_limit)
    went_well = [run_apart(name, effort) for name in options.sections or SECTIONS]
    return 0 if all(went_well) else 1


if __name__ == "__main__":
    sys.exit(main())
