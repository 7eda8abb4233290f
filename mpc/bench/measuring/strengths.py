"""Strengths of the muscles from tones of equal amplitude: equations (S4), (S5).

With the phasors Θ of the angle and Π_i of muscle i's torque by the model at the measured pressure, its true strength
g_i, damping D and the known inertia J, small motions about a rest obey

    (K_felt(A) + i h(A) - J ω² + i ω D) Θ = g_1 Π_1 + g_2 Π_2                                                 (S4)

Rate-independent hysteresis answers equally at all frequencies where A is equal. Tones in either muscle at a low and at a
high frequency, one of another amplitude and a third and fourth frequency therefore determine g_1, g_2, K_felt and h at
the amplitude A_0, their slopes by A, and D:

    g_1 Π_1/Θ + g_2 Π_2/Θ - (K + K' ΔA) - i (h + h' ΔA) - i ω D = -J ω²

two real equations a tone, solved by least squares. Readings of the angle that are δ old turn Θ by e^{-iωδ}; δ is one
unknown more, with what is told of it as a prior. A stiffness that rises with the logarithm of the frequency instead is
looked for, and refuses the measurement.
"""

from dataclasses import dataclass
from math import log, sqrt
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.bench.measuring.phasors import Phasors

NAMES = ("g1", "g2", "K", "h", "dK/dA", "dh/dA", "D", "age")
WIDER = 2  # number of the tone of another amplitude
_FLOOR = 0.006  # of the impedance K - Jω² + …: what no scatter of periods shows (waveform, dead band)
_STEPS = 12  # of Gauss–Newton in the age
_APART = 0.10  # of the amplitude: tones farther apart say nothing
_RATE = 3.5  # standard errors of a rate dependence that is believed
_RATE_LEAST = 0.06  # of K_felt a decade, below which a rate dependence is no matter


class Load(NamedTuple):
    """Equation of two mean torques with a known difference: g·ΔT̄ = ΔW."""

    torque: tuple[float, float]  # ΔT̄_i of the model [N·m]
    weight: float  # ΔW [N·m]
    error: float  # its standard deviation [N·m]


@dataclass(frozen=True)
class Known:
    """What is known besides the tones."""

    inertia: float | None  # J [kg·m²]; None: it is one unknown more
    inertia_error: float = 0.0  # relative standard deviation [-]
    age: float = 0.0  # δ of the angle's readings [s] …
    age_error: float = 0.0005  # … and its standard deviation [s]
    added: tuple[float, ...] = ()  # inertia added at each tone [kg·m²]; none
    loads: tuple[Load, ...] = ()


@dataclass(frozen=True)
class Solution:
    """Least squares of (S4): unknowns, covariance, and how well the equations agree."""

    values: dict[str, float]
    covariance: Array  # of g1, g2, inertia included (2, 2)
    errors: dict[str, float]  # standard deviations
    disagreement: float  # √(χ²/degrees of freedom)
    rate: float  # K's growth a decade of frequency, as a share of K [-]
    rate_error: float

    @property
    def strengths(self) -> tuple[float, float]:
        """(g_1, g_2) [-]."""
        return self.values["g1"], self.values["g2"]


def solve(tones: list[Phasors], amplitude: float, known: Known) -> Solution:
    """Return strengths and the rest from tones about the amplitude A_0 [rad]."""
    added = known.added or (0.0,) * len(tones)
    values, covariance, chi = _fitted(tones, added, amplitude, known, rate=False)
    names = list(NAMES) + (["J"] if known.inertia is None else [])
    scale = max(1.0, chi)
    errors = {name: scale * sqrt(covariance[i, i]) for i, name in enumerate(names)}
    found = dict(zip(names, values.tolist(), strict=True))
    strengths = values[:2]
    of_inertia = 0.0 if known.inertia is None else known.inertia_error
    both = scale**2 * covariance[:2, :2] + of_inertia**2 * np.outer(strengths, strengths)
    errors |= {f"g{i + 1}": sqrt(both[i, i]) for i in range(2)}
    rated, rate_covariance, rate_chi = _fitted(tones, added, amplitude, known, rate=True)
    unit = max(abs(found["K"]), 1e-9)
    error = max(1.0, rate_chi) * sqrt(rate_covariance[-1, -1])
    return Solution(found, both, errors, chi, float(rated[-1]) / unit, error / unit)


