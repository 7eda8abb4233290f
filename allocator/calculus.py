"""Formulas for floats, arrays and CasADi symbols: elementary functions, derivatives, monotone root finding, splines.

A formula written with `+ - * / **` and the functions of this file can be evaluated with numbers and with symbols. Its
derivative need not be written by hand: complex step for numbers (exact to rounding, Squire & Trapp 1998), algorithmic
differentiation for symbols.
"""

from collections.abc import Callable, Sequence
from functools import cache, cached_property
from threading import local
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allocator.errors import InvalidInput

Value: TypeAlias = Any  # a float, an array of floats, or a CasADi symbol
Array: TypeAlias = NDArray[np.float64]
Mask: TypeAlias = NDArray[np.bool_]

_NEWTON_STEPS = 60
_STEP = 1e-30  # of the complex step; nothing is subtracted, so it may be as small as one likes
_NESTED = 3e-4  # of the difference quotient: errors of its truncation and of rounding are alike


class _Step(local):
    """Whether this thread takes a complex step: it evaluates the formula of a derivative."""

    taken = False


_step = _Step()


def is_symbol(x: Value) -> bool:
    """Return whether `x` is a CasADi expression (recognised without importing CasADi)."""
    return _of_casadi(type(x))  # type: ignore[arg-type]  # classes are hashable


@cache
def _of_casadi(kind: type) -> bool:
    return kind.__module__.partition(".")[0] == "casadi"


def _elementary(name: str) -> Callable[[Value], Value]:
    numeric: np.ufunc = getattr(np, name)

    def function(x: Value) -> Value:
        kind = type(x)
        if kind is np.ndarray:
            return numeric(x)
        if kind is float or kind is complex:
            return numeric(x).item()  # NumPy scalars upset CasADi further on
        if is_symbol(x):
            import casadi

            return getattr(casadi, name)(x)
        return numeric(x)

    function.__name__ = name
    function.__doc__ = f"`{name}(x)` of a float, an array or a CasADi symbol."
    return function


exp, log, sqrt, sin, cos, tanh = map(_elementary, ("exp", "log", "sqrt", "sin", "cos", "tanh"))


def least(x: Value, y: Value) -> Value:
    """Return the lesser of two floats, arrays or CasADi symbols, element by element."""
    if is_symbol(x) or is_symbol(y):
        import casadi

        return casadi.fmin(x, y)
    return np.minimum(x, y)


def derivative(formula: Callable[[Value], Value], x: Value) -> Value:
    """Return `formula'(x)`, element by element; the formula must be analytic (no `abs`, no `where` on its value).

    Within the formula of another derivative, whose complex step fills the imaginary part, it is the difference quotient
    over x ± 2h with h = 3e-4 max(1, |x|).
    """
    if not is_symbol(x):
        outer = _step.taken
        if outer and np.iscomplexobj(formula(x)):
            return five_point(formula, x, _NESTED * np.maximum(1.0, np.abs(np.real(x))))
        _step.taken = True
        try:
            return formula(x + _STEP * 1j).imag / _STEP
        finally:
            _step.taken = outer
    import casadi

    s = type(x).sym("s")
    return casadi.substitute(casadi.jacobian(type(x)(formula(s)), s), s, x)


STEP = 1e-4  # of `five_point`, in rad or in supply ranges: an error of about 1e-11 of the slope


def five_point(f: Callable[[Value], Value], x: Value, h: Value) -> Value:
    """Return the difference quotient of `f` at `x` over x ± 2h, of fourth order: for functions of real numbers."""
    return (8 * (f(x + h) - f(x - h)) - (f(x + 2 * h) - f(x - 2 * h))) / (12 * h)


def increasing_root(f: Callable[..., Array], lo: Array, hi: Array, *args: Array) -> Array:
    """Return the x in [lo, hi] with f(x, *args) = 0, for f increasing in x; broadcasts.

    -inf where f is positive on all of [lo, hi], +inf where it is negative there, NaN where an argument is. Everything
    that varies from element to element has to come in through `args`: SciPy drops elements as they converge.
    """
    from scipy.optimize import elementwise

    lo, hi, *args = np.broadcast_arrays(lo, hi, *args)  # type: ignore[assignment]  # a list of arrays, not a tuple
    f_lo, f_hi = f(lo, *args), f(hi, *args)
    root = np.where(f_lo > 0, -np.inf, np.where(f_hi < 0, np.inf, np.nan))
    root = np.where(f_lo == 0, lo, np.where(f_hi == 0, hi, root))
    inside = (f_lo < 0) & (f_hi > 0)
    if inside.any():
        found = elementwise.find_root(f, (lo[inside], hi[inside]), args=tuple(a[inside] for a in args))
        root[inside] = found.x
    return root


def falling_root(
    f: Callable[[Array], tuple[Array, Array]],
    start: Array,
    low: Array,
    high: Array,
    close: float,
    there: Mask | slice = slice(None),
) -> Array:
    """Return the x (n,) in [low, high] with y(x) = 0 by Newton's method, where y(low) > 0 > y(high); f gives (y, -y').

    A bracket shrinks with every step and is halved where Newton's method leaves it, or where y does not fall; where f
    ends (NaN) the search turns back to `start`. It is done when no x that is `there` moves by `close` any more.
    """
    x, first, last = start, low, high
    for _ in range(_NEWTON_STEPS):
        y, fall = f(x)
        further = np.where(np.isnan(y), x < start, y > 0)
        low, high = np.where(further, x, low), np.where(further, high, x)
        with np.errstate(all="ignore"):
            newton = x + y / fall
        inside = (newton > low - close) & (newton < high + close) & (fall > 0)
        before, x = x, np.where(inside, newton, (low + high) / 2)
        if np.abs(x - before)[there].max(initial=0.0) < close:
            break
    return np.clip(x, first, last)


def rising_roots(f: Callable[..., Array], lo: Array, hi: Array, *args: Array, pieces: int) -> Array:
    """Return the roots (pieces, …) of f(x, *args) through which f rises, one a piece of [lo, hi].

    They are ±inf where there is none.
    """
    lo, hi, *args = np.broadcast_arrays(lo, hi, *args)  # type: ignore[assignment]  # a list of arrays, not a tuple
    grid = lo + (hi - lo) * np.linspace(0.0, 1.0, pieces + 1).reshape(-1, *[1] * lo.ndim)
    return increasing_root(f, grid[:-1], grid[1:], *args)


class Spline:
    """The spline y(x) is cubic and not-a-knot (coefficients from SciPy), continued by its end pieces outside the
    samples.
    """

    def __init__(self, x: Sequence[float] | Array, y: Sequence[float] | Array, name: str = "table") -> None:
        """Interpolate the samples `y` [n] at the increasing `x` [n], three (a parabola) or more.

        `name` is used in the errors.
        """
        from scipy.interpolate import CubicSpline

        if any(map(is_symbol, y)):
            raise InvalidInput(f"{name}: its samples have to be numbers, not symbols, as of a fitted table that varies")
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
        """Pieces (5, n-1) of the integral from the first sample."""
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
