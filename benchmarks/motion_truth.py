"""Moving joints of known truth are fitted from their logs: how often is the truth inside what is stated?

    python -m benchmarks.motion_truth [--plants 24] [--first 0]

Each plant has another inertia, damping, lag, dead time, dead band, flow limit and hysteresis: Maxwell slip with springs
of its own, an operator of the angle, or Dahl's friction in proportion to the pulls; none has the structure of what is
fitted. Its log is 90 s of random steps of both pressures at 50 Hz, as commanded; every fourth has them as measured. The
joint that the fit is given is right. A loop's true width is the mean over the log, at P1 + P2 = 5 bar. The model error
that `fit_motion` adds to its intervals was set by these plants.
"""

import argparse
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from allocator import BAR, DEG, fit_motion, report_joint
from allocator.calculus import Array
from allocator.identification.motion.result import LABELS, MotionFit
from allocator.joint.hysteresis import PrandtlIshlinskii
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc import Plant, RealPlant
from mpc.model.contact import Contact
from mpc.model.friction import Friction
from mpc.model.hysteresis import MaxwellSlip

JOINT = report_joint(SAROSI_DMSP_20_400N)
STEP, SECONDS = 0.02, 90.0  # [s]
KINDS = ("Maxwell slip", "operator", "Dahl")


class Recorded(NamedTuple):
    """A log, and the plant that wrote it."""

    real: RealPlant
    kind: str
    t: Array  # [s]
    x: Array  # (n, 4), as the sensors say, the commands in the place of the pressures where these were not measured


def made(seed: int) -> Recorded:
    """Make a plant and its log."""
    rng = np.random.default_rng(seed)
    inertia, lag = np.exp(rng.uniform(np.log(0.003), np.log(0.15))), rng.uniform(0.06, 0.2)
    damping = 2 * rng.uniform(0.1, 0.6) * np.sqrt(5.0 * inertia)
    plant = Plant(JOINT, inertia=float(inertia), damping=float(damping), lag=float(lag))
    kind, width = KINDS[seed % len(KINDS)], float(rng.uniform(1.5, 7.0)) * DEG
    measured = seed % 4 == 3
    real = RealPlant(
        plant,
        friction=_friction(kind, plant, width),
        dead_time=float(rng.uniform(0.0, 0.06)),
        dead_band=float(rng.choice([0.0, 0.1, 0.2])) * BAR,
        flow=float(rng.choice([5 * BAR, np.inf])),
        encoder=0.03 * DEG,
        pressure_noise=0.005 * BAR,
    )
    experiment = real.begin(STEP, real.at_rest(0.0, 4.8), seed)
    u, until, rows = np.full(2, 2.5 * BAR), 50, []
    for k in range(round(SECONDS / STEP)):
        if k == until:
            u, until = rng.uniform(1.7, 4.0, 2) * BAR, k + int(rng.uniform(0.5, 1.5) / STEP)
        y = experiment.measure()
        rows.append(y if measured else [*y[:2], *u])
        experiment.advance(u)
    return Recorded(real, kind, STEP * np.arange(len(rows)), np.array(rows))


def _friction(kind: str, plant: Plant, width: float) -> object:
    if kind == "Maxwell slip":
        return MaxwellSlip.of_width(plant, width)
    if kind == "Dahl":
        return Friction.of_width(plant, width, presliding=width / 4)
    weights = np.array([0.5, 0.3, 0.2])
    reach = np.array([0.15, 0.5, 1.2])
    return PrandtlIshlinskii((0.4, *(0.6 * weights)), tuple(reach * width / (1.2 * weights @ reach)), base=0.4)


def truths(log: Recorded) -> dict[str, float]:
    """Return what the plant of a log is, by the names of a fit's parameters."""
    real, plant = log.real, log.real.nominal
    P = log.x[:, 2:]
    mean = plant.joint.equilibrium(*P.mean(axis=0)), 0.0, *P.mean(axis=0)
    K = float(plant.isobaric(np.array(mean, float)))
    at_five = P * (5 * BAR / P.sum(axis=1))[:, None]
    contact = Contact(real, np.array([log.x[:, 0], 0 * log.t, *at_five.T]))
    known = {"inertia": plant.inertia / K, "damping": plant.damping / K, "gain": 1.0}
    known["loop_width"] = float(np.mean(2 * real.friction.most(contact) / contact.stiffness))
    if log.x[1, 2] == log.x[2, 2]:  # commands: what regulators make of them is in the angle
        known |= {"lag_up": plant.lags[0], "lag_down": plant.lags[1], "dead_time": real.dead_time}
        known |= {"dead_band": real.dead_band, "filling": 1 / real.flow}
    return known


def campaign(first: int, count: int) -> Iterator[tuple[Recorded, MotionFit]]:
    """Yield the logs and their fits."""
    for seed in range(first, first + count):
        log = made(seed)
        yield log, fit_motion(log.t, log.x[:, 0], log.x[:, 2], log.x[:, 3], joint=JOINT)


def main() -> None:
    """Print how each plant fares, and how often the truth is inside."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plants", type=int, default=24)
    parser.add_argument("--first", type=int, default=0)
    given = parser.parse_args()
    inside: dict[str, list[bool]] = {}
    for log, fit in campaign(given.first, given.plants):
        known, missed = truths(log), []
        for name, estimate in fit.parameters.items():
            if name in known:
                there = estimate.low <= known[name] <= estimate.high
                inside.setdefault(name, []).append(there)
                label = LABELS[name]
                said = (known[name], estimate.value, estimate.low, estimate.high)
                true, value, low, high = (part / label.unit for part in said)
                missed += [] if there else [f"{label.key} {value:.3g} [{low:.3g}, {high:.3g}] for {true:.3g}"]
        print(f"{log.kind:13} free run {fit.error.every / DEG:5.2f}°  {'; '.join(missed) or 'all inside'}", flush=True)
    for name, there in inside.items():
        print(f"{LABELS[name].words:58} {np.mean(there):4.0%} of {len(there)}")
    every = np.concatenate([*inside.values()])
    print(f"{'all':58} {np.mean(every):4.0%} of {every.size}")


if __name__ == "__main__":
    main()
