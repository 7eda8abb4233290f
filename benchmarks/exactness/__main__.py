"""Comparison with a dense search: `python -m benchmarks.exactness --help`."""

import argparse
from pathlib import Path

from allocator.presentation.progress import counted
from benchmarks.exactness import report
from benchmarks.exactness.accuracy import Score, scores
from benchmarks.exactness.timing import Time, times
from tests.exact_everywhere.joints import GEOMETRIES, MUSCLES

RESULTS = Path(__file__).parents[1] / "results"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.exactness", description=__doc__.partition(":")[0])
    parser.add_argument("--targets", type=int, default=20_000, help="random ones a joint; half as many are made")
    parser.add_argument("--only", action="append", help="joints with this in 'muscle geometry'; may be repeated")
    parser.add_argument("--no-times", action="store_true", help="measure no times")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the report and the CSV files")
    arguments = parser.parse_args()
    joints = [(muscle, geometry) for muscle in MUSCLES for geometry in GEOMETRIES]
    if arguments.only:
        joints = [names for names in joints if any(part in " ".join(names) for part in arguments.only)]
    if not joints:
        parser.error(f"no joint has {' or '.join(arguments.only)} in its name")
    found: list[Score] = []
    clock: list[Time] = []
    for names in counted(joints, "joints"):
        found += scores(*names, arguments.targets)
        clock += [] if arguments.no_times else times(*names)
    report.write(found, clock, arguments.out)
    for sentence in report.findings(found, clock):
        print(sentence)
    print(f"Written to {arguments.out}: {report.NAME}.md and its CSV files.")
    return 1 if any(score.wrong for score in found) else 0


if __name__ == "__main__":
    raise SystemExit(main())
