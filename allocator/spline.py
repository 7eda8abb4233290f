"""A cubic spline through samples is evaluated by the same formula for numbers and CasADi symbols."""

from collections.abc import Sequence

import numpy as np

from allocator.calculus import Array, Value, is_symbol
from allocator.errors import InvalidInput


class Spline:
    """The spline y(x) is cubic and not-a-knot (coefficients from SciPy), continued by its end pieces outside the
    samples.
    """

    def __init__(self, x: Sequence[float] | Array, y: Sequence[float] | Array, name: str = "table") -> None:
        """Interpolate the samples `y` [n] at the increasing `x` [n], three (a parabola) or more.

        `name` is used in the errors.
        """
        from scipy.interpolate import CubicSpline

        x, y = np.array(x, float), np.array(y)
        y = y if y.dtype == complex else y.astype(float)  # complex: a derivative with respect to the samples
        if x.ndim != 1 or x.shape != y.shape or x.size < 3:
            raise InvalidInput(f"{name}: needs two rows of at least 3 samples, got shapes {x.shape} and {y.shape}")
        if not (np.isfinite(x).all() and np.isfinite(y).all()):
            raise InvalidInput(f"{name}: a sample is not a finite number")
        if not (np.diff(x) > 0).all():
            raise InvalidInput(f"{name}: the first row has to increase; it does not after index {_first_fall(x)}")
        self.x, self._pieces = x, CubicSpline(x, y).c  # (n,), (4, n-1)

    def __call__(self, x: Value, order: int = 0) -> Value:
        """Return y(x), or its derivative of the given order (0, 1, 2)."""
        start, c = self._piece_symbol(x) if is_symbol(x) else self._piece_number(x)
        h = x - start
        if order == 0:
            return ((c[0] * h + c[1]) * h + c[2]) * h + c[3]
        return (3 * c[0] * h + 2 * c[1]) * h + c[2] if order == 1 else 6 * c[0] * h + 2 * c[1]

    def _piece_number(self, x: Value) -> tuple[Array, Array]:
        i = np.clip(np.searchsorted(self.x, x, side="right") - 1, 0, self.x.size - 2)
        return self.x[i], self._pieces[:, i]

    def _piece_symbol(self, x: Value) -> tuple[Value, list[Value]]:
        passed = [x >= knot for knot in self.x[1:-1].tolist()]
        start, *c = (_staircase(row.tolist(), passed) for row in (self.x[:-1], *self._pieces))
        return start, c


def _staircase(values: list[float], passed: list[Value]) -> Value:
    """Return the first of `values`, or the one after the last knot that is `passed` (casadi.pw_const takes no MX)."""
    return values[0] + sum((b - a) * step for a, b, step in zip(values, values[1:], passed, strict=False))


def _first_fall(x: Array) -> int:
    return int(np.argmin(np.diff(x) > 0))


__all__ = ["Spline"]
