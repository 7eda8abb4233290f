"""Dense search over the box of pressures for targets of felt stiffness, independent of the library's candidates.

It uses only a joint's torque and felt stiffness at given pressures: the roots of the first goal on the lines of a grid,
and for the weighted cost a grid that contracts around its best point.
"""

from typing import NamedTuple

import numpy as np

from allocator import AntagonistJoint, Limits, Stiffness, allocate
from allocator.calculus import Array

GRID, ZOOM, ZOOMS, STEPS = 61, 13, 9, 9
WEIGHTS = 1.0, 0.03


class Verdict(NamedTuple):
    """Comparison of answers with the search, each (n,)."""

    excess: Array  # advantage of the search, as a share of the scale; 0 if none
    equalled: Array  # whether it is within 1 % of a scale
    inside: Array  # whether the answer is in the box


class Reach:
    """Torques and felt stiffnesses over the box at one angle."""

    def __init__(self, joint: AntagonistJoint, theta: float, amplitude: float, valves: str = "open") -> None:
        self.joint, self.theta, self.amplitude, self.valves = joint, theta, amplitude, valves
        box = joint.pressure_box(np.array([theta]))
        self.ends = [(float(side.lo[0]), float(side.hi[0])) for side in box]
        self.P1, self.P2 = (np.linspace(*ends, GRID) for ends in self.ends)
        self.T, self.K = self.given(self.P1[:, None], self.P2[None])
        self.scales = float(np.abs(self.T).max()), float(np.abs(self.K).max())

    def given(self, P1: Array, P2: Array) -> tuple[Array, Array]:
        """Return torque and felt stiffness."""
        felt = self.joint.stiffness(self.theta, P1, P2, self.valves, amplitude=self.amplitude)
        return np.asarray(self.joint.torque(self.theta, P1, P2)), np.asarray(felt)

    def on_level(self, which: int, wanted: Array, other: Array) -> tuple[Array, Array]:
        """Return the least errors (n,) of the goal `which` and, if it is met, of the other one."""
        error = (self.T, self.K)[which] - wanted[:, None, None]
        first, second = np.abs(error).min(axis=(1, 2)), np.full(wanted.shape, np.inf)
        for axis in (0, 1):
            k, P1, P2 = self._roots(error, axis, which, wanted)
            given = self.given(P1, P2)
            met = np.abs(given[which] - wanted[k]) <= 1e-9 * self.scales[which]
            first[k[met]] = 0.0
            np.minimum.at(second, k[met], np.abs(given[1 - which][met] - other[k[met]]))
        return first, second

    def _roots(self, error: Array, axis: int, which: int, wanted: Array) -> tuple[Array, Array, Array]:
        """Return (target, P1, P2) at sign changes of the errors (n, …) along the grid lines, by the Illinois rule."""
        signs = np.moveaxis(error, axis + 1, 1)
        k, i, j = np.nonzero(signs[:, :-1] * signs[:, 1:] <= 0)
        moving, still = (self.P1, self.P2) if axis == 0 else (self.P2, self.P1)
        u, v, fu, fv, at = moving[i], moving[i + 1], signs[k, i, j], signs[k, i + 1, j], still[j]
        for _ in range(STEPS):
            flat = fu == fv
            x = np.where(flat, u, v - fv * (v - u) / np.where(flat, 1.0, fv - fu))
            fx = self.given(*((x, at) if axis == 0 else (at, x)))[which] - wanted[k]
            crosses = fx * fv < 0
            u, fu = np.where(crosses, v, u), np.where(crosses, fv, fu / 2)
            v, fv = x, fx
        return (k, v, at) if axis == 0 else (k, at, v)

    def least_cost(self, T: Array, K: Array) -> Array:
        """Return the least weighted costs (n,)."""
        cost = self._cost(self.T, self.K, T[:, None, None], K[:, None, None]).reshape(T.size, -1)
        i, j = np.unravel_index(cost.argmin(axis=1), self.T.shape)
        centre, best = [self.P1[i], self.P2[j]], cost.min(axis=1)
        half, steps = [(hi - lo) / (GRID - 1) for lo, hi in self.ends], np.linspace(-1, 1, ZOOM)
        for _ in range(ZOOMS):
            one, two = (
                np.clip(c[:, None] + h * steps, *ends) for c, h, ends in zip(centre, half, self.ends, strict=True)
            )
            cost = self._cost(*self.given(one[:, :, None], two[:, None]), T[:, None, None], K[:, None, None])
            cost = cost.reshape(T.size, -1)
            i, j = np.unravel_index(cost.argmin(axis=1), (ZOOM, ZOOM))
            rows = np.arange(T.size)
            centre, best, half = [one[rows, i], two[rows, j]], np.minimum(best, cost.min(axis=1)), [h / 4 for h in half]
        return np.asarray(best)

    @staticmethod
    def _cost(T: Array, K: Array, t: Array, k: Array) -> Array:
        return np.asarray(WEIGHTS[0] * (T - t) ** 2 + WEIGHTS[1] * (K - k) ** 2)


def targets(reach: Reach, n: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return n torques and stiffnesses: half of them made by pressures in the box, half at random around these."""
    P1, P2 = (rng.uniform(*ends, n) for ends in reach.ends)
    T, K = reach.given(P1, P2)
    apart = np.arange(n) % 2 == 1
    T = np.where(apart, rng.uniform(-1.3, 1.3, n) * reach.scales[0], T)
    K = np.where(apart, rng.uniform(0.1, 1.4, n) * reach.scales[1], np.maximum(K, 1e-3))
    return T, K


def judged(reach: Reach, T: Array, K: Array, priority: str) -> Verdict:
    """Return the search's verdict on the answers of `allocate` at one angle."""
    weights = WEIGHTS if priority == "weighted" else None
    a = allocate(
        reach.theta, K, T, joint=reach.joint, priority=priority, weights=weights, limits=Limits(0.0),  # type: ignore[arg-type]
        stiffness=Stiffness(reach.valves, amplitude=reach.amplitude),
    )  # fmt: skip
    near = [1e-6 * (hi - lo + 1) for lo, hi in reach.ends]
    inside = np.ones(T.shape, bool)
    for P, (lo, hi), d in zip((a.P1, a.P2), reach.ends, near, strict=True):
        inside &= (lo - d <= P) & (hi + d >= P)
    given = reach.given(a.P1, a.P2)
    mine = np.abs(given[0] - T), np.abs(given[1] - K)
    if priority == "weighted":
        unit = WEIGHTS[0] * reach.scales[0] ** 2 + WEIGHTS[1] * reach.scales[1] ** 2
        cost, best = WEIGHTS[0] * mine[0] ** 2 + WEIGHTS[1] * mine[1] ** 2, reach.least_cost(T, K)
        return Verdict(np.maximum(cost - best, 0) / unit, best - cost <= 1e-3 * unit, inside)
    which = 0 if priority == "torque" else 1
    found = reach.on_level(which, (T, K)[which], (T, K)[1 - which])
    (s1, s2) = reach.scales[which], reach.scales[1 - which]
    first = np.maximum(mine[which] - found[0], 0) / s1
    same = found[0] >= mine[which] - 1e-9 * s1
    second = np.where(same & (found[0] <= mine[which] + 1e-9 * s1), np.maximum(mine[1 - which] - found[1], 0) / s2, 0)
    equalled = (found[0] - mine[which] <= 0.02 * s1) & (
        ~np.isfinite(found[1]) | (mine[which] > 1e-9 * s1) | (found[1] - mine[1 - which] <= 0.02 * s2)
    )
    return Verdict(np.where(first > 1e-9, first, second), equalled, inside)
