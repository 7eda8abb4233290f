"""Steady loops of sampled tones: stiffness and work for any waveform.

A signal y(t) ≈ c + d t + Re Σ_h Y_h e^{i h ω t} over whole periods is fitted by least squares. A rate-independent
hysteresis that swings between ±A has the same torque at an angle, upwards and downwards, for any waveform. A loop is
therefore described by quantities that do not depend on the waveform, with odd harmonics (even ones cancel between both
halves):

    s_i = [T_i(θ_max) - T_i(θ_min)]/(2A)      secant of the torque of muscle i
    a   = -[θ''(θ_max) - θ''(θ_min)]/(2A)     of the acceleration; ω² of a sine
    m_i = ∮ T_i θ |dθ|/∮ θ² |dθ|              mean stiffness over the stroke
    b   = ½ ∮ |θ'|³ dt/∮ θ² |dθ|              of the acceleration, since ∮ θ'' θ |dθ| = -½ ∮ |θ'|³ dt; ω² of a sine
    w_i = ∮ T_i dθ/(π A²)                     work as a loss stiffness
    v   = ∮ θ' dθ/(π A²)                      of the velocity; ω of a sine

The secant needs the acceleration at the turns, to which friction that reverses there adds harmonics that a sampled tone
lacks; the mean does not, and compares tones of different frequencies. `mpc.bench.measuring.springs` has the felt
stiffness.

Readings of the angle with the age δ are advanced in phase, θ_h e^{i h ω δ}.
"""

from dataclasses import dataclass
from math import pi, sqrt
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array

HARMONICS = 11  # number of fitted harmonics, at most
_FASTEST, _SAMPLES = 15, 3  # [Hz] of a loop's harmonics; samples per period of any harmonic, at least
_GRID = 720  # points per period in the search for its turns


class Loop(NamedTuple):
    """Steady loop of a tone; stiffnesses in N·m/rad, of torques by the model."""

    swing: float  # A [rad]
    secants: tuple[float, float]  # s_i
    acceleration: float  # a [1/s²]
    means: tuple[float, float]  # m_i
    mean_acceleration: float  # b [1/s²]
    losses: tuple[float, float]  # w_i
    velocity: float  # v [1/s]


@dataclass(frozen=True)
class Tone:
    """Tone of one `frequency` [Hz]: harmonics of angle and model torques, and the quality of their measurement."""

    frequency: float  # [Hz]
    harmonics: Array  # complex (n, 3): θ [rad], T_1, T_2 [N·m] at measured pressures and the angle at rest
    noise: tuple[float, float, float]  # standard deviations of a phasor of each
    coherence: float  # share of the angle's variance that is the tone and its harmonics [-]
    middle: tuple[float, float, float]  # means of angle [rad] and pressures [Pa]
    mean_torque: tuple[float, float]  # of the model [N·m]

    @property
    def omega(self) -> float:
        """ω [rad/s]."""
        return 2 * pi * self.frequency

    @property
    def odd(self) -> list[int]:
        """Harmonics of its loop."""
        return [h for h in range(1, len(self.harmonics) + 1, 2) if h == 1 or h * self.frequency < _FASTEST]

    @property
    def swing(self) -> float:
        """A [rad], half the distance between the turns."""
        return self.loop().swing

    @property
    def error(self) -> float:
        """Standard deviation of a secant of both torques due to noise [N·m/rad], for strengths of 1."""
        angle, one, two = self.noise
        found = self.loop()
        size = abs(sum(found.secants)) + abs(sum(found.losses))
        return sqrt(one**2 + two**2 + (angle * size) ** 2) / found.swing

    @property
    def acceleration_error(self) -> float:
        """Standard deviation of a loop's mean acceleration due to noise [1/s²]."""
        return self.noise[0] * self.omega**2 / self.swing

    def phasors(self, age: float = 0.0) -> tuple[Array, Array]:
        """Return the odd harmonics (n,) and their phasors (n, 3), with readings of the angle that are `age` [s] old."""
        h = np.array(self.odd)
        Y = self.harmonics[h - 1] * 1.0
        Y[:, 0] *= np.exp(1j * h * self.omega * age)
        return h, Y

    def loop(self, age: float = 0.0) -> Loop:
        """Return the loop with readings of the angle that are `age` [s] old."""
        h, Y = self.phasors(age)
        phase = np.linspace(0, 2 * pi, _GRID, endpoint=False)
        waves = np.exp(1j * np.outer(phase, h))
        theta, one, two = (waves @ Y).real.T
        speed = np.abs((waves @ (1j * h * self.omega * Y[:, 0])).real)
        turn = np.exp(1j * h * _refined(phase, theta))
        A, up, down = ((turn @ Y).real).tolist()
        acceleration = float((turn @ (Y[:, 0] * (h * self.omega) ** 2)).real)
        work = (h[:, None] * (Y[:, 1:] * Y[:, :1].conj()).imag).sum(axis=0) / A**2

        def over_stroke(y: Array) -> float:
            return float((y * speed).mean() / (theta**2 * speed).mean())

        return Loop(
            swing=A,
            secants=(up / A, down / A),
            acceleration=acceleration / A,
            means=(over_stroke(one * theta), over_stroke(two * theta)),
            mean_acceleration=over_stroke(speed**2) / 2,
            losses=(float(work[0]), float(work[1])),
            velocity=float(self.omega * (h**2 * np.abs(Y[:, 0]) ** 2).sum() / A**2),
        )


def _refined(phase: Array, theta: Array) -> float:
    """Return the phase of the greatest angle, by a parabola through three points about it."""
    k = int(theta.argmax())
    before, here, after = theta[k - 1], theta[k], theta[(k + 1) % theta.size]
    bend = before - 2 * here + after
    shift = 0.0 if bend == 0 else (before - after) / (2 * bend)
    return float(phase[k] + shift * (phase[1] - phase[0]))


def tone_of(t: Array, theta: Array, P: Array, T: Array, frequency: float) -> Tone:
    """Return the tone in samples: times (n,) [s], angles (n,) [rad], pressures [Pa] and torques [N·m] (n, 2)."""
    omega = 2 * pi * frequency
    step = (t[-1] - t[0]) / max(t.size - 1, 1)
    periods = max(int((t[-1] - t[0] + step) * frequency * (1 + 1e-9) + 1e-6), 1)
    keep = t > t[-1] + step / 2 - periods / frequency
    t, theta, P, T = t[keep], theta[keep], P[keep], T[keep]
    n = max(min(HARMONICS, int(1 / (_SAMPLES * step * frequency))), 1)
    waves = [wave(h * omega * t) for h in range(1, n + 1) for wave in (np.cos, np.sin)]
    X = np.stack([np.ones(t.size), t - t.mean(), *waves], axis=1)
    signals = np.column_stack([theta, T])
    c, *_ = np.linalg.lstsq(X, signals, rcond=None)
    left = signals - X @ c
    spread = left.std(axis=0) * sqrt(2 / t.size)
    variance = float(np.var(theta - X[:, :2] @ c[:2, 0]))
    return Tone(
        frequency, c[2::2] - 1j * c[3::2], (float(spread[0]), float(spread[1]), float(spread[2])),
        1 - float(np.var(left[:, 0])) / max(variance, 1e-30),
        (float(theta.mean()), float(P[:, 0].mean()), float(P[:, 1].mean())),
        (float(T[:, 0].mean()), float(T[:, 1].mean())),
    )  # fmt: skip
