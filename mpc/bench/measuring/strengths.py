"""Strengths of the muscles from loops of equal amplitude: equations (S4), (S5) for any waveform.

With the torques T_i of the model at the measured pressures, the muscles' true strengths g_i, damping D and the known
inertia J, steady motions about a rest obey J θ'' + D θ' + K θ + T_f = Σ g_i T_i. As means over the stroke, and over a
cycle,

    g_1 m_1 + g_2 m_2 + J b = K_m(A)                                                                           (S4)
    g_1 w_1 + g_2 w_2 - D v = h(A)

with the means m, b and works w, v of `mpc.bench.measuring.loops`. Mean stiffness K_m and loss h of rate-independent
hysteresis depend on the swing A alone. Tones of equal A in either muscle at a low frequency and in both at high ones,
one of another amplitude and a slower one therefore determine g_1, g_2, K_m and h at A_0, their slopes by A, and D:
two equations per tone, by least squares. For sines, A = |Θ| and phasors this is (S5).

K_m and h are linear in 1/A, as for friction that slips. The age δ of the angle's readings is another unknown, with
its known value as a prior. If the stiffness rises with the logarithm of the frequency, the measurement is refused. The
same holds if the joint loses more than hysteresis can: by (S1) and (S2) a loop that loses h softens by

    -dK_h/d ln A ≥ π/4 h                                                                                       (S6)

(for Dahl's friction if A ≥ 0.6 δ), whereas rubber loses at all amplitudes alike.
"""

from dataclasses import dataclass
from math import log, pi, sqrt
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.bench.measuring.loops import Loop, Tone
from mpc.bench.measuring.springs import secant

NAMES = ("g1", "g2", "K", "h", "dK/dA", "dh/dA", "D", "age")
WIDER = 2  # number of the tone of another amplitude
_FLOOR = 0.006  # [-] of the impedance K - Jω² + …: errors beyond the scatter of periods (waveform, dead band)
_SCATTER = 1.8  # [-] of a tone's noise: scatter of tones of one muscle each, by drifted joints (seeds 8-15)
LOSSY = 0.03  # [-] of h: how far friction differs from tone to tone, by hidden joints (seeds >= 1000)
_MODEL = 0.02  # [-] of the strengths, common to both: model error of the equations, by hidden joints (seeds >= 1000)
_TINY, _STILL = 1e-4, 1e-7  # [s] of a difference, and of the last step
_STEPS = 12  # of Gauss–Newton in the age
USABLE = 0.10  # [-] of the amplitude: tones farther apart are useless
_RATE = 4.0  # standard errors of an accepted rate dependence
_RATE_LEAST = 0.06  # [-] of K_felt per decade, below which a rate dependence is irrelevant
_SOFTENS = 3.5  # standard errors of an accepted lack of softening
_PLAUSIBLE = 0.5, 2.0  # strengths
APART = "friction jumps, or the regulators are too slow; shake the joint instead (--shake 10)"


class Load(NamedTuple):
    """Equation of two mean torques with a known difference: g·ΔT̄ = ΔW."""

    torque: tuple[float, float]  # ΔT̄_i of the model [N·m]
    weight: float  # ΔW [N·m]
    error: float  # its standard deviation [N·m]


@dataclass(frozen=True)
class Known:
    """Prior knowledge."""

    inertia: float  # J [kg·m²]
    inertia_error: float = 0.0  # relative standard deviation [-]
    age: float = 0.0  # δ of the angle's readings [s] …
    age_error: float = 0.0005  # … and its standard deviation [s]
    loads: tuple[Load, ...] = ()


@dataclass(frozen=True)
class Solution:
    """Least squares of (S4): unknowns, covariance, and how well the equations agree."""

    values: dict[str, float]
    covariance: Array  # of g1, g2, inertia included (2, 2)
    errors: dict[str, float]  # standard deviations
    disagreement: float  # √(χ²/degrees of freedom)
    rate: float  # K's growth per decade of frequency, as a share of K [-]
    rate_error: float

    @property
    def strengths(self) -> tuple[float, float]:
        """(g_1, g_2) [-]."""
        return self.values["g1"], self.values["g2"]


