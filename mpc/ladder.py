"""The fallback ladder: what is commanded at a sample, best first.

    QP          what the proved solution of the QP says
    SOFTENED    the answer of `mpc.softened`, where the QP has none that is proved
    PREVIOUS    the last of these plans goes on where it was, at most to its end
    ALLOCATION  the feed-forward, approached as the limits allow
    HOLD        the commands stay where they are, and after a while both pressures are let out slowly

A rung is stood on only if its commands and the motion that the model predicts for them are finite. Whoever does not
know the angle any more stands on the last: a prediction without it drifts away. Where there is no finite prediction at
all, the plan says that everything stays as it was last known. Letting out keeps the ratio of the two pressures, and
with it about the angle. The next good sample leads back to the first rung.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.limits import Limits
from mpc.plan import Rung


@dataclass
class Ladder:
    """It remembers the commands of the last plan as they are to be heard."""

    limits: Limits
    dt: float  # [s]
    holding: float = 0.5  # how long pressures are held before they are let out [s]
    venting: float = 0.5 * BAR  # how fast the higher of them then falls [Pa/s]

    def __post_init__(self) -> None:
        """Begin."""
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._u: Array | None = None  # the commands of the last plan (N, 2)
        self._left = 0  # samples to the end of the last plan that was optimised
        self._held = 0  # samples spent on the last rung

    def u_last(self, x: Array) -> Array:
        """The command (2,) of the sample before; the pressures in `x` (4,) if there was none."""
        return x[2:] if self._u is None else self._u[0]

    def onward(self, u_star: Array) -> Array:
        """The last plan moved on by one sample, its new end moving as the feed-forward `u_star` (N, 2) does."""
        if self._u is None:
            return u_star
        on = np.empty_like(self._u)
        on[:-1], on[-1] = self._u[1:], self._u[-1]
        turn = u_star[-1] - u_star[-2]
        if isfinite(turn[0]) and isfinite(turn[1]):
            on[-1] += turn
        return on

    def rungs(self, best: tuple[Rung, Array] | None, u_star: Array, u_last: Array) -> Iterator[tuple[Rung, Array]]:
        """Commands (N, 2) to try, from what optimisation gave, if anything, down to `hold`, which is not among them."""
        if best is not None:
            yield best
        if self._left > 1:
            yield Rung.PREVIOUS, self.limits.limited(u_last, self.onward(u_star))
        yield Rung.ALLOCATION, self.limits.limited(u_last, u_star)

    def hold(self, N: int, u_last: Array) -> Array:
        """The commands (N, 2) of the last rung."""
        low = self.limits.pressure[0]
        u, wanted = u_last, np.empty((N, u_last.size))
        for k in range(N):
            if (self._held + k) * self.dt >= self.holding:
                above = u - low
                fall = self.venting * self.dt / max(float(above.max()), self.venting * self.dt)
                u = u - fall * above
            wanted[k] = u
        return self.limits.limited(u_last, wanted)

    def stand(self, rung: Rung, u: Array) -> None:
        """Remember that `u` (N, 2) of `rung` is commanded."""
        self._u = u
        if rung in (Rung.QP, Rung.SOFTENED):
            self._left = len(u)
        else:
            self._left = self._left - 1 if rung is Rung.PREVIOUS else 0
        self._held = self._held + 1 if rung is Rung.HOLD else 0


__all__ = ["Ladder"]
