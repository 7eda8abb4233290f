"""Parts of the benchmark of felt stiffness: python -m benchmarks.felt PART; each prints its figures."""

import sys
from functools import partial

from benchmarks.felt import allocation, drift, hidden, logs, refusals, strangers

PARTS = {
    "allocation": allocation.report,
    "hidden": partial(hidden.report, n=100, first=180),
    "shaken": partial(hidden.report, n=30, first=180, by=hidden.shaken),
    "inertia": partial(hidden.report, n=30, inertia_error=0.05),
    "logs": partial(logs.report, n=20, first=180),
    "refusals": refusals.report,
    "strangers": partial(strangers.report, n=3, first=180),
    "stranger-logs": partial(strangers.report, n=3, first=180, by=strangers.in_log),
    "identified": partial(strangers.report, n=3, of="identified"),
    "drift": partial(drift.report, n=8),
}


def main(names: list[str]) -> None:
    if len(names) != 1 or names[0] not in PARTS:
        sys.exit(f"usage: python -m benchmarks.felt {{{','.join(PARTS)}}}")
    print(PARTS[names[0]]())  # type: ignore[operator]


if __name__ == "__main__":
    main(sys.argv[1:])
