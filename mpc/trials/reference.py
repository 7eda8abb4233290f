"""A reference is what is to be followed: joint angle and stiffness over time."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.units import DEG

LONGEST = 1_000_000  # samples, nearly three hours at 10 ms
_SWING = 0.05  # of the range of all samples


@dataclass(frozen=True, eq=False)
class Reference:
    """A reference is a trajectory by its samples; between them a smooth curve, after the last it stands still.
    Read-only.
    """

    t: Array  # (n,) increasing [s]
    theta: Array  # (n,) [rad]
    K: Array  # (n,) positive [N·m/rad]

    def __post_init__(self) -> None:
        """Check the samples."""
        t = checks.real("t", self.t, "s")
        theta, K = checks.angle("theta", self.theta), checks.stiffness("K", self.K)
        if t.ndim != 1 or t.size < 2 or not t.shape == theta.shape == K.shape:
            shapes = f"{t.shape}, {theta.shape}, {K.shape}"
            raise InvalidInput(f"t, theta and K have to be rows of one length, 2 or more; their shapes are {shapes}")
        if (falls := np.diff(t) <= 0).any():
            i = int(np.argmax(falls)) + 1
            raise InvalidInput(f"t[{i}] = {t[i]:g} s does not come after t[{i - 1}] = {t[i - 1]:g} s")
        for name, array in (("t", t), ("theta", theta), ("K", K)):
            array = array.copy()
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def samples(self, dt: float) -> int:
        """Return how many samples of `dt` [s] come after the first one. Raises `InvalidInput` for over a million."""
        if not checks.number("dt", dt, "s") > 0:
            raise InvalidInput(f"dt = {dt:g} s has to be a sample time above 0 s")
        span = float(self.t[-1] - self.t[0])
        steps = span / dt * (1 + 1e-12)
        if not steps <= LONGEST:
            raise InvalidInput(
                f"the reference takes {span:.6g} s, which is {steps:.3g} samples of dt = {dt:g} s; at most "
                f"{LONGEST:,} are taken"
            )
        return max(int(steps), 1)

    def resampled(self, dt: float) -> Self:
        """Return this reference every `dt` [s], from the first sample to the last one that fits; at least two samples.

        Raises `InvalidInput` for over a million of them.
        """
        steps = self.samples(dt)
        t = self.t[0] + dt * np.arange(steps + 1)
        return type(self)(t, _smooth(self.t, self.theta, t), _smooth(self.t, self.K, t))

    @property
    def summary(self) -> str:
        """Return the ranges of angle and stiffness and the duration, in a line."""
        angles, stiffnesses = (f"{min(a):.3g} … {max(a):.3g}" for a in (self.theta / DEG, self.K))
        return f"angle {angles}°, stiffness {stiffnesses} N·m/rad, {self.t[-1] - self.t[0]:.3g} s"

    def preview(self, k: int, N: int) -> tuple[Array, Array]:
        """Return the angle and stiffness (N+1,) from sample `k` on; the last one is held."""
        ahead = np.minimum(np.arange(k, k + N + 1), self.t.size - 1)
        return self.theta[ahead], self.K[ahead]


def _smooth(t: Array, y: Array, at: Array) -> Array:
    """Return a cubic spline through the samples; a monotone one if that swings far beyond the samples next to it.

    The second is for steps in coarse samples, through which a cubic spline overshoots without bound.
    """
    from scipy.interpolate import CubicSpline, PchipInterpolator

    at = np.minimum(at, t[-1])
    spline = np.asarray(CubicSpline(t, y)(at))
    i = np.clip(np.searchsorted(t, at, side="right") - 1, 0, t.size - 2)
    low, high = np.minimum(y[i], y[i + 1]), np.maximum(y[i], y[i + 1])
    swing = np.maximum(low - spline, spline - high).max()
    return spline if swing <= _SWING * np.ptp(y) else np.asarray(PchipInterpolator(t, y)(at))


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

    Both amplitudes rise smoothly (twice differentiable) during the first `ramp` seconds and fall during the last,
    so that the joint begins and ends at rest, as a real one has to. `ramp=0` starts and stops in full motion.
    """
    if not (duration > 0 and 0 <= 2 * ramp <= duration and 0 < dt <= duration):
        raise InvalidInput(f"duration = {duration:g} s has to cover two ramps of {ramp:g} s and a dt of {dt:g} s")
    t = dt * np.arange(round(duration / dt) + 1.0)
    rest = np.minimum(t, duration - t)  # time to the nearer end
    s = np.clip(rest / ramp, 0, 1) if ramp > 0 else np.ones_like(t)
    swell = s**3 * (10 - 15 * s + 6 * s**2)
    theta = amplitude * swell * np.sin(2 * np.pi * frequency * t)
    return Reference(t, theta, K + K_amplitude * swell * np.sin(2 * np.pi * K_frequency * t))
