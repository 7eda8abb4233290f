"""Arms under a governor and adversarial commands: how far beyond their range do the joints get?"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from allocator import Limits, report_joint
from allocator.mechanism import Mechanism
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR
from mpc.arm.learning.plant import ArmBatch, VariedArm
from mpc.governor import GovernorStatus, Interval, PressureGovernor
from mpc.model.arm.bodies import Bodies
from mpc.model.arm.model import Arm

DT, SLEW = 0.01, 20 * BAR
Commander = Callable[[ArmBatch, np.random.Generator, int], np.ndarray]
MACHINES = "joint", "arm26", "leg37"  # of 1, 2 and 3 joints, the last with gravity


@cache
def machine(name: str, lag: float) -> Arm:
    """Return an arm with fast valves."""
    if name != "joint":
        return replace(Arm.machine(name), lag=lag, slew=SLEW)
    mechanism = Mechanism.from_joint(report_joint(SAROSI_DMSP_20_400N))
    return Arm(mechanism, Bodies.rods((0.3,), (1.0,), 0.05), lag, SLEW)


def noise(arms: ArmBatch, rng: np.random.Generator, k: int) -> np.ndarray:
    """Anything, another thing every sample."""
    return rng.uniform(-2, 7, arms.P.shape) * BAR


def held(arms: ArmBatch, rng: np.random.Generator, k: int) -> np.ndarray:
    """Anything within the supply, for 0.5 s."""
    return np.random.default_rng(k // 50).uniform(0, 5, arms.P.shape) * BAR


def outward(arms: ArmBatch, rng: np.random.Generator, k: int) -> np.ndarray:
    """All muscles that pull the joints towards one of their ends, the others nothing; anew every second."""
    side = np.where(np.random.default_rng(k // 100).random((len(arms.q), 1, arms.q.shape[1])) < 0.5, -1, 1)
    return np.where((arms.varied.arm.mechanism.arms(arms.q) * side).sum(axis=2) > 0, 5.0, 0.0) * BAR


def bang(arms: ArmBatch, rng: np.random.Generator, k: int) -> np.ndarray:
    """All or nothing for every muscle, anew every 0.1 s."""
    return np.where(np.random.default_rng(k // 10).random(arms.P.shape) < 0.5, 5.0, 0.0) * BAR


def resonance(arms: ArmBatch, rng: np.random.Generator, k: int) -> np.ndarray:
    """Whatever gives the arm more energy: in time with its own motion."""
    power = np.einsum("nji,ni->nj", arms.varied.arm.mechanism.arms(arms.q), arms.omega + 1e-3)
    return np.where(power > 0, 5.0, 0.0) * BAR


COMMANDERS: dict[str, Commander] = {f.__name__: f for f in (noise, held, outward, bang, resonance)}


class Run(NamedTuple):
    """Outcome for arms that were commanded."""

    beyond: float  # the farthest a joint was beyond its range [rad]; negative: it kept that much off
    broken: int  # commands outside supply, slew or tautness
    unable: float  # share of samples in which nothing was sure to keep the joints in range
    moved: float  # share of commands within supply, slew and tautness that were moved


PLACES = {"strength": "gains", "damping": "damping", "mass": "mass", "lag": "lags"}  # in rows of an `ArmBatch`
NOTHING: Mapping[str, float] = {}


def factors(batch: ArmBatch, quantity: str, share: float, rng: np.random.Generator) -> np.ndarray:
    """Return random factors (N, …) within 1 ± `share`, half of them at the ends."""
    shape = batch.v[:, batch.varied.places[PLACES[quantity]]].shape
    inside = rng.uniform(-1.0, 1.0, shape)
    return np.asarray(1 + share * np.where(rng.random(shape) < 0.5, inside, np.sign(inside)))


@cache
def governor_of(arm: Arm, margin: float, known: tuple[tuple[str, float], ...]) -> PressureGovernor:
    """Return the governor that knows the quantities of `arm` within these shares."""
    values = {"strength": 1.0, "mass": 1.0, "damping": arm.bodies.damping, "lag": arm.lag}
    given = {quantity: Interval.about(values[quantity], share) for quantity, share in known}
    return PressureGovernor.of_arm(arm, DT, margin=margin, **given)


def closed_loop(
    name: str, commander: str, arms: int, seconds: float, *, lag: float = 0.02, margin: float = 0.0,
    off: Mapping[str, float] = NOTHING, told: bool = False, governed: bool = True, seed: int = 0,
) -> Run:  # fmt: skip
    """Command so many arms for so long, which have no end stops.

    `off` is by which share of the model's value strength, damping, mass and lag of each arm may differ from it; of
    these the governor is `told` intervals.
    """
    arm, rng = machine(name, lag), np.random.default_rng(seed)
    mechanism = arm.mechanism
    batch = ArmBatch(VariedArm(replace(arm, mechanism=replace(mechanism, angle_limits=None))), arms, DT)
    for quantity, share in off.items():
        batch.v[:, batch.varied.places[PLACES[quantity]]] *= factors(batch, quantity, share, rng)
    governor = governor_of(arm, margin, tuple(off.items()) if told else ())
    governor.warm_up()
    batch.P[:] = governor.made.rules.rest
    batch.q[:] = np.mean(arm.angle_limits, axis=0)
    u, push, (low, high) = batch.P.copy(), np.zeros((arms, arm.n)), arm.angle_limits
    beyond, broken, unable, moved, samples = -np.inf, 0, 0, 0, round(seconds / DT)
    for k in range(samples):
        box = mechanism.pressure_box(batch.q, Limits(previous=u, max_step=SLEW * DT))
        command = np.clip(COMMANDERS[commander](batch, rng, k), *box)
        safe, status = governor.govern(batch.q, batch.omega, batch.P, command, u)
        unable += int((status == GovernorStatus.NOT_KEPT).sum())
        moved += int((np.abs(safe - command) > 1.0).any(axis=1).sum())
        safe = safe if governed else command
        broken += int(((safe < box[0] - 1e-3) | (safe > box[1] + 1e-3)).any(axis=1).sum())
        batch.advance(safe, push)
        u, beyond = safe, max(beyond, float(np.maximum(low - batch.q, batch.q - high).max()))
    return Run(beyond, broken, unable / samples / arms, moved / samples / arms)
