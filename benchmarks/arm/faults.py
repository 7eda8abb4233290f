"""Faults of two joints: delays and names of the diagnosis, and the loop's survival of sensor faults.

    python -m benchmarks.arm.faults [--seeds 2] [--out benchmarks/results]

arm26 on MuJoCo follows circle and reach with 5 % force error, 20 ms dead time, encoder steps of 0.02° and pressure
noise of 0.02 bar. The faults are those of `benchmarks.faults`, at the first joint, its muscles and a biarticular one,
each from 2 s on; sound runs have unmodelled loads of 0, 1, -2 and 3 N·m from then on. A name is right if the fault is
the only suspect a second after the alarm, "group" if it is one of several, "part" if another fault of the same muscle
or joint is suspected, else wrong. The worst error is that from the onset on. A jump of an encoder for 50 ms is bridged
by the prediction without an alarm, which takes 0.1 s of lost readings.
"""

import argparse
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from allocator.units import BAR, DEG
from benchmarks.arm.cases import DEAD_TIME, DT, plant, rough_plant
from mpc.model.arm.model import Arm
from mpc.model.compensation import Compensation
from mpc.model.faults import (
    BrokenCable,
    DriftingSensor,
    Fault,
    FrozenSensors,
    Leak,
    SilentSensors,
    StuckValve,
    SupplyDrop,
    WrongReadings,
)
from mpc.observer.filter import CALM_NOISE
from mpc.observer.health import FaultKind, Health, Part
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.cost import CALM
from mpc.trials.motions.arm_trajectories import REFERENCES
from mpc.trials.simulation import in_motion, simulate

NAME = "arm_faults"
ONSET, LASTS, NAMED_AFTER = 2.0, 3.0, 1.0  # [s]
MOVED, LOADS = ("circle", "reach"), (0.0, 1.0, -2.0, 3.0)  # [N·m]
VERDICTS = "right", "group", "part", "wrong"
_MANY: dict[str, Any] = {"joints": 2, "muscles": 6}
_P = 4  # first pressure among the sensors (q, ω, P)


class Case(NamedTuple):
    """Fault with its onset [s], its expected name, and a flag for pure sensor faults."""

    begun: Callable[[float], Fault]
    kind: FaultKind
    part: str
    of_sensor: bool = False


def cases(arm: Arm) -> dict[str, Case]:
    """Return the faults by name."""
    muscles, joints = arm.mechanism.muscle_names, arm.mechanism.joint_names
    found: dict[str, Case] = {}
    for j in (0, 1, 4):
        name, number = muscles[j], j + 1
        of, pressure = {"muscle": number} | _MANY, f"pressure of {name}"
        found |= {
            f"leak, {name}": Case(lambda t, of=of: Leak(t, **of), FaultKind.LEAK, name),
            f"burst, {name}": Case(lambda t, of=of: Leak(t, kept=0.5, **of), FaultKind.LEAK, name),
            f"stuck valve, {name}": Case(lambda t, of=of: StuckValve(t, **of), FaultKind.STUCK_VALVE, name),
            f"broken cable, {name}": Case(lambda t, of=of: BrokenCable(t, **of), FaultKind.BROKEN_CABLE, name),
        }
        for rate in (0.1, -0.3):
            drift = {"sensor": _P + j, "rate": rate * BAR} | _MANY
            found[f"drift of {rate:+g} bar/s, {pressure}"] = Case(
                lambda t, drift=drift: DriftingSensor(t, **drift), FaultKind.DRIFTING_SENSOR, pressure, True
            )
    angle, first = f"angle of {joints[0]}", f"pressure of {muscles[0]}"
    for place, part in ((0, angle), (_P, first)):
        one = {"sensors": (place,)} | _MANY
        found |= {
            f"silent, {part}": Case(lambda t, one=one: SilentSensors(t, **one), FaultKind.SILENT_SENSOR, part, True),
            f"frozen, {part}": Case(lambda t, one=one: FrozenSensors(t, **one), FaultKind.FROZEN_SENSOR, part, True),
        }
    drift = {"sensor": 0, "rate": 20 * DEG} | _MANY
    blink = {"sensors": (0,), "value": 0.5, "added": True} | _MANY
    return found | {
        f"drift of 20°/s, {angle}": Case(
            lambda t: DriftingSensor(t, **drift), FaultKind.DRIFTING_SENSOR, angle, True
        ),
        f"0.5 rad off for 50 ms, {angle}": Case(
            lambda t: WrongReadings(t, t + 0.05, **blink), FaultKind.REJECTED_SENSOR, angle, True
        ),
        "supply at 2 bar": Case(
            lambda t: SupplyDrop(t, supply=2 * BAR, **_MANY), FaultKind.SUPPLY_DROP, Part.SUPPLY
        ),
    }  # fmt: skip


class Row(NamedTuple):
    """Outcome of a run; NaN without a suspicion."""

    fault: str  # "" of a sound run
    trajectory: str
    seed: int
    load: float  # [N·m] at the first joint, of a sound run
    early: str  # first alarm before the onset, or of a sound run
    delay: float  # [s]
    verdict: str  # of `VERDICTS`, "" without an alarm
    said: str
    worst: float  # |θ - θ*| [°] from the onset on
    held: bool  # whether all commands and the motion were finite


