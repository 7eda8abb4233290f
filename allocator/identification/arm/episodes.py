"""Episodes of a moving arm, and windows cut from them for free runs.

An episode is a stretch of rows at even times. A window is a free run: it begins at a measured state, after which a
model receives only the measured pressures.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput

_BROKEN = 0.06  # [rad] between the step of an angle and that of its speed; more is a jump of the clock
LEAST_ROWS = 10
_SAME_STEP = 0.05


@dataclass(frozen=True)
class Episode:
    """Measured rows of an arm with m joints and k muscles at even times; `name` tells episodes apart."""

    q: Array  # angles (n, m) [rad]
    v: Array  # speeds (n, m) [rad/s]
    p: Array  # measured pressures (n, k), in any unit
    step: float  # between rows [s]
    name: str = ""

    @classmethod
    def checked(
        cls, q: ArrayLike, p: ArrayLike, step: float, *, v: ArrayLike | None = None, name: str = ""
    ) -> tuple[Self, ...]:
        """Return the stretches of these rows in which the angles follow the speeds.

        Parameters
        ----------
        q, p
            Angles (n, m) [rad] and measured pressures (n, k), any unit.
        step
            Time between rows [s].
        v
            Speeds (n, m) [rad/s]; by default differences of the angles, without cuts at jumps of the clock.
        name
            Name of the episode in errors and splits.

        Raises
        ------
        InvalidInput
            For arrays of other shapes, for numbers that are not finite, and for k other than 2 m.
        """
        q, p = np.atleast_2d(checks.real("q", q, "rad")), np.atleast_2d(checks.real("p", p, "any unit"))
        if q.ndim != 2 or p.ndim != 2 or len(q) != len(p) or p.shape[1] != 2 * q.shape[1] or not step > 0:
            raise InvalidInput(
                f"{name or 'episode'}: angles (n, m) and pressures (n, 2 m) at a positive step expected, not "
                f"{q.shape}, {p.shape} and {step:g} s"
            )
        if v is None:
            return (cls(q, np.diff(q, axis=0, prepend=q[:1]) / step, p, step, name),)
        v = np.atleast_2d(checks.real("v", v, "rad/s"))
        if v.shape != q.shape:
            raise InvalidInput(f"{name or 'episode'}: speeds {v.shape} for angles {q.shape}")
        whole = cls(q, v, p, step, name)
        return tuple(whole._part(i, j) for i, j in whole._stretches() if j - i >= LEAST_ROWS)

    def _stretches(self) -> list[tuple[int, int]]:
        error = np.diff(self.q, axis=0) - self.step * (self.v[1:] + self.v[:-1]) / 2
        cuts = np.flatnonzero(np.abs(error).max(axis=1) > _BROKEN) + 1
        return list(zip([0, *cuts.tolist()], [*cuts.tolist(), len(self.q)], strict=True))

    def _part(self, i: int, j: int) -> Self:
        return type(self)(self.q[i:j], self.v[i:j], self.p[i:j], self.step, self.name)


class Windows(NamedTuple):
    """Free runs of h steps: rows 0 and 1 are the past, row 1 is the measured state from which a run begins."""

    q: Array  # (w, h + 2, m) [rad]
    v: Array  # (w, h + 2, m) [rad/s]
    p: Array  # (w, h + 2, k)
    step: float  # [s]
    episode: NDArray[np.str_]  # names (w,)

    @classmethod
    def cut(cls, episodes: Sequence[Episode], steps: int, every: int, *, first: int = 8) -> Self:
        """Return the windows of `steps` steps that begin at row `first` of every stretch and `every` rows later.

        Raises `InvalidInput` if no episode is long enough, and for episodes of different arms or steps.
        """
        for e in episodes:
            if e.q.shape[1] != episodes[0].q.shape[1] or abs(e.step / episodes[0].step - 1) > _SAME_STEP:
                raise InvalidInput(
                    f"{e.name} has {e.q.shape[1]} joints and rows {e.step:g} s apart, {episodes[0].name} has "
                    f"{episodes[0].q.shape[1]} and {episodes[0].step:g} s: episodes of one arm at one rate expected"
                )
        found = [(e, i) for e in episodes for i in range(first, len(e.q) - steps, every)]
        if not found:
            raise InvalidInput(f"no episode has the {first + steps + 1} rows that a free run of {steps} steps needs")
        rows = [np.stack([getattr(e, part)[i - 1 : i + steps + 1] for e, i in found]) for part in ("q", "v", "p")]
        return cls(rows[0], rows[1], rows[2], found[0][0].step, np.array([e.name for e, _ in found]))

    def only(self, keep: NDArray[np.bool_]) -> Self:
        """Return the windows (w,) to keep."""
        return self._replace(q=self.q[keep], v=self.v[keep], p=self.p[keep], episode=self.episode[keep])

    @property
    def future(self) -> Array:
        """Measured angles (w, h, m) [rad] after the beginning of the run."""
        return self.q[:, 2:]

    @property
    def horizon(self) -> int:
        """Number of steps of a run."""
        return int(self.q.shape[1]) - 2
