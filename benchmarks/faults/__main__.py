"""Run the benchmark `benchmarks.faults`."""

import argparse
from concurrent.futures import ProcessPoolExecutor
from math import ceil
from pathlib import Path

import numpy as np
from rich.progress import track

import benchmarks.faults as about
from benchmarks.faults.cases import PAYLOADS, STRANGERS
from benchmarks.faults.report import markdown, save
from benchmarks.faults.runs import SEED, Job, fault_jobs, row, sound_jobs

SEEDS, SOUND_SEEDS = 1, 5  # of each run with and without a fault: over three hours of sound motion


def jobs(share: float = 1.0, strangers: bool = False) -> list[Job]:
    """Return a `share` of all runs on our own plants, or on strangers, chosen at random."""
    random, chosen, seeds = np.random.default_rng(0), [], range(SEED, SEED + SEEDS)
    if strangers:
        faulty, sound = fault_jobs(seeds, STRANGERS), sound_jobs(seeds, STRANGERS, PAYLOADS)
    else:
        faulty, sound = fault_jobs(seeds), sound_jobs(range(SEED, SEED + SOUND_SEEDS))
    for some in map(list, (faulty, sound)):
        order = random.permutation(len(some))[: ceil(share * len(some))]
        chosen += [some[i] for i in order]
    return sorted(chosen, key=lambda job: job.model)  # a process compiles a controller for each model


def once(strangers: bool = False) -> list[Job]:
    """Return a run of each fault, and of each trajectory without one."""
    return list({job.fault or job.trajectory: job for job in jobs(strangers=strangers)}.values())


def main() -> None:
    parser = argparse.ArgumentParser(description=about.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "results")
    parser.add_argument("--quick", action="store_true", help="one run of each fault, and of each trajectory without")
    parser.add_argument("--share", type=float, default=1.0, help="of all runs, chosen at random, to be made")
    parser.add_argument("--plants", choices=["own", "strangers"], default="own", help="plants under test")
    parser.add_argument("--processes", type=int, default=2)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    strangers, name = given.plants == "strangers", "faults" + "_strangers" * (given.plants == "strangers")
    wanted = once(strangers) if given.quick else jobs(given.share, strangers)
    with ProcessPoolExecutor(given.processes) as pool:
        rows = list(track(pool.map(row, wanted, chunksize=4), description="runs", total=len(wanted)))
    save(rows, given.out / f"{name}.csv")
    text = "\n".join(markdown(rows, len(jobs(strangers=strangers))))
    (given.out / f"{name}.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
