"""Heavier payloads than one of 1 N·m: errors of the MPC with two observers and of a predictive PID, and who rings.

Models are fitted to the stranger's logs. The observer has the usual noise, or `Noise(omega_walk=4)`, which trusts the
model's motion less; the weights are those of `mpc.robust_weights` for it. RMS errors of the angle are those of the
sine; they are medians over the strangers, before the payload and with it. A loop rings if it swings by more than 4°,
peak to peak, in the last second of the rest. The inertia margins are those on the models.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from allocator.units import DEG
from benchmarks.closed_loop.runs import LEAD, STEADY
from benchmarks.strangers.identified import identified
from benchmarks.strangers.plants import ARM, EARTH, drawn
from benchmarks.strangers.runs import CASES, DT, rms
from mpc import Noise, simulate
from mpc.trials.loops import Settings, loop, robust, sliding_margins

TITLE = "Heavier payloads"
PAYLOADS = 1.0, 2.0  # [N·m]
RINGS = 4.0  # [°]
LOOPS = {"mpc": ("mpc", 0.2), "mpc, omega_walk 4": ("mpc", 4.0), "predictive-pid": ("predictive-pid", 0.2)}


class Carried(NamedTuple):
    """One loop on one stranger with a payload."""

    loop: str
    payload: float  # [N·m]
    inertia: float  # with the payload, over that of the model [-]
    margin: float  # of the inertia [-]
    before: float  # RMS error of the sine before the payload [°]
    after: float  # and with it [°]
    rings: bool  # at rest with it


def rows_of(structure: str, seed: int) -> list[Carried]:
    """Return the runs of one stranger."""
    stranger = drawn(structure, seed)
    model, rows = identified(stranger), []
    for name, (controller, walk) in LOOPS.items():
        settings = Settings(model.plant, DT, compensation=model.told, noise=Noise(omega_walk=walk))
        settings = robust(controller, settings, CASES["sine"].reference)
        margin = sliding_margins(controller, settings)[1].inertia_margin
        control, observer = loop(controller, settings)
        for payload in PAYLOADS:
            errors = {}
            for case in (CASES[of] for of in ("sine", "rest")):
                x0 = model.plant.at_rest(case.reference.theta[0], case.reference.K[0])
                loaded = stranger.loaded(payload, case.loaded)
                run = simulate(loaded, control, case.reference, x0=x0, observer=observer, seed=seed)
                errors[case] = (run.theta - run.theta_ref) / DEG
            sine, rest = errors.values()
            at, last = round(CASES["sine"].loaded / DT), round(STEADY / DT)
            heavier = 1 + payload * ARM / EARTH / model.plant.inertia
            swings = bool(np.ptp(rest[-last:]) > RINGS)
            before = rms(sine[round(LEAD / DT) : at])
            rows.append(Carried(name, payload, heavier, margin, before, rms(sine[at:]), swings))
    return rows


def table(rows: Iterable[Carried]) -> list[str]:
    """Return the medians as lines of Markdown."""
    all_rows = list(rows)
    lines = [
        "| payload [N·m] | loop | inertia, over the model's | its margin | sine before / with it | ring |",
        "|---|---|---|---|---|---|",
    ]
    for payload in PAYLOADS:
        for name in LOOPS:
            mine = [row for row in all_rows if (row.loop, row.payload) == (name, payload)]
            inertia, margin, before, after = np.median([row[2:6] for row in mine], axis=0)
            ring = f"{sum(row.rings for row in mine)} of {len(mine)}"
            lines.append(
                f"| {payload:g} | {name} | {inertia:.1f} | {margin:.1f} | {before:.2f} / {after:.2f} | {ring} |"
            )
    return lines
