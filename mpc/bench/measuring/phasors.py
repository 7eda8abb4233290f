"""Complex amplitudes of sampled tones.

A signal y(t) ≈ c + d t + Re Σ_h Y_h e^{i h ω t} over whole periods is fitted by least squares; Y_1 is its phasor at ω.
Each period for itself gives the scatter of the phasors, hence their standard error.
"""

from dataclasses import dataclass
from math import pi

import numpy as np

from allocator.calculus import Array

HARMONICS = 5  # that are fitted besides; a loop of hysteresis has odd ones
_GRID = 720  # points of a period on which its turns are looked for


@dataclass(frozen=True)
class Phasors:
    """Angle and model torques of one tone of `frequency` [Hz]: their phasors and what they were measured by."""

    frequency: float  # [Hz]
    theta: complex  # Θ [rad], as measured
    torque: tuple[complex, complex]  # Π_i [N·m], of the model at measured pressures and the angle at rest
    ratio_error: tuple[float, float]  # standard errors of Π_i/Θ, of each part [N·m/rad]
    coherence: float  # share of the angle's variance that is the tone and its harmonics [-]
    middle: tuple[float, float, float]  # means of angle [rad] and pressures [Pa]
    turn: float  # secant [T(θ_max) - T(θ_min)]/(θ_max - θ_min) of both torques' sum at the turns [N·m/rad], …
    turns: tuple[float, float]  # … and of each
    swing: float  # half of θ_max - θ_min [rad]
    inertial: float  # secant of the acceleration, -θ''/θ at the turns [1/s²]
    mean_torque: tuple[float, float] = (0.0, 0.0)  # of the model [N·m]
    moved: tuple[float, float] = (0.0, 0.0)  # greatest |θ - middle|, and the pressures' amplitude [Pa]

    @property
    def omega(self) -> float:
        """ω [rad/s]."""
        return 2 * pi * self.frequency

    @property
    def amplitude(self) -> float:
        """A [rad]."""
        return abs(self.theta)


def design(t: Array, omega: float, harmonics: int) -> Array:
    """Return the columns 1, t, cos hωt, sin hωt (n, 2 + 2 harmonics)."""
    waves = [wave(h * omega * t) for h in range(1, harmonics + 1) for wave in (np.cos, np.sin)]
    return np.stack([np.ones(t.size), t - t.mean(), *waves], axis=1)


def amplitudes(t: Array, y: Array, omega: float, harmonics: int = HARMONICS) -> tuple[Array, Array]:
    """Return the phasors Y_h (harmonics, …) of signals (n, …) sampled at `t` (n,) [s], and what is left (n, …)."""
    X = design(t, omega, harmonics)
    c, *_ = np.linalg.lstsq(X, y, rcond=None)
    return c[2::2] - 1j * c[3::2], y - X @ c


def whole_periods(t: Array, omega: float) -> int:
    """Return how many whole periods the samples have."""
    step = (t[-1] - t[0]) / max(t.size - 1, 1)
    return int((t[-1] - t[0] + step) * omega / (2 * pi) * (1 + 1e-9) + 1e-6)


def phasors(t: Array, theta: Array, P: Array, T: Array, frequency: float) -> Phasors:
    """Return the phasors of a tone from samples: times (n,) [s], angles (n,) [rad], pressures and torques (n, 2)."""
    omega = 2 * pi * frequency
    n = whole_periods(t, omega)
    keep = t >= t[-1] - n * 2 * pi / omega
    t, theta, P, T = t[keep], theta[keep], P[keep], T[keep]
    signals = np.column_stack([theta, T, P])
    Y, left = amplitudes(t, signals, omega)
    Theta, Pi = complex(Y[0, 0]), (complex(Y[0, 1]), complex(Y[0, 2]))
    variance = float(np.var(theta - np.polyval(np.polyfit(t - t[0], theta, 1), t - t[0])))
    errors = _ratio_errors(t, signals[:, :3], omega, n, Pi, Theta)
    swing, secants, inertial = _turns(Y, omega)
    return Phasors(
        frequency, Theta, Pi, errors,
        1 - float(np.var(left[:, 0])) / max(variance, 1e-30),
        (float(theta.mean()), float(P[:, 0].mean()), float(P[:, 1].mean())),
        sum(secants), secants, swing, inertial,
        (float(T[:, 0].mean()), float(T[:, 1].mean())),
        (float(np.abs(theta - theta.mean()).max()), float(np.abs(Y[0, 3:]).max())),
    )  # fmt: skip


def _ratio_errors(
    t: Array, signals: Array, omega: float, n: int, Pi: tuple[complex, complex], Theta: complex
) -> tuple[float, float]:
    """Return the standard errors of Π_i/Θ by the scatter of single periods; inf with fewer than two."""
    if n < 2:
        return np.inf, np.inf
    period, found = 2 * pi / omega, []
    for k in range(n):
        here = (t >= t[-1] - (n - k) * period) & (t <= t[-1] - (n - k - 1) * period)
        Y, _ = amplitudes(t[here], signals[here], omega, 1)
        found.append(Y[0, 1:] / Y[0, 0])
    ratios = np.array(found)
    return tuple(float(e) for e in np.sqrt((ratios.real.var(0, ddof=1) + ratios.imag.var(0, ddof=1)) / 2 / n))  # type: ignore[return-value]


def _turns(Y: Array, omega: float) -> tuple[float, tuple[float, float], float]:
    """Return half the swing, the secants of the torques and of the acceleration at the turns of the angle."""
    phase = np.linspace(0, 2 * pi, _GRID, endpoint=False)
    h = np.arange(1, len(Y) + 1)
    waves = np.exp(1j * np.outer(phase, h))
    theta, one, two = (waves @ Y[:, i] for i in range(3))
    acceleration = -(waves @ (Y[:, 0] * (h * omega) ** 2)).real
    high, low = int(theta.real.argmax()), int(theta.real.argmin())
    swing = (theta[high] - theta[low]).real / 2
    secants = tuple(float((T[high] - T[low]).real / (2 * swing)) for T in (one, two))
    return float(swing), secants, float(-(acceleration[high] - acceleration[low]) / (2 * swing))  # type: ignore[return-value]
