"""Controllers against each other on joints that are not what their model says.

    python -m benchmarks.closed_loop [--seeds 6] [--processes 1] [--out benchmarks/results]

Every controller gets the same model (Sarosi's muscles, nominal), the same knowledge of dead time, dead band and 75 % of
the friction, the same shaped and previewed references and the same limits; one tuning for everything. The friction that
is told has the form of the plant's (Dahl's, with the same presliding), so that the plant without it matters as well.
The load of 1 N·m that nobody tells them of comes half-way (in the stiffness step: at 0.5 s). Written are
`closed_loop.csv` (every run) and `closed_loop.md` (medians over the seeds, against what was asked for). Angle errors
count from the end of the first rest, in which the loop settles, to the load; "with load" to the end of the run.
"""

import argparse
import csv
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from allocator.units import BAR, DEG
from mpc import Reference, Run, Weights, simulate
from mpc.friction import Friction
from mpc.loops import CONTROLLERS, Settings, loop
from mpc.metrics import metrics
from mpc.observer import Observer
from mpc.reality import RealPlant
from mpc.simulation import Controller
from mpc.trajectories import LEAD, chirp, point_to_point, rested_sine, steps, stiffness_step

SEEDS = 11  # the first; tuning used others
LOAD = 1.0  # [N·m]
STANDARD = RealPlant.standard()
MODEL = STANDARD.nominal
SETTINGS = Settings(MODEL, compensation=STANDARD.known(), weights=Weights.calm())
STEADY = 1.0  # [s] at the end of a run, where the reference rests


class Case(NamedTuple):
    """A trajectory, and what of it counts."""

    reference: Reference
    load_from: float  # [s]
    before_load: bool = True  # errors count up to the load; else to the end


CASES = {
    "sine": Case(rested_sine(), 9.0),
    "min-jerk": Case(point_to_point(), 7.0),
    "chirp": Case(chirp(), 9.0),
    "steps": Case(steps(), LEAD + 4.8),
    "stiffness step": Case(stiffness_step(), 0.5, before_load=False),
}

PLANTS = {
    "standard": STANDARD,
    "gains swapped": RealPlant.standard((0.9, 1.1)),
    "both +10 %": RealPlant.standard((1.1, 1.1)),
}
VARIANTS = {  # of plant and horizon, with the tuning and the knowledge left as they are
    "friction removed": (replace(STANDARD, friction=Friction()), 20),
    "lag 0.10 s": (replace(STANDARD, nominal=replace(MODEL, lag=0.10)), 20),
    "lag 0.15 s": (replace(STANDARD, nominal=replace(MODEL, lag=0.15)), 20),
    "N = 15": (STANDARD, 15),
    "N = 40": (STANDARD, 40),
}
ALONE = {
    "nominal": RealPlant(MODEL),
    "gain errors alone": RealPlant(MODEL, force_gains=(1.1, 0.9)),
    "hysteresis alone": RealPlant(MODEL, friction=STANDARD.friction),
    "dead time alone": RealPlant(MODEL, dead_time=0.03),
    "dead band alone": RealPlant(MODEL, dead_band=0.1 * BAR),
    "sensors alone": RealPlant(MODEL, encoder=STANDARD.encoder, pressure_noise=STANDARD.pressure_noise),
}


@dataclass(frozen=True)
class Figures:
    """What is read off a run."""

    rms: float  # [°]
    worst: float  # [°]
    rms_with_load: float  # [°]
    worst_with_load: float  # [°]
    K_rms: float  # [N·m/rad], of the true stiffness, without the first rest
    steady_mean: float  # [°] size of the mean error in the last second
    steady_swing: float  # [°] peak to peak there
    limits_exceeded: int  # how many limits were broken, of `Metrics.violations` without the slack muscle
    slack: float  # [N] by which a muscle was slack at worst
    step_median: float  # [ms]
    step_p99: float  # [ms]
    fallbacks: int  # steps of the MPC that did not end with a QP


def run_case(plant: RealPlant, case: Case, controller: Controller, observer: Observer, seed: int) -> Run:
    loaded = replace(plant, torque_profile=((case.load_from, LOAD),))
    return simulate(loaded, controller, case.reference, observer=observer, seed=seed)


