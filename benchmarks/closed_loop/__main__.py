"""Run the benchmark `benchmarks.closed_loop`."""

import argparse
import csv
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields
from pathlib import Path

import benchmarks.closed_loop as about
from benchmarks.closed_loop import stiffness
from benchmarks.closed_loop.cases import SEEDS
from benchmarks.closed_loop.report import markdown
from benchmarks.closed_loop.runs import QUICK, RUNGS, Effort, Figures, Row, jobs, rows


def save_rows(found: list[Row], path: Path) -> None:
    """Write one line per run."""
    plain = [f.name for f in fields(Figures) if f.name != "rungs"]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["plant", "case", "controller", "seed", *plain, *(f"steps_{name}" for name in RUNGS)])
        for row in found:
            numbers = (f"{getattr(row.figures, name):.6g}" for name in plain)
            writer.writerow([*row[:-1], *numbers, *row.figures.rungs])


def main() -> None:
    parser = argparse.ArgumentParser(description=about.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "results")
    parser.add_argument("--quick", action="store_true", help="one seed of everything")
    parser.add_argument("--processes", type=int, default=2)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    effort, found, pushed = QUICK if given.quick else Effort(), [], []
    with ProcessPoolExecutor(given.processes) as pool:
        for done in pool.map(rows, jobs(effort, SEEDS)):
            found += done
            print(f"{done[0].plant}, {done[0].controller}: {len(found)} runs", flush=True)
        for experiment in pool.map(stiffness.found, stiffness.experiments(effort.gains)):
            pushed.append(experiment)
    save_rows(found, given.out / "closed_loop.csv")
    stiffness.save(pushed, given.out / "closed_loop_push.csv")
    text = "\n".join([*markdown(found), *stiffness.markdown(pushed)])
    (given.out / "closed_loop.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