def solve(tones: list[Tone], amplitude: float, known: Known) -> Solution:
    """Return strengths and the rest from tones about the amplitude A_0 [rad]."""
    values, covariance, chi = _fitted(tones, amplitude, known, rate=False)
    scale = max(1.0, chi)
    errors = {name: scale * sqrt(covariance[i, i]) for i, name in enumerate(NAMES)}
    found = dict(zip(NAMES, values.tolist(), strict=True))
    common = known.inertia_error**2 + _MODEL**2
    both = scale**2 * covariance[:2, :2] + common * np.outer(values[:2], values[:2])
    errors |= {f"g{i + 1}": sqrt(both[i, i]) for i in range(2)}
    rated, of_rate, rate_chi = _fitted(tones, amplitude, known, rate=True)
    unit = max(abs(found["K"]), 1e-9)
    error = max(1.0, rate_chi) * sqrt(of_rate[-1, -1])
    return Solution(found, both, errors, chi, float(rated[-1]) / unit, error / unit)


def _fitted(tones: list[Tone], A0: float, known: Known, *, rate: bool) -> tuple[Array, Array, float]:
    """Return unknowns, their covariance and √(χ²/degrees of freedom): linear except for the age, by Gauss–Newton.

    With `rate` the last unknown is the growth of K per decade of frequency.
    """
    n = len(NAMES) + rate
    x = np.zeros(n)
    x[:2], x[7] = 1.0, known.age
    for _ in range(_STEPS):
        X, y = _equations(tones, A0, known, x, rate)
        new = np.asarray(np.linalg.lstsq(X, y, rcond=None)[0], float)
        change, x = abs(new[7] - x[7]), new
        if change < _STILL:
            break
    left = y - X @ x
    covariance = np.asarray(np.linalg.pinv(X.T @ X), float)
    return x, covariance, sqrt(float(left @ left) / max(len(y) - n, 1))


def _equations(tones: list[Tone], A0: float, known: Known, x: Array, rate: bool) -> tuple[Array, Array]:
    """Return the weighted equations X x = y about the unknowns `x`, each divided by its standard deviation.

    Tones of one amplitude in either muscle scatter by more than their noise, against which a `rate` is judged. With the
    noise alone they would outweigh the balance of the mean torques, which fixes the ratio of the strengths better.
    """
    rows, centre = [], float(np.mean([log(tone.frequency) for tone in tones]))
    for tone in tones:
        here, J = tone.loop(x[7]), known.inertia
        (m1, m2), (w1, w2), dA, b = here.means, here.losses, A0 - A0**2 / here.swing, here.mean_acceleration
        later = _left(tone.loop(x[7] + _TINY), x, J)
        by_age = [(after - now) / _TINY for now, after in zip(_left(here, x, J), later, strict=True)]
        decades = [-(log(tone.frequency) - centre) / log(10)] * rate
        noise = ((1.0 if rate else _SCATTER) * tone.error) ** 2 + (J * tone.acceleration_error) ** 2
        error = sqrt(noise + (_FLOOR * max(abs(x[2]), abs(J * b))) ** 2 + (LOSSY * x[3]) ** 2)
        mean = [m1, m2, -1, 0, -dA, 0, 0, by_age[0], *decades, by_age[0] * x[7] - J * b]
        loss = [w1, w2, 0, -1, 0, -dA, -here.velocity, by_age[1], *[0.0] * rate, by_age[1] * x[7]]
        rows += [(mean, error), (loss, error)]
    rest = [0.0] * rate
    rows.append(([0.0] * 7 + [1.0, *rest, known.age], known.age_error))
    rows += [([*load.torque, *[0.0] * 6, *rest, load.weight], load.error) for load in known.loads]
    table = np.array([np.array(row, float) / error for row, error in rows])
    return table[:, :-1], table[:, -1]


