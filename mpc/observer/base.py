"""Interface of observers, and the simplest one, which differentiates the angles."""

from typing import Protocol, runtime_checkable

import numpy as np

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from mpc.observer.units import units_shown


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
        self._angles: Array | None = None  # (n,)
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
            difference = np.zeros(n) if self._angles is None else (now - self._angles) / self.dt
            speed[:] = np.where(np.isnan(speed), difference, speed)
        self._angles = now
        return x, 0.0
