"""Muscles that are not affine: closure of the gap, and a search by local solvers for costs below the bound.

`python -m benchmarks.mechanisms.nonaffine` takes the arm with six Tondu2021 muscles. The local solvers are SciPy's,
with torque and stiffness written independently from the report's formulas.
"""

import argparse
import time
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from allocator import Allocation, allocate
from allocator.allocation import warm_up
from allocator.mechanism import machines
from allocator.muscles.catalogue import TONDU_DMSP_20_400N
from benchmarks.mechanisms.targets import POSTURE, Targets, random_targets

ARM = machines.arm26().with_muscles(TONDU_DMSP_20_400N)
WEIGHTS = (1.0, 1.0)
UNIT = 5e5  # [Pa]
_KEPT = 1e-8  # [N·m] tolerance of torques
_ROUNDING = 1e-6  # of 1 + cost: corresponding change of the cost
_ALIKE = 1e-3


class Search(NamedTuple):
    """Outcome of the targets of one priority, and of a local solver's starts at the missed ones."""

    priority: str
    allocation: Allocation
    seconds: float
    starts: int
    below: int  # ended below the lower bound
    above: int  # ended above the best known

    def __str__(self) -> str:
        a = self.allocation
        missed, share = ~a.success, 100 * self.above / max(self.starts, 1)
        return (
            f"{self.priority:9} {len(a.P)} targets, {missed.sum()} beyond reach: gap {a.gap.max():.1e} at most, nodes "
            f"{np.median(a.rounds[missed]):.0f} in the median and {a.rounds.max()} at most, optimality "
            f"{a.kkt_residual.max():.0e}, {1e3 * self.seconds / len(a.P):.1f} ms a target; {self.starts} starts: "
            f"{self.below} below the bound, {self.above} ({share:.1f} %) above the best"
        )


def laws(P: np.ndarray, eps: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return F, k, F' and k' (m,) of the report's muscle with c = 0: F = S [(a-b) P - ε e/(P+d)], k = S e/((P+d) L)."""
    muscle, L = TONDU_DMSP_20_400N, 0.4
    assert muscle.c == 0
    S = np.pi * muscle.r0**2
    slope = 3 / np.tan(muscle.alpha0) ** 2 - 1 / np.sin(muscle.alpha0) ** 2  # a - b
    pole = muscle.e / (P + muscle.d)
    fall = -muscle.e / (P + muscle.d) ** 2
    return S * (slope * P - eps * pole), S * pole / L, S * (slope - eps * fall), S * fall / L


class Outside:
    """The errors of one target, from the formulas alone."""

    def __init__(self, t: Targets, i: int):
        arms = np.array(ARM.routes.arms)
        self.eps = 0.1375 + arms @ POSTURE / 0.4
        self.T, self.K = t.T[i], t.K[i]
        self.arms, self.outer = arms, arms[:, :, None] * arms[:, None, :]

    def errors(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return torque and stiffness errors (n,), (n, n), and their derivatives by x = P/UNIT."""
        F, k, dF, dk = laws(x * UNIT, self.eps)
        T, K = F @ self.arms, np.tensordot(k, self.outer, 1)
        return T - self.T, K - self.K, UNIT * dF[:, None] * self.arms, UNIT * dk[:, None, None] * self.outer

    def stiffness_cost(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Return ‖K - K*‖² and its gradient."""
        _, K, _, dK = self.errors(x)
        return float((K**2).sum()), 2 * (dK * K).sum(axis=(1, 2))

    def cost(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Return ‖τ - τ*‖² + ‖K - K*‖² and its gradient."""
        T, K, dT, dK = self.errors(x)
        return float(T @ T + (K**2).sum()), 2 * (dT @ T + (dK * K).sum(axis=(1, 2)))


def ends(t: Targets, i: int, a: Allocation, priority: str, starts: np.ndarray) -> Iterator[float]:
    """Yield SciPy's final cost from each start (S, m) of target i: L-BFGS-B, or SLSQP at the given torque."""
    outside, (lo, hi) = Outside(t, i), a.box
    box = list(zip(lo[i] / UNIT, hi[i] / UNIT, strict=True))
    for x in starts:
        if priority == "weighted":
            yield minimize(outside.cost, x, jac=True, method="L-BFGS-B", bounds=box).fun
            continue
        given = a.T[i] - t.T[i]
        kept = {
            "type": "eq",
            "fun": lambda x, given=given, o=outside: o.errors(x)[0] - given,
            "jac": lambda x, o=outside: o.errors(x)[2].T,
        }
        asked = {"method": "SLSQP", "bounds": box, "constraints": [kept], "options": {"ftol": 1e-12, "maxiter": 300}}
        found = minimize(outside.stiffness_cost, x, jac=True, **asked)
        if np.abs(kept["fun"](found.x)).max() < _KEPT:  # regardless of SLSQP's status
            yield found.fun


def search(priority: str, count: int, starts: int, seed: int = 0) -> Search:
    """Allocate `count` targets, half of them made by random pressures, and start at the missed ones."""
    t = random_targets(ARM, POSTURE, count, seed)
    begin = time.perf_counter()
    a = allocate(t.q, t.K, t.T, joint=ARM, priority=priority, weights=WEIGHTS)
    seconds, rng = time.perf_counter() - begin, np.random.default_rng(seed)
    missed, (lo, hi) = np.flatnonzero(~a.success), a.box
    done = below = above = 0
    for number, i in enumerate(missed.tolist()):
        each = starts // len(missed) + (number < starts % len(missed))
        for cost in ends(t, i, a, priority, rng.uniform(lo[i], hi[i], (each, ARM.m)) / UNIT):
            done += 1
            below += cost < a.lower_bounds[i, -1] - _ROUNDING * (1 + cost)
            above += cost > a.costs[i, -1] + _ALIKE * (1 + cost)
    return Search(priority, a, seconds, done, below, above)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mechanisms.nonaffine", description=__doc__)
    parser.add_argument("--targets", type=int, default=500)
    parser.add_argument("--starts", type=int, default=20_000, help="of local solvers, for each priority")
    arguments = parser.parse_args()
    warm_up(joint=machines.arm26())
    failed = False
    for priority in ("torque", "weighted"):
        found = search(priority, arguments.targets, arguments.starts)
        print(found, flush=True)
        failed |= found.below > 0 or found.allocation.gap.max() > 1e-3
    return int(failed)


if __name__ == "__main__":
    raise SystemExit(main())
