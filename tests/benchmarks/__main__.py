"""Speed of the parts on this machine: ``python -m tests.benchmarks [section ...]``, or ``make bench``.

The section box2d counts successes in another simulator instead.

Everything is measured against a reference in the same run, interleaved: the engine's raw loop, or the alternative that
a user would choose. The tables show median times, the median of the ratios, and the ratio of the least times, which
other load on the machine affects least. One thread is timed in CPU time, several processes in wall time. Each section
runs in a separate process and reports its peak memory.
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
    parser.add_argument("--quick", action="store_true", help="few repetitions, to check that it works")
    parser.add_argument(
        "--instances", type=int, help="task instances per number of objects, for rrt, rrt_ompl and box2d"
    )
    parser.add_argument("--time-limit", type=float, metavar="S", help="of a search, for rrt and rrt_ompl [s]")
    options = parser.parse_args()
    unknown = [name for name in options.sections if name not in SECTIONS]
    if unknown:
        parser.error(f"unknown section {', '.join(unknown)}; there are {', '.join(SECTIONS)}")
    effort = QUICK if options.quick else FULL
    if options.instances is not None:
        effort = replace(effort, instances=options.instances)
    if options.time_limit is not None:
        effort = replace(effort, time_limit_s=options.time_limit)
    succeeded = [run_apart(name, effort) for name in options.sections or SECTIONS]
    return 0 if all(succeeded) else 1


if __name__ == "__main__":
    sys.exit(main())
