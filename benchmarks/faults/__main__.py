"""Run the benchmark `benchmarks.faults`."""

import argparse
from concurrent.futures import ProcessPoolExecutor
from math import ceil
from pathlib import Path

import numpy as np
from rich.progress import track

import benchmarks.faults as about
from benchmarks.faults.report import markdown, save
from benchmarks.faults.runs import SEED, Job, fault_jobs, row, sound_jobs

SEEDS, SOUND_SEEDS = 1, 5  # of each run with and without a fault: over three hours of sound motion


def jobs(share: float = 1.0) -> list[Job]:
    """Return a `share` of all runs, chosen at random."""
    random, chosen = np.random.default_rng(0), []
    faulty = fault_jobs(range(SEED, SEED + SEEDS))
    sound = sound_jobs(range(SEED, SEED + SOUND_SEEDS))
    for some in map(list, (faulty, sound)):
        order = random.permutation(len(some))[: ceil(share * len(some))]
        chosen += [some[i] for i in order]
    return chosen


def once() -> list[Job]:
    """Return a run of each fault, and of each trajectory without one."""
    return list({job.fault or job.trajectory: job for job in jobs()}.values())


def main() -> None:
    parser = argparse.ArgumentParser(description=about.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "results")
    parser.add_argument("--quick", action="store_true", help="one run of each fault, and of each trajectory without")
    parser.add_argument("--share", type=float, default=1.0, help="of all runs, chosen at random, to be made")
    parser.add_argument("--processes", type=int, default=2)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    wanted = once() if given.quick else jobs(given.share)
    with ProcessPoolExecutor(given.processes) as pool:
        rows = list(track(pool.map(row, wanted, chunksize=4), description="runs", total=len(wanted)))
    save(rows, given.out / "faults.csv")
    text = "\n".join(markdown(rows, len(jobs())))
    (given.out / "faults.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