def _left(loop: Loop, x: Array, inertia: float) -> tuple[float, float]:
    """Return the terms of both equations that change with the age of the readings."""
    (m1, m2), (w1, w2) = loop.means, loop.losses
    return x[0] * m1 + x[1] * m2 + inertia * loop.mean_acceleration, x[0] * w1 + x[1] * w2


def why_not(tones: list[Tone], amplitude: float, found: Solution | None, least_swing: float) -> str:
    """Return the reason why the tones do not determine the strengths, or ""."""
    A = [t.swing for t in tones]
    if min(A) < least_swing:
        return f"the joint moved by only ±{np.degrees(min(A)):.2g}°, less than its encoder resolves for this"
    if (quality := min(t.coherence for t in tones)) < 0.8:
        return f"the motion is no tone: {100 * (1 - quality):.0f} % of its variance is something else"
    same = [t for i, t in enumerate(tones) if i != WIDER]
    if max(abs(t.swing / amplitude - 1) for t in same) > USABLE:
        listed = ", ".join(f"±{np.degrees(t.swing):.3g}° at {t.frequency:.2g} Hz" for t in same)
        return f"the amplitudes did not come together ({listed}): {APART}"
    if found is None:
        return ""
    if abs(found.rate) > _RATE * found.rate_error and abs(found.rate) > _RATE_LEAST:
        return (
            f"the stiffness depends on the rate: {100 * found.rate:+.0f} % a decade of frequency "
            f"(± {100 * found.rate_error:.0f}); tones then do not determine the muscles' strengths"
        )
    worst = max(found.errors["g1"] / abs(found.strengths[0]), found.errors["g2"] / abs(found.strengths[1]))
    if not worst < 0.15:
        return f"the excitation is too small: the strengths are known to ± {100 * min(worst, 9.99):.0f} % only"
    if found.disagreement > 6:
        return f"the frequencies disagree: {found.disagreement:.1f} times their errors"
    return ""


def why_implausible(strengths: tuple[float, float]) -> str:
    """Return that no muscle differs so much from its model, or ""."""
    one, two = strengths
    if all(_PLAUSIBLE[0] <= g <= _PLAUSIBLE[1] for g in strengths):
        return ""
    return (
        f"the muscles would pull {one:.3g} and {two:.3g} times as hard as their models: check the inertia [kg·m²], the "
        "units and signs of angle and pressures, and which muscle is the agonist"
    )


def why_rubber(tones: list[Tone], curve: list[Tone], found: Solution, inertia: float) -> str:
    """Return that the losses are not those of hysteresis, since the joint does not soften by (S6), or ""."""
    narrow, wide = tones[:2], max((*curve, tones[WIDER]), key=lambda tone: tone.swing)
    rows = np.array([_stiffness(tone, found, inertia) for tone in (*narrow, wide)])
    (K, h), (K_wide, h_wide) = rows[:2].mean(axis=0), rows[2]
    A = float(np.mean([tone.swing for tone in narrow]))
    rest = (h_wide * wide.swing - h * A) / (wide.swing - A)  # h = rest + c/A, and (S6) from A to the wide swing
    least = pi / 4 * (rest * log(wide.swing / A) + h - h_wide)
    error = sqrt(sum(tone.error**2 for tone in narrow) / 4 + wide.error**2)
    if least - (K - K_wide) <= _SOFTENS * error:
        return ""
    return (
        f"the stiffness depends on the rate: hysteresis with these losses would soften the joint by {least:.2g} N·m/rad"
        f" at ±{np.degrees(wide.swing):.2g}°, not by {K - K_wide:.2g}; tones then do not determine the muscles'"
        " strengths"
    )


def _stiffness(tone: Tone, found: Solution, inertia: float) -> tuple[float, float]:
    """Return the secant K_felt and h of a tone [N·m/rad]."""
    loop, g = tone.loop(found.values["age"]), np.array(found.strengths)
    K = secant(tone, g, found.values["age"], inertia, found.values["D"])
    return K, float(g @ np.array(loop.losses)) - found.values["D"] * loop.velocity
