"""A cubic spline through samples is evaluated by the same formula for numbers and CasADi symbols."""

from collections.abc import Sequence
from functools import cached_property

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
        self._spline = CubicSpline(x, y)
        self.x, self._pieces = x, self._spline.c  # (n,), (4, n-1)

    @cached_property
    def _integrals(self) -> Array:
        """Return the pieces (5, n-1) of the integral from the first sample."""
        return np.asarray(self._spline.antiderivative().c)

    def __call__(self, x: Value, order: int = 0) -> Value:
        """Return y(x), or its derivative of the given order (0, 1, 2)."""
        start, c = self._piece(x, self._pieces)
        h = x - start
        if order == 0:
            return ((c[0] * h + c[1]) * h + c[2]) * h + c[3]
        return (3 * c[0] * h + 2 * c[1]) * h + c[2] if order == 1 else 6 * c[0] * h + 2 * c[1]

    def integral(self, x: Value) -> Value:
        """Return ∫ y from the first sample to x."""
        start, c = self._piece(x, self._integrals)
        h = x - start
        return (((c[0] * h + c[1]) * h + c[2]) * h + c[3]) * h + c[4]

    def _piece(self, x: Value, rows: Array) -> tuple[Value, Value]:
        """Return where the piece of x begins, and its coefficients."""
        if is_symbol(x):
            passed = [x >= knot for knot in self.x[1:-1].tolist()]
            start, *c = (_staircase(row.tolist(), passed) for row in (self.x[:-1], *rows))
            return start, c
        i = np.clip(np.searchsorted(self.x, x, side="right") - 1, 0, self.x.size - 2)
        return self.x[i], rows[:, i]


def _staircase(values: list[float], passed: list[Value]) -> Value:
    """Return the first of `values`, or the one after the last knot that is `passed` (casadi.pw_const takes no MX)."""
    return values[0] + sum((b - a) * step for a, b, step in zip(values, values[1:], passed, strict=False))


def _first_fall(x: Array) -> int:
    return int(np.argmin(np.diff(x) > 0))
