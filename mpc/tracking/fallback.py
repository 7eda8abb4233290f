"""Fallback ladder: the sources of a sample's commands, best first.

    QP          the proved solution of the QP
    SOFTENED    commands that are not proved optimal: of an interrupted solver, or of `mpc.tracking.qp.condense`
    PREVIOUS    the remainder of the last such plan, at most to its end
    ALLOCATION  the feed-forward, approached within the limits
    HOLD        constant commands; after a while both pressures are vented slowly

A rung is taken only if its commands and their predicted motion are finite. Without the angle the last rung is taken,
because a prediction without it drifts away. If no prediction is finite, the plan repeats the last known state. Venting
keeps the ratio of the two pressures, and with it roughly the angle. The next valid sample returns to the first rung.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.tracking.limits import Limits
from mpc.tracking.linearise import Motion, Predictor
from mpc.tracking.plan import Deferred, Rung
from mpc.tracking.qp.step import PreviousSample


@dataclass
class Ladder(Deferred):
    """Fallback ladder that remembers the commands of the last plan as they should act on the muscles."""

    _put_off = "motion", "u_star", "_left", "_held"

    limits: Limits
    predictor: Predictor
    holding: float = 0.5  # duration of holding before venting [s]
    venting: float = 0.5 * BAR  # rate at which the higher pressure then falls [Pa/s]

    def __post_init__(self) -> None:
        """Begin."""
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.catch_up()
        self.motion: Motion | None = None  # of the last plan, under the commands as they should act
        self._left = 0  # samples to the end of the last plan that was optimised
        self._held = 0  # samples spent on the last rung
        self.u_star: Array | None = None  # the feed-forward of the previous sample (2,)

    def previous(self, sent: Array, u_star: Array) -> PreviousSample:
        """Return the previous sample; if there was none, `sent` (m,) and the feed-forward `u_star` (m,) [Pa]."""
        u_last = sent if self.motion is None else self.motion.u[0]
        return PreviousSample(u_last, u_star if self.u_star is None else self.u_star)

    def shift(self, u_star: Array) -> Array:
        """Return the last plan shifted by one sample; its new end moves as the feed-forward `u_star` (N, 2) does."""
        if self.motion is None:
            return u_star
        u = self.motion.u
        shifted = np.empty_like(u)
        shifted[:-1], shifted[-1] = u[1:], u[-1]
        turn = u_star[-1] - u_star[-2]
        if isfinite(turn[0]) and isfinite(turn[1]):
            shifted[-1] += turn
        return shifted

    def descend(
        self, x: Array, best: tuple[Rung, Array] | None, blind: bool, u_star: Array, u_last: Array, d: Array
    ) -> tuple[Rung, Motion]:
        """Return the first valid rung and the motion of its commands from `x` (4,) under the torque `d` (N,) [N·m].

        `best` is the result of the optimisation, if there is one; `blind` selects the rung `HOLD`.
        """
        if not blind:
            for rung, u in self.rungs(best, u_star, u_last):
                motion = self.predictor.motion(x, u, d)
                if motion.finite:
                    return rung, motion
        u = self.hold(u_last)
        motion = self.predictor.motion(x, u, d)
        if not motion.finite:
            motion = self.predictor.stationary(x, u) if self.motion is None else self.motion.stationary(u)
        return Rung.HOLD, motion

    def rungs(self, best: tuple[Rung, Array] | None, u_star: Array, u_last: Array) -> Iterator[tuple[Rung, Array]]:
        """Yield commands (N, 2) to try, from the result of the optimisation down to the rung before `hold`."""
        if best is not None:
            yield best
        if self._left > 1:
            yield Rung.PREVIOUS, self.limits.limited(u_last, self.shift(u_star))
        yield Rung.ALLOCATION, self.limits.limited(u_last, u_star)

    def hold(self, u_last: Array) -> Array:
        """Return the commands (N, 2) of the last rung."""
        low, dt = self.limits.pressure[0], self.predictor.dt
        u, wanted = u_last, np.empty((self.predictor.N, u_last.size))
        for k in range(self.predictor.N):
            if (self._held + k) * dt >= self.holding:
                above = u - low
                fall = self.venting * dt / max(float(above.max()), self.venting * dt)
                u = u - fall * above
            wanted[k] = u
        return self.limits.limited(u_last, wanted)

    def remember(self, rung: Rung, motion: Motion, u_star: Array | None = None) -> None:
        """Remember the commands of `motion` on `rung` and their feed-forward `u_star` (2,), if finite."""
        self.motion = motion
        if rung in (Rung.QP, Rung.SOFTENED):
            self._left = len(motion.u)
        else:
            self._left = self._left - 1 if rung is Rung.PREVIOUS else 0
        self._held = self._held + 1 if rung is Rung.HOLD else 0
        if u_star is not None and isfinite(u_star[0]) and isfinite(u_star[1]):
            self.u_star = u_star

    def go_on(self, motion: Motion, u_star: Array) -> None:
        """Remember the `motion` of an ordinary sample and its feed-forward `u_star` (2,)."""
        self.motion, self.u_star, self._left, self._held = motion, u_star, self.predictor.N, 0
