"""Interface of observers, and the simplest one, which differentiates the angles.

In readings, pressures that look like bar and angles that look like degrees are pointed out, once. They are not refused,
because the pressures of a vented joint are as low, and a control loop goes on with any numbers. A joint that starts
without pressure does not show its unit, so that readings are checked until one does.
"""

import warnings
from math import isfinite, tau
from typing import Protocol, runtime_checkable

import numpy as np

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput


@runtime_checkable
class Observer(Protocol):
    """Estimator of the state from the readings of the sensors, sample by sample."""

    def reset(self) -> None:
        """Forget the past samples."""

    def estimate(self, y: Array, u: Array) -> tuple[Array, Value]:
        """Return the state (2n + m,) and disturbance torque [N·m], (n,) of an arm, from `y` (2n + m,), NaN where
        unmeasured.

        `u` (m,) [Pa] is the last command sent.
        """


def check_observer(observer: object, dt: float) -> None:
    """Raise `InvalidInput` unless `observer` is one, for samples of `dt` [s]."""
    checks.instance("observer", observer, Observer, "an observer, such as a KalmanObserver")
    if (own := getattr(observer, "dt", dt)) != dt:
        raise InvalidInput(f"dt = {own:g} s of the observer is not the dt = {dt:g} s of the controller")


class Differentiator:
    """Differentiation in place of an observer: an unmeasured velocity is the difference of the last two angles."""

    def __init__(self, dt: float, n: int = 1) -> None:
        self.dt, self.n = dt, n
        self.reset()

    def reset(self) -> None:
        """Forget the past samples."""
        self.angles: Array | None = None  # (n,)
        self._units_shown = False

    def estimate(self, y: Array, u: Array) -> tuple[Array, float]:
        """Return `y` (2n + m,) with the velocities filled in, and no disturbance torque.

        Warns (`BadNumbers`) if the first pressures above 0 look like bar.
        """
        x, n = np.array(y), self.n
        if not self._units_shown:
            self._units_shown = units_shown("y", x[2 * n :], stacklevel=2)
        now, speed = x[:n].copy(), x[n : 2 * n]  # a view
        if np.isnan(speed).any():
            difference = np.zeros(n) if self.angles is None else (now - self.angles) / self.dt
            speed[:] = np.where(np.isnan(speed), difference, speed)
        self.angles = now
        return x, 0.0


_NONE = np.empty(0)
_DEGREES = 720.0  # greatest angle [°] of a joint; greater numbers are no readings at all


class BadNumbers(UserWarning):
    """Warning of implausible references, torques or readings. For the first two the controller holds the pressures."""


def units_shown(name: str, pressures: Array, angles: Array = _NONE, stacklevel: int = 3) -> bool:
    """Return whether the `pressures` [Pa] in `name` show their unit, which those of a vented joint do not.

    Warns (`BadNumbers`) of pressures that look like bar and of `angles` [rad] that look like degrees; NaN passes.
    `stacklevel` as in `warnings.warn`, from the function that calls this one.
    """
    low, high = checks.LOOKS_LIKE_BAR
    greatest = max([abs(P) for P in pressures.tolist() if isfinite(P)], default=0.0)
    turned = np.array([theta for theta in angles.tolist() if tau < abs(theta) <= _DEGREES])
    if not (low <= greatest <= high or turned.size):
        return greatest > high
    try:
        checks.angle(f"angles of {name}: θ", turned)
        checks.pressure(f"pressures of {name}: P", pressures[np.isfinite(pressures)])
    except InvalidInput as wrong:
        warnings.warn(str(wrong), BadNumbers, stacklevel=stacklevel + 1)
    return True
