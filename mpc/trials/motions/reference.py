"""References to follow: joint angles and stiffness over time."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.units import DEG

LONGEST = 1_000_000  # samples, nearly three hours at 10 ms
_SWING = 0.05  # [-] of the range of all samples


@dataclass(frozen=True, eq=False)
class Reference:
    """Trajectory given by samples: a smooth curve between them, constant after the last. Read-only.

    For an arm with n joints, there are rows of angles and matrices of stiffness.
    """

    t: Array  # (M,) increasing [s]
    theta: Array  # (M,) or (M, n) [rad]
    K: Array  # (M,) positive [N·m/rad], or (M, k, k) of the joints [N·m/rad], of an endpoint [N/m]
    name: str = ""
    tail: float = 0.0  # at the end, for preview only [s]

    def __post_init__(self) -> None:
        t, theta = checks.real("t", self.t, "s"), checks.angle("theta", self.theta)
        K = checks.stiffness("K", self.K) if theta.ndim < 2 else checks.real("K", self.K, "N·m/rad")
        if t.ndim != 1 or t.size < 2 or not t.shape == theta.shape[:1] == K.shape[:1] or K.ndim > 2 * theta.ndim - 1:
            shapes = f"{t.shape}, {theta.shape}, {K.shape}"
            raise InvalidInput(f"t, theta and K have to be rows of one length, 2 or more; their shapes are {shapes}")
        if (falls := np.diff(t) <= 0).any():
            i = int(np.argmax(falls)) + 1
            raise InvalidInput(f"t[{i}] = {t[i]:g} s does not come after t[{i - 1}] = {t[i - 1]:g} s")
        if not 0 <= checks.number("tail", self.tail, "s") < t[-1] - t[0]:
            raise InvalidInput(f"tail = {self.tail:g} s has to be 0 or more, and less than all of the reference")
        for name, array in (("t", t), ("theta", theta), ("K", K)):
            array = array.copy()
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @classmethod
    def of(
        cls, name: str, duration: float, at: Callable[[Array], tuple[Array, Array]], tail: float = 1.0, dt: float = 0.01
    ) -> Self:
        """Return samples every `dt` [s] of the formula `at(t)`, angles and stiffness at times (M,), for `duration` [s]
        and a `tail` [s] in which the motion continues.
        """
        if not 0 < checks.number("duration", duration, "s") <= 3600:
            raise InvalidInput(f"duration = {duration:g} s has to be above 0 and at most an hour")
        t = dt * np.arange(round((duration + tail) / dt) + 1.0)
        return cls(t, *at(t), name, float(t[-1]) - dt * round(duration / dt))

    @property
    def duration(self) -> float:
        """Time [s] from the first sample to the last, without the tail."""
        return float(self.t[-1] - self.t[0]) - self.tail

    def samples(self, dt: float) -> int:
        """Return the number of samples of `dt` [s] after the first one.

        Raises `InvalidInput` for none or over a million.
        """
        if not checks.number("dt", dt, "s") > 0:
            raise InvalidInput(f"dt = {dt:g} s has to be a sample time above 0 s")
        span = self.duration
        steps = span / dt * (1 + 1e-12)
        if not steps <= LONGEST:
            raise InvalidInput(
                f"the reference takes {span:.6g} s, which is {steps:.3g} samples of dt = {dt:g} s; at most "
                f"{LONGEST:,} are taken"
            )
        if steps < 1:
            raise InvalidInput(f"the reference takes {span:.6g} s, which is less than one sample of dt = {dt:g} s")
        return int(steps)

    def resampled(self, dt: float) -> Self:
        """Return this reference every `dt` [s], from the first sample to the last one that fits.

        Raises `InvalidInput` for fewer than two samples and for over a million.
        """
        steps = self.samples(dt)
        ahead = int(self.tail / dt * (1 + 1e-12))
        t = self.t[0] + dt * np.arange(steps + ahead + 1)
        return replace(self, t=t, theta=_smooth(self.t, self.theta, t), K=_smooth(self.t, self.K, t), tail=ahead * dt)

    @property
    def middle(self) -> tuple[Value, Value]:
        """Middle of the ranges of angles [rad] and stiffness [N·m/rad], entry by entry."""
        theta, K = ((values.min(axis=0) + values.max(axis=0)) / 2 for values in (self.theta, self.K))
        return theta, K

    def __repr__(self) -> str:
        return f"Reference{f' {self.name}' * bool(self.name)}: {self.t.size} samples, {self.summary()}"

    def summary(self, unit: str = "") -> str:
        """Return one line with the ranges of angle and stiffness and the duration.

        The stiffness of a joint is in N·m/rad, the entries of an arm's are in the `unit` of its plant.
        """
        angles, stiffnesses = (f"{a.min():.3g} … {a.max():.3g}" for a in (self.theta / DEG, self.K))
        name, unit = ("entries of K", unit) if self.K.ndim > 1 else ("stiffness", "N·m/rad")
        return f"angle {angles}°, {name} {stiffnesses}{f' {unit}' * bool(unit)}, {self.duration:.3g} s"

    def preview(self, k: int, N: int) -> tuple[Array, Array]:
        """Return angles and stiffness (N+1, …) from sample `k` on; the last one is held."""
        if k + N < self.t.size:
            return self.theta[k : k + N + 1].copy(), self.K[k : k + N + 1].copy()
        ahead = np.minimum(np.arange(k, k + N + 1), self.t.size - 1)
        return self.theta[ahead], self.K[ahead]


def _smooth(t: Array, y: Array, at: Array) -> Array:
    """Return a cubic spline through the samples; a monotone one if that swings far beyond the samples next to it.

    The second is for steps in coarse samples, at which the overshoot of a cubic spline is unbounded.
    """
    from scipy.interpolate import CubicSpline, PchipInterpolator

    if y.ndim > 1:
        columns = [_smooth(t, column, at) for column in y.reshape(t.size, -1).T]
        return np.stack(columns, axis=-1).reshape(at.size, *y.shape[1:])
    at = np.minimum(at, t[-1])
    spline = np.asarray(CubicSpline(t, y)(at))
    i = np.clip(np.searchsorted(t, at, side="right") - 1, 0, t.size - 2)
    low, high = np.minimum(y[i], y[i + 1]), np.maximum(y[i], y[i + 1])
    swing = np.maximum(low - spline, spline - high).max()
    return spline if swing <= _SWING * np.ptp(y) else np.asarray(PchipInterpolator(t, y)(at))


def min_jerk(s: Array) -> Array:
    """Return the shape of a minimum-jerk movement: from 0 to 1 as `s` goes from 0 to 1 (Flash & Hogan 1985)."""
    s = np.clip(np.asarray(s, float), 0, 1)
    return s**3 * (10 - 15 * s + 6 * s**2)


def times(duration: float, dt: float) -> Array:
    """Return the times (M,) [s] of samples of `dt` from 0 to `duration` [s]. Raises `InvalidInput` for too many."""
    if not duration <= LONGEST * dt:
        raise InvalidInput(f"a duration of {duration:g} s has over {LONGEST:.0e} samples of {dt:g} s")
    return np.asarray(dt * np.arange(round(duration / dt) + 1.0))


def sine(
    amplitude: float = 40 * DEG,
    frequency: float = 0.5,
    K: float = 7.6,
    K_amplitude: float = 0.3,
    K_frequency: float = 0.25,
    duration: float = 12.0,
    ramp: float = 2.0,
    dt: float = 0.02,
) -> Reference:
    """Return sines of angle [rad] and stiffness [N·m/rad] about 0 and `K`, frequencies in Hz, times in s.

    Both amplitudes rise smoothly (twice differentiable) during the first `ramp` seconds and fall during the last, so
    that the joint begins and ends at rest, like a real one. `ramp=0` starts and stops in full motion.
    """
    checks.number("amplitude", amplitude, "rad")
    for name, value in (("K", K), ("K_amplitude", K_amplitude)):
        checks.number(name, value, "N·m/rad")
    for name, value in (("duration", duration), ("ramp", ramp), ("dt", dt)):
        checks.number(name, value, "s")
    if not (duration > 0 and 0 <= 2 * ramp <= duration and 0 < dt <= duration):
        raise InvalidInput(f"duration = {duration:g} s has to cover two ramps of {ramp:g} s and a dt of {dt:g} s")
    for name, value in (("frequency", frequency), ("K_frequency", K_frequency)):
        if abs(checks.number(name, value, "Hz")) * dt >= 0.5:
            raise InvalidInput(f"{name} = {value:g} Hz needs over two samples a period, and dt is {dt:g} s")
    t = times(duration, dt)
    rest = np.minimum(t, duration - t)  # time to the nearer end
    swell = min_jerk(rest / ramp) if ramp > 0 else np.ones_like(t)
    theta = amplitude * swell * np.sin(2 * np.pi * frequency * t)
    return Reference(t, theta, K + K_amplitude * swell * np.sin(2 * np.pi * K_frequency * t))