@cache
def _loop() -> tuple[Arm, TrackingMPC, KalmanObserver]:
    arm = Arm.machine("arm26")
    known = Compensation(dead_time=DEAD_TIME, lag_up=arm.lags[0], lag_down=arm.lags[0])  # measured ones
    return arm, TrackingMPC(arm, weights=CALM, compensation=known), KalmanObserver(arm, DT, CALM_NOISE, known)


def row(job: tuple[str, str, int, float]) -> Row:
    """Run a trajectory with a fault and judge the diagnosis."""
    fault, trajectory, seed, load = job
    arm, controller, observer = _loop()
    case = cases(arm).get(fault)
    asked, said = REFERENCES[trajectory](arm), []
    rough = rough_plant(arm, seed)
    effects = {"force_gains": rough.pneumatics.force_gains, "dead_time": DEAD_TIME}
    sensors = {"encoder": rough.sensors.encoder, "pressure_noise": rough.sensors.pressure_noise}
    tested = plant(arm, faults=() if case is None else (case.begun(ONSET),), **effects, **sensors)
    kept = asked.t <= ONSET + LASTS
    asked = type(asked)(asked.t[kept], asked.theta[kept], asked.K[kept])
    run = simulate(
        tested, controller, asked, x0=in_motion(arm, asked), observer=observer, seed=seed,
        watch=lambda: said.append(observer.health), load=lambda t: np.array([load * (t >= ONSET), 0.0]),
    )  # fmt: skip
    onset = round(ONSET / DT) if case else len(said)
    early = next((str(health) for health in said[:onset] if not health.well), "")
    worst = float(np.abs((run.theta - run.theta_ref) / DEG)[round(ONSET / DT) :].max())
    held = bool(np.isfinite(run.u).all() and np.isfinite(run.x).all())
    alarm = next((k for k in range(onset, len(said)) if not said[k].well), None)
    if case is None or alarm is None:
        return Row(*job, early, np.nan, "", "", worst, held)
    later = [health for health in said[alarm : alarm + round(NAMED_AFTER / DT) + 1] if not health.well][-1]
    return Row(*job, early, (alarm - onset) * DT, _verdict(case, later), str(later), worst, held)


def _verdict(case: Case, health: Health) -> str:
    named = [suspect for suspect in health.suspects if (suspect.fault, suspect.part) == (case.kind, case.part)]
    if not named:
        near = case.part.split(" of ")[-1]
        return "part" if any(near in suspect.part for suspect in health.suspects) else "wrong"
    return "right" if len(health.suspects) == 1 else "group"


def markdown(rows: list[Row]) -> Iterator[str]:
    """Yield the lines of the report."""
    yield "# Faults of two joints"
    yield ""
    yield (__doc__ or "").partition("\n\n")[2].strip("\n")
    yield ""
    faulty, sound = [one for one in rows if one.fault], [one for one in rows if not one.fault]
    detected = [one for one in faulty if one.verdict]
    counts = {name: sum(one.verdict == name for one in detected) for name in VERDICTS}
    yield f"Detected: {len(detected)} of {len(faulty)} runs; names {counts}. Alarms in {len(sound)} sound runs: " \
          f"{sum(bool(one.early) for one in sound)}; before an onset: {sum(bool(one.early) for one in faulty)}. " \
          f"Runs whose commands and motion stayed finite: {sum(one.held for one in rows)} of {len(rows)}."  # fmt: skip
    yield ""
    yield (
        "| fault | runs | detected | delay, median / worst [s] | "
        + " / ".join(VERDICTS)
        + " | worst error [°] | said |"
    )
    yield "|---|--:|--:|--:|--:|--:|---|"
    for name in dict.fromkeys(one.fault for one in faulty):
        own = [one for one in faulty if one.fault == name]
        seen = [one for one in own if one.verdict]
        delays = [one.delay for one in seen]
        delay = f"{np.median(delays):.2f} / {max(delays):.2f}" if seen else ""
        verdicts = " / ".join(str(sum(one.verdict == v for one in seen)) for v in VERDICTS)
        said = "; ".join(dict.fromkeys(_plain(one.said) for one in seen))
        worst = max(one.worst for one in own)
        yield f"| {name} | {len(own)} | {len(seen)} | {delay} | {verdicts} | {worst:.1f} | {said} |"
    yield ""
    yield from (
        f"* Early: {one.fault or 'sound'}, {one.trajectory}, seed {one.seed}, {one.load:g} N·m: {one.early}"
        for one in rows
        if one.early
    )


def _plain(said: str) -> str:
    return "; ".join(part.partition(" since")[0] for part in said.partition(":")[0].split("; "))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--only", default="", help="part of a fault's name")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "results")
    given = parser.parse_args()
    names = [name for name in cases(Arm.machine("arm26")) if given.only in name]
    seeds = range(1, 1 + given.seeds)
    jobs = [*product([""], MOVED, seeds, LOADS), *product(names, MOVED, seeds, [0.0])]
    with ProcessPoolExecutor(given.processes) as pool:
        rows = []
        for found in pool.map(row, jobs):
            rows.append(found)
            early = f"EARLY {found.early}" if found.early else ""
            print(*found[:4], f"{found.delay:.2f}", found.verdict, f"{found.worst:.1f}°", found.said, early, flush=True)
    text = "\n".join(markdown(rows)) + "\n"
    given.out.mkdir(parents=True, exist_ok=True)
    (given.out / f"{NAME}.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
