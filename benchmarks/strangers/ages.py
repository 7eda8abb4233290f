"""Readings of the angle that are older than told, and the same told: errors, swing, and when health names it.

A stranger's own encoder is told as it is, and then made older. RMS errors of the angle are those of the sine before and
with the payload, the swing is that of the last second of all trajectories, peak to peak; medians over the strangers. A
run is named if `KalmanObserver.health` said that the loop rings; the delay is counted from the first of the swings that
it saw. The weights of the controller are those of `mpc.robust_weights` for its model.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from allocator.units import DEG
from benchmarks.closed_loop.runs import LEAD, STEADY
from benchmarks.strangers.identified import Model, data_sheet
from benchmarks.strangers.plants import Stranger, drawn
from benchmarks.strangers.runs import CASES, DT, PAYLOAD, Case, rms
from mpc import KalmanObserver, RealPlant, simulate
from mpc.trials.loops import Settings, loop, robust

AGES = 0.0, 0.01, 0.02, 0.03, 0.05  # [s] beyond the encoder's own
OWN = "RealPlant"  # the library's plant under test, not a stranger


class Aged(NamedTuple):
    """One run with older readings."""

    structure: str
    seed: int
    age: float  # [s]
    told: bool
    case: str
    before: float  # RMS error before the payload [°]
    after: float  # and with it [°]
    swing: float  # peak to peak in the last second [°]
    named: float  # after which health said that the loop rings [s]; NaN: it never did


def aged_rows(structure: str, seed: int, age: float) -> list[Aged]:
    """Return the runs of one plant with readings that are older by `age` [s], told and untold."""
    return [row for told in ((False, True) if age else (False,)) for row in runs(structure, seed, age, told)]


def runs(structure: str, seed: int, age: float, told: bool, cases: Iterable[str] = CASES) -> list[Aged]:
    """Return the runs of one plant along the `cases`."""
    plant, model = older(structure, seed, age)
    known = replace(model.told, reading_age=model.told.reading_age + age * told)
    control, _ = loop("mpc", robust("mpc", Settings(model.plant, DT, compensation=known)))
    observer, rows = KalmanObserver(model.plant, DT, compensation=known), []
    for name in cases:
        case, delays, k = CASES[name], list[float](), [0]

        def watch(delays: list[float] = delays, k: list[int] = k) -> None:
            k[0] += 1
            if not delays and (finding := observer.health.ringing) is not None:
                delays.append(k[0] * DT - finding.since)

        loaded, x0 = burdened(plant, case), model.plant.at_rest(case.reference.theta[0], case.reference.K[0])
        done = simulate(loaded, control, case.reference, x0=x0, observer=observer, seed=seed, watch=watch)
        error, begin, end = (done.theta - done.theta_ref) / DEG, round(LEAD / DT), round(case.loaded / DT)
        swing, named = float(np.ptp(error[-round(STEADY / DT) :])), delays[0] if delays else np.nan
        rows.append(Aged(structure, seed, age, told, name, rms(error[begin:end]), rms(error[end:]), swing, named))
    return rows


def older(structure: str, seed: int, age: float) -> tuple[Stranger | RealPlant, Model]:
    """Return a plant whose readings are older by `age` [s], and the model that knows its own age."""
    if structure == OWN:
        real = RealPlant.standard()
        return replace(real, reading_age=age), Model(real.nominal, real.known())
    stranger = drawn(structure, seed)
    model = data_sheet(stranger)
    late = stranger.sensors.late
    sensors = replace(stranger.sensors, late=late + round(age / DT))
    return replace(stranger, sensors=sensors), model._replace(told=replace(model.told, reading_age=late * DT))


def burdened(plant: Stranger | RealPlant, case: Case) -> Stranger | RealPlant:
    """Return the plant with the payload of the case."""
    if isinstance(plant, RealPlant):
        return replace(plant, torque_profile=((case.loaded, PAYLOAD),))
    return plant.loaded(PAYLOAD, case.loaded)


def ages_table(rows: Iterable[Aged]) -> list[str]:
    """Return the medians as lines of Markdown."""
    all_rows = list(rows)
    lines = [
        "| plant | age [ms] | untold: sine | swing | named | after [s] | told: sine | swing | named |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for structure, age in dict.fromkeys((row.structure, row.age) for row in all_rows):
        cells: list[str] = []
        for told in (False, bool(age)):
            mine = [r for r in all_rows if (r.structure, r.age, r.told) == (structure, age, told)]
            sine, delays = [r for r in mine if r.case == "sine"], [r.named for r in mine if np.isfinite(r.named)]
            cells += [
                f"{np.median([r.before for r in sine]):.2f} / {np.median([r.after for r in sine]):.2f}",
                f"{np.median([r.swing for r in mine]):.2f}",
                f"{len(delays)} of {len(mine)}",
            ]
            cells += [] if told else [f"{np.median(delays):.2f}" if delays else "-"]
        if not age:
            cells = [*cells[:4], "", "", ""]
        lines.append(f"| {structure} | {1e3 * age:.0f} | {' | '.join(cells)} |")
    return lines
