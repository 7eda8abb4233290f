"""Run the measurements: `python -m benchmarks.speed --help`."""

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path

from benchmarks.speed import allocation, processes, report
from benchmarks.speed.clock import Measurement
from benchmarks.speed.steps import step, whole_sample
from benchmarks.speed.truth import BenchmarkFailure

RESULTS = Path(__file__).parents[1] / "results"
# name → function that yields measurements; called with True for the light version
PARTS: dict[str, Callable[[bool], Iterator[Measurement]]] = {
    "allocation": allocation.measure,
    "processes": processes.measure,
    "control": step.measure,
    "sample": whole_sample.measure,
}


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.speed", description="Measure how fast things are.")
    parser.add_argument("--light", action="store_true", help="few rounds")
    parser.add_argument(
        "--floors", action="store_true", help="fail where a ratio is below its floor, on a quiet machine"
    )
    parser.add_argument("--part", choices=PARTS, action="append", help="only this part; may be repeated")
    parser.add_argument("--out", type=Path, help="folder of speed.md and speed.csv; none is written by --light")
    arguments = parser.parse_args()
    found: list[Measurement] = []
    try:
        for part in arguments.part or PARTS:
            for measurement in PARTS[part](arguments.light):
                found.append(measurement)
                print(report.line(measurement), flush=True)
    except BenchmarkFailure as failure:
        print(f"Stopped, nothing written: {failure}")
        return 1
    if folder := arguments.out or (None if arguments.light else RESULTS):
        folder.mkdir(parents=True, exist_ok=True)
        kept = [m for m in report.read(folder) if m.part not in {new.part for new in found}]
        report.write(sorted(kept + found, key=lambda m: list(PARTS).index(m.part)), folder)
    below = [m for m in found if m.below_its_floor]
    for m in below:
        print(f"TOO SLOW: {report.line(m)}")
    return 1 if below and arguments.floors else 0


if __name__ == "__main__":
    raise SystemExit(main())
