"""Push experiment on the benchmark's plants: requested and true stiffness, and the causes of the difference."""

import csv
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from allocator import AntagonistJoint
from allocator.calculus import increasing_root
from allocator.identification import fit_joint
from allocator.joint.antagonist import report_joint
from allocator.units import BAR, DEG, PERCENT
from benchmarks.closed_loop.cases import CASES, EVERY, LOAD, SEEDS, STANDARD
from benchmarks.closed_loop.push import Cycle, Push, push
from mpc import Plant, Reference, Weights
from mpc.model.friction.contact import Loads
from mpc.model.real import RealPlant
from mpc.trials.loops import Settings, loop
from mpc.trials.motions.trajectories import LEAD

SETTLED = 5.0  # [s]
WEIGHT = 1.2  # [N·m] weight in the joint's log
READING = 0.002 * BAR  # [Pa] noise of a pressure in the log, after averaging


class Pushed(NamedTuple):
    """Situation of a push."""

    plant: str
    model: str
    reference: Reference
    at: float = SETTLED  # [s]
    loaded: bool = False
    torque: float = 2.0  # [N·m] of the push


def _hold(K: float, theta: float = 0.0) -> Reference:
    return Reference([0.0, SETTLED], [theta, theta], [K, K])


SITUATIONS = {
    "held": Pushed("standard", "Sarosi", _hold(5.5)),
    "held at 40°, K 6.5": Pushed("standard", "Sarosi", _hold(6.5, 40 * DEG)),
    "under the unknown load": Pushed("standard", "Sarosi", _hold(5.5, 20 * DEG), loaded=True),
    "more asked than there is": Pushed("standard", "Sarosi", _hold(12.0), torque=3.0),
    "frozen in a step of K": Pushed("standard", "Sarosi", CASES["stiffness step"].reference, at=LEAD + 0.15),
    "gains swapped": Pushed("gains swapped", "Sarosi", _hold(5.5)),
    "both +10 %": Pushed("both +10 %", "Sarosi", _hold(5.5)),
    "held by Tondu2021": Pushed("standard", "Tondu2021", _hold(7.6)),
    "held by the fitted joint": Pushed("standard", "fitted", _hold(7.6), torque=2.5),
    "both +10 %, by the fitted joint": Pushed("both +10 %", "fitted", _hold(5.5)),
}


class Experiment(NamedTuple):
    """Parameters of one push."""

    situation: str
    seed: int


def experiments(seeds: int) -> Iterator[Experiment]:
    """Return every situation with so many seeds."""
    return (Experiment(name, seed) for name in SITUATIONS for seed in range(SEEDS, SEEDS + seeds))


def found(experiment: Experiment) -> tuple[Experiment, Push]:
    """Return the result of one push."""
    situation = SITUATIONS[experiment.situation]
    real = EVERY[situation.plant].real
    model = Plant(_joint(situation.model, situation.plant), lag=real.nominal.lags)
    if situation.loaded:
        real = replace(real, torque_profile=((0.5, LOAD),))
    driver = loop("mpc", Settings(model, compensation=real.known(), weights=Weights.calm()))
    cycle = Cycle(situation.torque)
    return experiment, push(real, model, driver, situation.reference, situation.at, cycle, experiment.seed)


def _joint(model: str, plant: str) -> AntagonistJoint:
    if model == "Tondu2021":
        return report_joint()
    return fitted(plant) if model == "fitted" else STANDARD.nominal.joint


@cache
def fitted(plant: str) -> AntagonistJoint:
    """Return the joint fitted to a log of `plant`: an encoder, two pressure sensors and a weight, no force sensor."""
    joint = EVERY[plant].real.nominal.joint
    theta, P1, P2, torque, direction = _log(EVERY[plant].real)
    fit = fit_joint(theta, P1, P2, torque=torque, direction=direction, geometry=joint.geometry)
    return replace(fit.joint, angle_limits=joint.angle_limits)


def _log(real: RealPlant) -> tuple[np.ndarray, ...]:
    """Return equilibrium angles of slow sweeps of one pressure, from both sides, without and with a weight."""
    held, swept = (a.ravel() * BAR for a in np.meshgrid(np.arange(1.5, 5.0, 0.7), np.arange(1.5, 5.0, 0.5)))
    hung = [(P * BAR, side * WEIGHT, s) for P in (2.0, 3.0, 4.0) for side in (-1, 1) for s in (-1, 1)]
    P, weight, side = np.array(hung).T
    none, one = np.zeros_like(held), np.ones_like(held)
    P1, P2 = np.concatenate([held, swept, P]), np.concatenate([swept, held, P])
    torque, direction = np.concatenate([none, none, weight]), np.concatenate([-one, one, side])

    def lacking(theta: np.ndarray, P1: np.ndarray, P2: np.ndarray, torque: np.ndarray, s: np.ndarray) -> np.ndarray:
        x = np.stack([theta, 0 * theta, P1, P2])
        return torque + s * real.friction.most(Loads.of(real, x)) - real.torque(x)

    theta = increasing_root(lacking, *real.nominal.joint.angle_range, P1, P2, torque, direction)
    random = np.random.default_rng(1)
    there = np.isfinite(theta) & (np.abs(theta) < 60 * DEG)
    read = real.encoder * np.round(theta / real.encoder)
    P1, P2 = (p + READING * random.standard_normal(p.size) for p in (P1, P2))
    return tuple(a[there] for a in (read, P1, P2, torque, direction))


Found = tuple[Experiment, Push]
STEPS = ("asked", "feasible", "modelled", "estimated", "true", "measured")
CAUSES = ("saturation", "dynamics", "mismatch", "measurement")


def save(pushed: list[Found], path: Path) -> None:
    """Write one line per push."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["situation", "seed", *STEPS, *CAUSES, "friction"])
        for (situation, seed), p in pushed:
            numbers = [*(getattr(p, s) for s in STEPS), *(p.causes[c] for c in CAUSES), p.friction]
            writer.writerow([situation, seed, *(f"{v:.6g}" for v in numbers)])


def markdown(pushed: list[Found]) -> Iterator[str]:
    """Yield the table of the report, medians over the seeds."""
    yield "## Stiffness measured by pushes [N·m/rad]\n"
    yield "The joint is brought to rest by the MPC, its pressures are frozen and it is pushed both ways"
    yield "(`benchmarks.closed_loop.push`)."
    yield "From asked to measured: + saturation + dynamics + mismatch of the model + error of the measurement."
    yield "The fitted joint is fitted to a log of encoder, pressures and a weight; there is no force sensor.\n"
    head = ("situation", "asked", "estimated", "true", "measured", *CAUSES, "of true")
    yield "| " + " | ".join(head) + " |"
    yield "|---" * len(head) + "|"
    for situation in dict.fromkeys(e.situation for e, _ in pushed):
        found = [p for e, p in pushed if e.situation == situation]
        steps = [np.mean([getattr(p, s) for p in found]) for s in ("asked", "estimated", "true", "measured")]
        causes = [np.mean([p.causes[c] for p in found]) for c in CAUSES]
        worst = max(abs(p.causes["measurement"] / p.true) for p in found) / PERCENT
        cells = [*(f"{v:.2f}" for v in steps), *(f"{v:+.2f}" for v in causes), f"≤ {worst:.1f} %"]
        yield f"| {situation} | " + " | ".join(cells) + " |"
    yield ""
