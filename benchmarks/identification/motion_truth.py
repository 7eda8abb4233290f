"""Fits of moving joints with known truth from their logs, and the coverage of the stated intervals.

    python -m benchmarks.identification.motion_truth [--plants 24] [--first 0] [--strangers] [--gas]

Each plant has another inertia, damping, lag, dead time, dead band, flow limit and hysteresis: Maxwell slip with
separate springs, an operator of the angle, or Dahl's friction in proportion to the pulls; none has the structure of the
fitted model. Its log is 90 s of random steps of both commanded pressures at 50 Hz; every fourth has measured ones. The
joint given to the fit is correct. A loop's true width is the mean over the log, at P1 + P2 = 5 bar. The model error
that `fit_motion` adds to its intervals was set by these plants.

With `--strangers` the joints are those of `benchmarks.identification.motion_truth_strangers`: a law other than
that of the joint given to the fit, Bouc–Wen hysteresis, unequal regulators; `--gas` adds the gas.
"""

import argparse
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from allocator import BAR, DEG, AntagonistJoint, report_joint
from allocator.calculus import Array
from allocator.identification import fit_motion
from allocator.identification.motion.result import LABELS, MotionFit
from allocator.joint.hysteresis import PrandtlIshlinskii
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from benchmarks.identification import motion_truth_strangers as other
from mpc import Plant, RealPlant
from mpc.model.friction.contact import Loads
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip

JOINT = report_joint(SAROSI_DMSP_20_400N)
STEP, SECONDS = 0.02, 90.0  # [s]
ENCODER = 0.03 * DEG
KINDS = ("Maxwell slip", "operator", "Dahl")


Truths = dict[str, float]  # by the name of a fit's parameter


class Recorded(NamedTuple):
    """Log of a joint with its truth."""

    kind: str
    joint: AntagonistJoint  # given to the fit
    truths: Truths
    t: Array  # [s]
    x: Array  # (n, 4), sensor readings, with commands instead of pressures if these were not measured


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
        encoder=ENCODER,
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
    t, x = STEP * np.arange(len(rows)), np.array(rows)
    return Recorded(kind, JOINT, truths(real, x), t, x)


def _friction(kind: str, plant: Plant, width: float) -> object:
    if kind == "Maxwell slip":
        return MaxwellSlip.of_width(plant, width)
    if kind == "Dahl":
        return Friction.of_width(plant, width, presliding=width / 4)
    weights = np.array([0.5, 0.3, 0.2])
    reach = np.array([0.15, 0.5, 1.2])
    return PrandtlIshlinskii((0.4, *(0.6 * weights)), tuple(reach * width / (1.2 * weights @ reach)), base=0.4)


def strangers(seeds: range, gas: bool) -> Iterator[Recorded]:
    """Yield the logs of joints with their own differential equations."""
    joints = other.drawn(seeds)
    u = np.stack([other.commands(seed, round(other.SECONDS / other.STEP)) for seed in seeds], axis=-1)
    theta, P = other.simulated(joints, u, gas)
    t = other.STEP * np.arange(len(u))
    for i in range(len(seeds)):
        read = ENCODER * np.round(theta[:, i] / ENCODER)
        x = np.column_stack([read, np.full(t.size, np.nan), u[..., i]])
        known = other.truths(joints, i, theta[:, i], P[..., i])
        yield Recorded("stranger", other.given_joint(), known, t, x)


def truths(real: RealPlant, x: Array) -> Truths:
    """Return the parameters of a plant that wrote the rows `x` (n, 4)."""
    plant, P = real.nominal, x[:, 2:]
    mean = plant.joint.equilibrium(*P.mean(axis=0)), 0.0, *P.mean(axis=0)
    K = float(plant.isobaric(np.array(mean, float)))
    at_five = P * (5 * BAR / P.sum(axis=1))[:, None]
    contact = Loads.of(real, np.array([x[:, 0], 0 * x[:, 0], *at_five.T]))
    known = {"inertia": plant.inertia / K, "damping": plant.damping / K, "gain": 1.0}
    known["loop_width"] = float(np.mean(2 * real.friction.most(contact) / contact.stiffness))
    if x[1, 2] == x[2, 2]:  # commands: the angle contains the regulators' effect
        known |= {"lag_up": plant.lags[0], "lag_down": plant.lags[1], "lag_ratio": 1.0, "dead_time": real.dead_time}
        known |= {"dead_band": real.dead_band, "filling": 1 / real.flow}
    return known


def campaign(logs: Iterable[Recorded]) -> Iterator[tuple[Recorded, MotionFit]]:
    """Yield the logs and their fits."""
    for log in logs:
        yield log, fit_motion(log.t, log.x[:, 0], log.x[:, 2], log.x[:, 3], joint=log.joint)


def main() -> None:
    """Print the misses of each plant, the share of truths inside, the sharpness, and the coverage of the bands."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plants", type=int, default=24)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--strangers", action="store_true")
    parser.add_argument("--gas", action="store_true")
    given = parser.parse_args()
    seeds = range(given.first, given.first + given.plants)
    inside: dict[str, list[bool]] = {}
    ratios: list[float] = []
    held: list[float] = []
    for log, fit in campaign(strangers(seeds, given.gas) if given.strangers else map(made, seeds)):
        known, missed = log.truths, []
        held.append(fit.bands.coverage)
        for name, estimate in fit.parameters.items():
            if name in known:
                there = estimate.low <= known[name] <= estimate.high
                inside.setdefault(name, []).append(there)
                ratios.append(abs(estimate.value - known[name]) / estimate.std)
                label = LABELS[name]
                said = (known[name], estimate.value, estimate.low, estimate.high)
                true, value, low, high = (part / label.unit for part in said)
                missed += [] if there else [f"{label.key} {value:.3g} [{low:.3g}, {high:.3g}] for {true:.3g}"]
        print(f"{log.kind:13} free run {fit.error.every / DEG:5.2f}°  {'; '.join(missed) or 'all inside'}", flush=True)
    for name, there in inside.items():
        print(f"{LABELS[name].words:58} {np.mean(there):4.0%} of {len(there)}")
    every = np.concatenate([*inside.values()])
    print(f"{'all':58} {np.mean(every):4.0%} of {every.size}")
    print(f"errors over stated standard deviations {np.sqrt(np.mean(np.square(ratios))):.2f} RMS")
    print(f"bands hold {np.mean(held):.1%} of left-out blocks, {min(held):.1%} at least")


if __name__ == "__main__":
    main()