def figures(name: str, run: Run) -> Figures:
    case, m = CASES[name], metrics(run)
    begin = round(LEAD / run.dt)
    end = round(case.load_from / run.dt) if case.before_load else run.t.size
    error = (run.theta - run.theta_ref) / DEG
    last = error[-round(STEADY / run.dt) :]
    broken = [limit for limit, (excess, _) in m.violations.items() if excess and limit != "slack muscle"]
    return Figures(
        *rms_and_worst(error[begin:end]),
        *rms_and_worst(error[begin:]),
        rms_and_worst((run.K - run.K_ref)[begin:])[0],
        abs(float(last.mean())),
        float(np.ptp(last)),
        len(broken),
        m.violations["slack muscle"][0],
        m.step_median,
        m.step_p99,
        sum(m.rungs.values()) - m.rungs["QP"],
    )


def rms_and_worst(error: np.ndarray) -> tuple[float, float]:
    return float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())


class Row(NamedTuple):
    """One run."""

    plant: str
    case: str
    controller: str
    seed: int
    figures: Figures


class Job(NamedTuple):
    """Runs of one controller on one plant."""

    plant: str
    real: RealPlant
    N: int
    controller: str
    cases: tuple[str, ...]
    seeds: range


def jobs(seeds: range) -> Iterator[Job]:
    """The three plants with all controllers, trajectories and seeds; the others with MPC, PID and few of both."""
    for name, plant in PLANTS.items():
        yield from (Job(name, plant, 20, c, tuple(CASES), seeds) for c in CONTROLLERS)
    for name, (plant, N) in (VARIANTS | {name: (plant, 20) for name, plant in ALONE.items()}).items():
        yield from (Job(name, plant, N, c, ("sine", "min-jerk"), seeds[:2]) for c in ("mpc", "pid"))


def rows(job: Job) -> list[Row]:
    """The runs of a job; the controller is built once."""
    built = loop(job.controller, SETTINGS._replace(N=job.N))
    return [
        Row(job.plant, case, job.controller, seed, figures(case, run_case(job.real, CASES[case], *built, seed)))
        for case in job.cases
        for seed in job.seeds
    ]


def median(rows: list[Row], plant: str, case: str, controller: str, figure: str) -> float:
    chosen = [getattr(r.figures, figure) for r in rows if (r.plant, r.case, r.controller) == (plant, case, controller)]
    return float(np.median(chosen))


ASKED = [  # quantity, case, figure, unit, must, stretch
    ("sine, RMS before the load", "sine", "rms", "°", 0.8, 0.5),
    ("sine, worst before the load", "sine", "worst", "°", 2.5, 1.7),
    ("min-jerk, RMS", "min-jerk", "rms", "°", 0.55, 0.4),
    ("min-jerk, worst", "min-jerk", "worst", "°", 2.1, 1.3),
    ("chirp, RMS", "chirp", "rms", "°", 0.45, 0.35),
    ("θ deviation during the K step, worst", "stiffness step", "worst", "°", 1.2, 0.7),
    ("true K, RMS on the sine", "sine", "K_rms", "N·m/rad", 0.15, 0.10),
    ("mean steady error under the load", "steps", "steady_mean", "°", 0.05, 0.03),
    ("steady error, peak to peak", "steps", "steady_swing", "°", 0.3, 0.15),
]


def verdict(value: float, must: float, stretch: float) -> str:
    return "stretch" if value <= stretch else "must" if value <= must else "**no**"  # NaN meets nothing


