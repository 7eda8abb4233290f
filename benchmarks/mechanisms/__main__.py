"""Check and time the allocation for mechanisms: `python -m benchmarks.mechanisms --help`."""

import argparse
import csv
from pathlib import Path

from allocator.allocation import warm_up
from allocator.mechanism import machines
from benchmarks.mechanisms.accuracy import Check, checks
from benchmarks.mechanisms.speed import Time, times

RESULTS = Path(__file__).parents[1] / "results"
NAME = "mechanisms"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mechanisms", description=__doc__.partition(":")[0])
    parser.add_argument("--targets", type=int, default=10_000, help="random ones, half of them beyond reach")
    parser.add_argument("--rounds", type=int, default=9, help="of the times; 0 measures none")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the report and the CSV files")
    arguments = parser.parse_args()
    warm_up(joint=machines.arm26())
    found = []
    for check in checks(arguments.targets):
        found.append(check)
        print(f"{'FAILED' if check.failed else 'ok':6} {check.what}: {check.worst:.2g} of {check.targets} targets")
    clock = times(arguments.rounds) if arguments.rounds else []
    for time in clock:
        print(f"{time.microseconds:9.2f} µs a target  {time.what}, off {time.off:.1g}")
    write(found, clock, arguments.out)
    print(f"Written to {arguments.out}: {NAME}.md and its CSV file.")
    return 1 if any(check.failed for check in found) else 0


def write(found: list[Check], clock: list[Time], out: Path) -> None:
    """Write the report, and the figures as CSV."""
    out.mkdir(parents=True, exist_ok=True)
    with (out / f"{NAME}.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["what", "targets", "worst", "allowed", "microseconds"])
        table.writerows([c.what, c.targets, f"{c.worst:.3g}", f"{c.allowed:g}", ""] for c in found)
        table.writerows([t.what, "", f"{t.off:.3g}", "", f"{t.microseconds:.3f}"] for t in clock)
    lines = [
        "# Mechanisms: optimality and times",
        "",
        f"Written by `python -m benchmarks.mechanisms`; the figures are also in `{NAME}.csv`.",
        "",
        "Half of the targets are made by random taut pressures, half are up to four times such torques with 0.4 to 2.5",
        "times the stiffness. Optimality residuals are fractions of their scale, pressures of the supply. A proof is a",
        "direction d with d·y(P) < d·y* for all pressures of the box, checked outside the package.",
        "",
        "| checked | targets | worst | allowed |",
        "|---|--:|--:|--:|",
        *(f"| {c.what} | {c.targets} | {c.worst:.1e} | {c.allowed:g} |" for c in found),
        "",
        "Times of the processor, the least of the rounds, in one run. *off*: distance of the pressures from the exact",
        "ones, of the supply. Rivals are called from Python, target by target, with all possible preparation. One",
        "QP is w_T : w_K : pressures = 1e4 : 1 : 1e-3 for all; ours does not need the third weight, which is timed",
        "as *weighted, then least pressures*.",
        "",
        "| timed | µs a target | off |",
        "|---|--:|--:|",
        *(f"| {t.what} | {t.microseconds:.2f} | {t.off:.1e} |" for t in clock),
        "",
    ]
    (out / f"{NAME}.md").write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    raise SystemExit(main())
