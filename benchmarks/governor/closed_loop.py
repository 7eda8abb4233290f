"""Arms under a governor and adversarial commands: excursions of the joints beyond their range."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from allocator import Limits, report_joint
from allocator.mechanism import Mechanism
from allocator.mechanism.bodies import Bodies
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR
from mpc.arm.learning.plant import ArmBatch, VariedArm
from mpc.governor import GovernorStatus, Interval, PressureGovernor
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
    """Return random commands, new in every sample."""
    return rng.uniform(-2, 7, arms.P.shape) * BAR


def held(arms: ArmBatch, rng: np.random.Generator, k: int) -> np.ndarray:
    """Return random commands within the supply, each for 0.5 s."""
    return np.random.default_rng(k // 50).uniform(0, 5, arms.P.shape) * BAR


def outward(arms: ArmBatch, rng: np.random.Generator, k: int) -> np.ndarray:
    """Return full pressure for all muscles that pull the joints towards an end, none for others; new every second."""
    side = np.where(np.random.default_rng(k // 100).random((len(arms.q), 1, arms.q.shape[1])) < 0.5, -1, 1)
    return np.where((arms.varied.arm.mechanism.arms(arms.q) * side).sum(axis=2) > 0, 5.0, 0.0) * BAR


def bang(arms: ArmBatch, rng: np.random.Generator, k: int) -> np.ndarray:
    """Return full or no pressure for every muscle, new every 0.1 s."""
    return np.where(np.random.default_rng(k // 10).random(arms.P.shape) < 0.5, 5.0, 0.0) * BAR


def resonance(arms: ArmBatch, rng: np.random.Generator, k: int) -> np.ndarray:
    """Return commands that add energy to the arm, in phase with its motion."""
    power = np.einsum("nji,ni->nj", arms.varied.arm.mechanism.arms(arms.q), arms.omega + 1e-3)
    return np.where(power > 0, 5.0, 0.0) * BAR


COMMANDERS: dict[str, Commander] = {f.__name__: f for f in (noise, held, outward, bang, resonance)}


class Run(NamedTuple):
    """Outcome for commanded arms."""

    beyond: float  # greatest excursion of a joint beyond its range [rad]; negative: distance from the end
    broken: int  # commands outside supply, slew or tautness
    unable: float  # share of samples without a safe backup
    moved: float  # share of moved commands among those within supply, slew and tautness


PLACES = {"strength": "gains", "damping": "damping", "mass": "mass", "lag": "lags"}  # in rows of an `ArmBatch`
NOTHING: Mapping[str, float] = {}


def factors(batch: ArmBatch, quantity: str, share: float, rng: np.random.Generator) -> np.ndarray:
    """Return random factors (N, …) within 1 ± `share`, half of them at the ends."""
    shape = batch.v[:, batch.varied.places[PLACES[quantity]]].shape
    inside = rng.uniform(-1.0, 1.0, shape)
    return np.asarray(1 + share * np.where(rng.random(shape) < 0.5, inside, np.sign(inside)))


@cache
def governor_of(arm: Arm, margin: float, known: tuple[tuple[str, float], ...]) -> PressureGovernor:
    """Return the governor with intervals of these shares for the quantities of `arm`."""
    values = {"strength": 1.0, "mass": 1.0, "damping": arm.bodies.damping, "lag": arm.lag}
    given = {quantity: Interval.about(values[quantity], share) for quantity, share in known}
    return PressureGovernor.of_arm(arm, DT, margin=margin, **given)


def closed_loop(
    name: str, commander: str, arms: int, seconds: float, *, lag: float = 0.02, margin: float = 0.0,
    off: Mapping[str, float] = NOTHING, told: bool = False, governed: bool = True, gas: str = "", seed: int = 0,
) -> Run:  # fmt: skip
    """Run so many arms without end stops for so long.

    `off` is the greatest relative deviation of each arm's strength, damping, mass and lag from the model; the governor
    is `told` intervals of these. Motion compresses `gas` in the muscles that is "known" or "unknown" to the governor.
    """
    arm, rng = machine(name, lag), np.random.default_rng(seed)
    mechanism = arm.mechanism
    free = replace(arm, mechanism=replace(mechanism, angle_limits=None))
    batch = ArmBatch(VariedArm(free, arm.gas if gas else None), arms, DT)
    arm = replace(arm, gas=gas == "known")
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
