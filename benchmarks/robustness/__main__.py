"""Wrong readings in closed loops: `python -m benchmarks.robustness --help`."""

import argparse
import shutil
from pathlib import Path

from allocator.presentation.progress import counted
from benchmarks.robustness import report, storm, wraps

RESULTS = Path(__file__).parents[1] / "results"
PARTS, SEED = 10, 2001


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.robustness", description=__doc__.partition(":")[0])
    parser.add_argument("--samples", type=int, default=100_000, help="of the storm")
    parser.add_argument("--laws", nargs="*", choices=wraps.LAWS, default=[*wraps.LAWS], help="for the wrong angles")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the report and its CSV file")
    arguments = parser.parse_args()
    pairs = [(law, controller) for law in arguments.laws for controller in wraps.CONTROLLERS]
    wrongs = [wrong for pair in counted(pairs, "wrong angles") for wrong in wraps.runs(*pair)]
    parts = [*counted(storm.driven(arguments.samples, PARTS, SEED), "storm", PARTS)]
    compared = []
    if shutil.which("gcc"):
        compared = [*counted(storm.compared(arguments.samples, PARTS, SEED), "the same in C", PARTS)]
    report.write(wrongs, parts, compared, arguments.out)
    print((arguments.out / f"{report.NAME}.md").read_text(encoding="utf-8"))
    wrong = any(storm.broken(part.run) for part in parts) or any(pair.differing for pair in compared)
    return int(wrong)


if __name__ == "__main__":
    raise SystemExit(main())
