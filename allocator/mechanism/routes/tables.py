"""Muscles whose lengths are known by samples over a grid of postures."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.mechanism.routes.base import RoutedLengths, Routes, check_arms, rest_lengths

_FEWEST = 4  # samples of a joint: what a cubic takes


@dataclass(frozen=True)
class Tables(Routes):
    """`Tables` hold the lengths over a grid of joint angles, joined by tensor products of cubic splines."""

    grid: tuple[tuple[float, ...], ...]  # n rows of angles [rad], increasing
    lengths: tuple[Any, ...] = field(repr=False)  # nested: (n1, …, nn, m) [m]

    def __init__(self, rest_length: Any, grid: Sequence[Any], lengths: Any) -> None:
        """Check and keep `grid`, n rows of angles [rad], and `lengths` (n1, …, nn, m) [m]. Raises `InvalidInput`."""
        rows = [checks.angle(f"Tables: grid[{i}]", row) for i, row in enumerate(grid)]
        l_ = checks.real("Tables: lengths", lengths, "m")
        for i, row in enumerate(rows):
            if row.ndim != 1 or row.size < _FEWEST or not (np.diff(row) > 0).all():
                raise InvalidInput(f"Tables: grid[{i}] has to be a row of {_FEWEST} or more increasing angles [rad]")
        shape = tuple(row.size for row in rows)
        if not rows or l_.ndim != len(rows) + 1 or l_.shape[:-1] != shape or not l_.shape[-1]:
            raise InvalidInput(
                f"Tables: lengths have the shape {l_.shape}; the grid of n = {len(rows)} joints and m "
                f"muscles expects ({', '.join(map(str, shape))}, m)"
            )
        object.__setattr__(self, "grid", tuple(tuple(row.tolist()) for row in rows))
        object.__setattr__(self, "lengths", _nested(l_.tolist()))
        object.__setattr__(self, "rest_length", rest_lengths("Tables", rest_length, l_.shape[-1]))
        spread = [np.ptp(l_, axis=i).max(axis=tuple(range(len(rows) - 1))) for i in range(len(rows))]
        check_arms("Tables", np.stack(spread, axis=-1))

    @property
    def n(self) -> int:
        """Return the number of joints."""
        return len(self.grid)

    @cached_property
    def _spline(self) -> Any:
        from scipy.interpolate import NdBSpline, make_interp_spline

        coefficients = np.array(self.lengths)
        knots: list[Any] = []
        for i, row in enumerate(self.grid):
            spline = make_interp_spline(row, coefficients, k=3, axis=i)
            coefficients = np.moveaxis(spline.c, 0, i)
            knots.append(spline.t)

        return NdBSpline(tuple(knots), coefficients, 3, extrapolate=True)

    def at(self, q: Array) -> RoutedLengths:
        """Return lengths, arms and bends at the postures `q` (…, n); beyond the grid the end pieces go on."""
        unit = np.eye(self.n, dtype=int)
        arm = np.empty((*q.shape[:-1], self.m, self.n))
        bend = np.empty((*q.shape[:-1], self.m, self.n, self.n))
        for a in range(self.n):
            arm[..., a] = -self._spline(q, nu=unit[a])
            for b in range(a, self.n):
                bend[..., a, b] = bend[..., b, a] = self._spline(q, nu=unit[a] + unit[b])
        return RoutedLengths(self._spline(q), arm, bend)


def _nested(value: Any) -> Any:
    return tuple(map(_nested, value)) if isinstance(value, list) else value


__all__ = ["Tables"]