def asked_table(rows: list[Row], plant: str) -> Iterator[str]:
    yield f"## Plant: {plant}\n"
    yield "| quantity | must | stretch | " + " | ".join(CONTROLLERS) + " | MPC meets |"
    yield "|---" * (4 + len(CONTROLLERS)) + "|"
    for quantity, case, figure, unit, must, stretch in ASKED:
        values = [median(rows, plant, case, c, figure) for c in CONTROLLERS]
        cells = " | ".join(f"{v:.3g}" for v in values)
        judged = "not asked" if figure == "K_rms" and plant == "both +10 %" else verdict(values[0], must, stretch)
        yield f"| {quantity} [{unit}] | {must} | {stretch} | {cells} | {judged} |"
    ratios = [
        median(rows, plant, case, "mpc", "rms") / median(rows, plant, case, "pid", "rms")
        for case in ("sine", "min-jerk", "chirp", "stiffness step")
    ]
    ratio = float(np.median(ratios))
    yield (
        f"| median MPC/PID over sine, min-jerk, chirp, K step | 0.8 | 0.6 | {ratio:.3g} |"
        + " |" * (len(CONTROLLERS) - 1)
        + f" {verdict(ratio, 0.8, 0.6)} |"
    )
    for quantity, figure in (("runs with a limit exceeded", "limits_exceeded"), ("runs with a slack muscle", "slack")):
        counts = [
            sum(getattr(r.figures, figure) > 0 for r in rows if (r.plant, r.controller) == (plant, c))
            for c in CONTROLLERS
        ]
        yield f"| {quantity} | 0 | 0 | " + " | ".join(map(str, counts)) + f" | {verdict(counts[0], 0, 0)} |"
    yield ""


def defeats(rows: list[Row]) -> Iterator[str]:
    yield "## Where the MPC does not win\n"
    for plant in PLANTS:
        for quantity, case, figure, unit, *_ in ASKED:
            values = {c: median(rows, plant, case, c, figure) for c in CONTROLLERS}
            best = min(values, key=lambda c: values[c])
            if best != "mpc":
                yield f"* {plant}: {quantity}: {best} {values[best]:.3g} {unit}, MPC {values['mpc']:.3g} {unit}"
    yield ""


def every_case_table(rows: list[Row]) -> Iterator[str]:
    yield "## Every plant and trajectory: RMS / worst angle error before the load [°] (with it), K RMS [N·m/rad]\n"
    yield "| plant | trajectory | " + " | ".join(CONTROLLERS) + " |"
    yield "|---" * (2 + len(CONTROLLERS)) + "|"
    for plant, case in dict.fromkeys((r.plant, r.case) for r in rows):
        there = {r.controller for r in rows if (r.plant, r.case) == (plant, case)}
        cells = [cell(rows, plant, case, c) if c in there else "" for c in CONTROLLERS]
        yield f"| {plant} | {case} | " + " | ".join(cells) + " |"
    yield ""


def cell(rows: list[Row], plant: str, case: str, controller: str) -> str:
    names = ("rms", "worst", "rms_with_load", "worst_with_load", "K_rms")
    a, b, c, d, K = (median(rows, plant, case, controller, name) for name in names)
    return f"{a:.2f} / {b:.2f} ({c:.2f} / {d:.2f}), {K:.3f}"


def markdown(rows: list[Row], seeds: range) -> Iterator[str]:
    assert __doc__ is not None
    yield "# " + __doc__.splitlines()[0].removesuffix(".") + "\n"
    yield __doc__.partition("\n\n")[2].partition("\n\n")[2]
    yield f"Medians over {len(seeds)} seeds (variants of the standard plant and single effects: {len(seeds[:2])}).\n"
    for plant in PLANTS:
        yield from asked_table(rows, plant)
    yield from defeats(rows)
    yield from every_case_table(rows)
    times = [median(rows, "standard", "sine", c, t) for c in CONTROLLERS for t in ("step_median", "step_p99")]
    yield "Time of a step on the sine, median / 99th percentile [ms]: " + ", ".join(
        f"{c} {a:.2f} / {b:.2f}" for c, a, b in zip(CONTROLLERS, times[::2], times[1::2], strict=True)
    )
    fallbacks = sum(r.figures.fallbacks for r in rows if r.controller == "mpc")
    yield f"\nSteps of the MPC that no QP answered: {fallbacks}.\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--processes", type=int, default=1)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    seeds, found = range(SEEDS, SEEDS + given.seeds), []
    with ProcessPoolExecutor(given.processes) as pool:
        for done in pool.map(rows, jobs(seeds)):
            found += done
            print(f"{done[0].plant}, {done[0].controller}: {len(found)} runs", flush=True)
    with (given.out / "closed_loop.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["plant", "case", "controller", "seed", *Figures.__dataclass_fields__])
        writer.writerows([*row[:-1], *(f"{v:.6g}" for v in vars(row.figures).values())] for row in found)
    text = "\n".join(markdown(found, seeds))
    (given.out / "closed_loop.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