def _fitted(
    tones: list[Phasors], added: tuple[float, ...], A0: float, known: Known, *, rate: bool
) -> tuple[Array, Array, float]:
    """Return unknowns, their covariance and √(χ²/dof): linear but for the age, by Gauss–Newton."""
    J = known.inertia
    n = len(NAMES) + (J is None) + rate
    x, age = np.zeros(n), known.age
    x[:2] = 1.0
    for _ in range(_STEPS):
        rows, targets, sigma = [], [], []
        for tone, more in zip(tones, added, strict=True):
            w, Theta = tone.omega, tone.theta * np.exp(1j * tone.omega * age)
            dA = tone.swing - A0
            r1, r2 = (p / Theta for p in tone.torque)
            column = [r1, r2, -1, -1j, -dA, -1j * dA, -1j * w, -1j * w * (x[0] * r1 + x[1] * r2)]
            column += [w**2] if J is None else []
            column += [-(log(tone.frequency) - _centre(tones)) / log(10)] if rate else []
            target = -(0.0 if J is None else J) * w**2 - more * w**2
            target = target + column[7] * age
            error = _error(tone, x)
            for part in (np.real, np.imag):
                rows.append([float(part(c)) for c in column])
                targets.append(float(part(target)))
                sigma.append(error)
        rows.append([0.0] * 7 + [1.0] + [0.0] * (n - 8))
        targets.append(known.age)
        sigma.append(known.age_error)
        for load in known.loads:
            rows.append([*load.torque, *[0.0] * (n - 2)])
            targets.append(load.weight)
            sigma.append(load.error)
        weights = 1 / np.array(sigma)
        X, y = np.array(rows) * weights[:, None], np.array(targets) * weights
        x, *_ = np.linalg.lstsq(X, y, rcond=None)
        if abs(x[7] - age) < 1e-7:
            break
        age = float(x[7])
    left = y - X @ x
    dof = max(len(y) - n, 1)
    return x, np.linalg.pinv(X.T @ X), sqrt(float(left @ left) / dof)


def _error(tone: Phasors, x: Array) -> float:
    """Return the standard deviation [N·m/rad] of each part of a tone's equation."""
    scatter = sqrt(sum((g * e) ** 2 for g, e in zip((1.0, 1.0), tone.ratio_error, strict=True)))
    size = abs(sum(p / tone.theta for p in tone.torque))
    return max(scatter, 1e-9) + _FLOOR * max(size, abs(x[2]))


def _centre(tones: list[Phasors]) -> float:
    return float(np.mean([log(t.frequency) for t in tones]))


def why_not(tones: list[Phasors], amplitude: float, found: Solution | None, least_swing: float) -> str:
    """Return why the tones do not measure the strengths, or ""."""
    A = [t.swing for t in tones]
    if min(A) < least_swing:
        return f"the joint moved by only ±{np.degrees(min(A)):.2g}°, less than its encoder resolves for this"
    if (quality := min(t.coherence for t in tones)) < 0.8:
        return f"the motion is no tone: {100 * (1 - quality):.0f} % of its variance is something else"
    same = [a for i, a in enumerate(A) if i != WIDER]
    if max(abs(a / amplitude - 1) for a in same) > _APART:
        listed = ", ".join(f"±{np.degrees(a):.3g}° at {t.frequency:.2g} Hz" for t, a in zip(tones, A, strict=True))
        return f"the amplitudes did not come together ({listed}); friction jumps, or the regulators are too slow"
    if found is None:
        return ""
    if abs(found.rate) > _RATE * found.rate_error and abs(found.rate) > _RATE_LEAST:
        return (
            f"the stiffness depends on the rate: {100 * found.rate:+.0f} % a decade of frequency "
            f"(± {100 * found.rate_error:.0f}); tones then do not tell the muscles' strengths"
        )
    worst = max(found.errors["g1"] / abs(found.strengths[0]), found.errors["g2"] / abs(found.strengths[1]))
    if not worst < 0.15 or min(found.strengths) <= 0:
        return f"the excitation is too small: the strengths are known to ± {100 * min(worst, 9.99):.0f} % only"
    if found.disagreement > 6:
        return f"the frequencies disagree: {found.disagreement:.1f} times their errors"
    return ""
