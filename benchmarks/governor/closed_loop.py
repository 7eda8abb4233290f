"""Arms under a governor, commanded by those who mean harm: how far beyond their range do the joints get?"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from allocator.units import BAR
from benchmarks.governor.arm import Arms, symbolic_mass_matrix
from mpc.governor import GovernorStatus, PressureGovernor

DT, SLEW = 0.01, 20 * BAR
Commander = Callable[[Arms, np.random.Generator, int], np.ndarray]


def noise(arms: Arms, rng: np.random.Generator, k: int) -> np.ndarray:
    """Anything, another thing every sample."""
    return rng.uniform(-2, 7, arms.P.shape) * BAR


def held(arms: Arms, rng: np.random.Generator, k: int) -> np.ndarray:
    """Anything within the supply, for 0.5 s."""
    return np.random.default_rng(k // 50).uniform(0, 5, arms.P.shape) * BAR


def outward(arms: Arms, rng: np.random.Generator, k: int) -> np.ndarray:
    """All muscles that pull both joints towards one of their ends, the others nothing; anew every second."""
    side = np.where(np.random.default_rng(k // 100).random((len(arms.q), 1, 2)) < 0.5, -1, 1)
    return np.where((arms.mechanism.arms(arms.q) * side).sum(axis=2) > 0, 5.0, 0.0) * BAR


def pump(arms: Arms, rng: np.random.Generator, k: int) -> np.ndarray:
    """Whatever gives the arm more energy."""
    power = np.einsum("nji,ni->nj", arms.mechanism.arms(arms.q), arms.omega + 1e-3)
    return np.where(power > 0, 5.0, 0.0) * BAR


COMMANDERS: dict[str, Commander] = {"noise": noise, "held": held, "outward": outward, "pump": pump}


class Run(NamedTuple):
    """What became of arms that were commanded."""

    beyond: float  # the farthest a joint was beyond its range [rad]; negative: it kept that much off
    broken: int  # commands outside supply, slew or tautness
    unable: float  # share of samples in which no pressures kept the joints in range
    moved: float  # share of commands that were moved


def run(
    commander: Commander, N: int, seconds: float, *, lag: float, margin: float, off: float, governed: bool = True,
    damping: float = 0.1, known_lag: bool = True, seed: int = 0,
) -> Run:  # fmt: skip
    """Command N arms for so long; `off` is how far every muscle's force is from its model."""
    rng = np.random.default_rng(seed)
    arms = Arms.at_rest(N, lag, damping, off, rng)
    governor = PressureGovernor(
        arms.mechanism, DT, SLEW, inertia=symbolic_mass_matrix, lag=lag if known_lag else 0.0, margin=margin
    )
    limits = np.array(arms.mechanism.angle_limits)
    u, beyond, broken, unable, moved = arms.P.copy(), -np.inf, 0, 0, 0
    for k in range(round(seconds / DT)):
        command = commander(arms, rng, k)
        if governed:
            safe, status = governor.govern(arms.q, arms.omega, arms.P, command, u)
            unable += int((status == GovernorStatus.NOT_KEPT).sum())
        else:
            lo, hi = arms.mechanism.pressure_box(arms.q, previous=u, max_step=SLEW * DT)
            safe = np.clip(command, lo, hi)
        moved += int((safe != command).any(axis=1).sum())
        broken += outside(arms, safe, u)
        arms.step(safe, DT)
        u = safe
        beyond = max(beyond, float(np.maximum(limits[:, 0] - arms.q, arms.q - limits[:, 1]).max()))
    samples = N * round(seconds / DT)
    return Run(beyond, broken, unable / samples, moved / samples)


def outside(arms: Arms, u: np.ndarray, previous: np.ndarray) -> int:
    """How many commands leave supply, slew or, where the slew lets them, tautness, by more than rounding."""
    taut = np.clip(arms.mechanism.pressure_box(arms.q)[0], previous - SLEW * DT, previous + SLEW * DT)
    near = 1e-9 * 5 * BAR
    wrong = (u < -near) | (u > 5 * BAR + near) | (np.abs(u - previous) > SLEW * DT + near) | (u < taut - near)
    return int(wrong.any(axis=1).sum())
