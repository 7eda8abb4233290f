"""Comparison of controllers on joints that the library does not model.

    python -m benchmarks.strangers [--seeds 5] [--controllers mpc,lqr] [--models 'data sheet,identified']
    python -m benchmarks.strangers --ages [--seeds 3]
    python -m benchmarks.strangers --payloads [--seeds 2]
    python -m benchmarks.strangers --bounds [--seeds 2]

Each of the four structures of `benchmarks.strangers.plants` is drawn with as many seeds. All controllers get the same
model, either from data sheets or from `fit_joint` and `fit_motion` on logs of the stranger; their observers estimate
sensor offsets. Where they are tuned, each was tuned for the identified model by `antagonist tune` with one budget. A
payload of 1 N·m with its inertia is attached in mid-run. Figures are medians over all strangers: RMS errors of the
angle before the payload and with it, and of the stiffness. For the rest they include the mean error and the swing, peak
to peak, in the last second.
"""

import argparse
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from types import ModuleType

import numpy as np

from allocator.presentation.progress import counted
from benchmarks.strangers import ages, bounds, payloads
from benchmarks.strangers.plants import REPORTING, STRUCTURES
from benchmarks.strangers.runs import CASES, CONTROLLERS, MODELS, Row, rows_of

PARTS = {"payloads": payloads, "bounds": bounds}


def table(rows: list[Row], model: str, controllers: Iterable[str]) -> list[str]:
    """Return the medians over all strangers as lines of Markdown."""
    lines = [f"| trajectory | {' | '.join(controllers)} |", f"|---{'|---' * len(tuple(controllers))}|"]
    for case in CASES:
        cells = []
        for name in controllers:
            mine = [r.figures for r in rows if (r.model, r.controller, r.case) == (model, name, case)]
            thrown = sum(f.unstable for f in mine)
            before, after, standing, swing, K_rms, _ = np.median(mine, axis=0)
            rest = f"; stays {standing:.2f}, swings {swing:.2f}" if case == "rest" else ""
            cells.append(
                f"{before:.2f} / {after:.2f}{rest}; K {K_rms:.2f}" + (f" ({thrown} unstable)" if thrown else "")
            )
        lines.append(f"| {case} | {' | '.join(cells)} |")
    return lines


def report(rows: list[Row], models: tuple[str, ...], controllers: tuple[str, ...]) -> str:
    """Return the whole report."""
    text = (__doc__ or "").split("\n\n", 2)[2].strip()
    lines = ["# Joints that the library does not model", "", text, ""]
    lines += [f"Strangers: {len({(r.structure, r.seed) for r in rows})}. Errors in degrees, K in N·m/rad.", ""]
    for model in models:
        lines += [f"## Model: {model}", "", *table(rows, model, controllers), ""]
    lines += ["## By structure", "", "RMS error of the sine before / with the payload.", ""]
    lines += [f"| structure | model | {' | '.join(controllers)} |", f"|---|---{'|---' * len(controllers)}|"]
    for structure, model in product(STRUCTURES, models):
        cells = []
        for name in controllers:
            mine = [r.figures for r in rows if r[:1] + r[2:5] == (structure, model, name, "sine")]
            cells.append("{:.2f} / {:.2f}".format(*np.median(mine, axis=0)[:2]))
        lines.append(f"| {structure} | {model} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def ages_report(seeds: range, pool: ProcessPoolExecutor) -> str:
    """Return the report on readings that are older than told."""
    plants = [*product(STRUCTURES, seeds), (ages.OWN, 0)]
    jobs = [pool.submit(ages.aged_rows, *plant, age) for plant, age in product(plants, ages.AGES)]
    found = [row for job in counted(jobs, "ages") for row in job.result()]
    rows = sorted(found, key=lambda row: ([*STRUCTURES, ages.OWN].index(row.structure), row.age))
    lines = ["# Readings that are older than told", "", (ages.__doc__ or "").split("\n\n", 1)[1].strip(), ""]
    lines += [f"Seeds of each structure: {', '.join(map(str, seeds))}. Model of data sheets. Errors in degrees.", ""]
    return "\n".join([*lines, *ages.ages_table(rows)]) + "\n"


def part_report(part: ModuleType, seeds: range, pool: ProcessPoolExecutor) -> str:
    """Return the report of one of the `PARTS`, with a job for each stranger."""
    jobs = [pool.submit(part.rows_of, *one) for one in product(STRUCTURES, seeds)]
    rows = [row for job in counted(jobs, "strangers") for row in job.result()]
    lines = [f"# {part.TITLE}", "", (part.__doc__ or "").partition("\n\n")[2].strip(), ""]
    lines += [f"Seeds of each structure: {', '.join(map(str, seeds))}. Errors in degrees.", ""]
    return "\n".join([*lines, *part.table(rows)]) + "\n"


def main() -> None:
    """Run the benchmark and write the report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5, help="strangers per structure")
    parser.add_argument("--first", type=int, default=REPORTING, help="the first seed; from 1000 on they are for tuning")
    parser.add_argument("--controllers", default=",".join(CONTROLLERS))
    parser.add_argument(
        "--models",
        default=",".join(MODELS),
        help="models of the controllers; tuning takes five minutes per stranger",
    )
    parser.add_argument("--ages", action="store_true", help="readings that are older than told, instead")
    for part, module in PARTS.items():
        parser.add_argument(f"--{part}", action="store_true", help=f"instead: {module.TITLE}")
    parser.add_argument("--out", type=Path, help="file to write; else in benchmarks/results")
    asked = parser.parse_args()
    name = next((part for part in ("ages", *PARTS) if getattr(asked, part)), "strangers")
    out = asked.out or Path(__file__).parents[1] / "results" / f"{name}.md"
    controllers = tuple(asked.controllers.split(","))
    models = tuple(asked.models.split(","))
    seeds = range(asked.first, asked.first + asked.seeds)
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        if name != "strangers":
            text = ages_report(seeds, pool) if asked.ages else part_report(PARTS[name], seeds, pool)
            out.write_text(text, encoding="utf-8")
            return
        jobs = [pool.submit(rows_of, *one, models, controllers) for one in product(STRUCTURES, seeds)]
        rows = [row for job in counted(jobs, "strangers") for row in job.result()]
    out.write_text(report(rows, models, controllers), encoding="utf-8")
    print(out.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
