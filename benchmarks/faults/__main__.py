"""Run the benchmark `benchmarks.faults`."""

import argparse
from concurrent.futures import ProcessPoolExecutor
from math import ceil
from pathlib import Path

import numpy as np

import benchmarks.faults as about
from allocator.presentation.progress import counted
from benchmarks.faults.cases import IDENTIFIED, PAYLOADS, STRANGERS
from benchmarks.faults.report import markdown, save
from benchmarks.faults.runs import SEED, Job, fault_jobs, row, sound_jobs

SEEDS, SOUND_SEEDS = 1, 5  # of each run with and without a fault: over three hours of sound motion


PLANTS = {"own": (), "strangers": STRANGERS, "identified": IDENTIFIED}


def jobs(share: float = 1.0, plants: str = "own") -> list[Job]:
    """Return a `share` of the runs on these `PLANTS`, chosen at random; of strangers all that are without a fault."""
    random, chosen, seeds = np.random.default_rng(0), [], range(SEED, SEED + SEEDS)
    if strangers := PLANTS[plants]:
        faulty, sound, of_sound = fault_jobs(seeds, strangers), sound_jobs(seeds, strangers, PAYLOADS), 1.0
    else:
        faulty, sound, of_sound = fault_jobs(seeds), sound_jobs(range(SEED, SEED + SOUND_SEEDS)), share
    for some, part in ((list(faulty), share), (list(sound), of_sound)):
        order = random.permutation(len(some))[: ceil(part * len(some))]
        chosen += [some[i] for i in order]
    return sorted(chosen, key=lambda job: job.model)  # a process compiles a controller for each model


def once(plants: str = "own") -> list[Job]:
    """Return a run of each fault, and of each trajectory without one."""
    return list({job.fault or job.trajectory: job for job in jobs(plants=plants)}.values())


def main() -> None:
    parser = argparse.ArgumentParser(description=about.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "results")
    parser.add_argument("--quick", action="store_true", help="one run of each fault, and of each trajectory without")
    parser.add_argument("--share", type=float, default=1.0, help="of all runs, chosen at random, to be made")
    parser.add_argument("--plants", choices=PLANTS, default="own", help="plants under test")
    parser.add_argument("--processes", type=int, default=2)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    name = "faults" if given.plants == "own" else f"faults_{given.plants}"
    wanted = once(given.plants) if given.quick else jobs(given.share, given.plants)
    with ProcessPoolExecutor(given.processes) as pool:
        rows = list(counted(pool.map(row, wanted, chunksize=4), "runs", len(wanted)))
    save(rows, given.out / f"{name}.csv")
    text = "\n".join(markdown(rows, len(jobs(plants=given.plants))))
    (given.out / f"{name}.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
