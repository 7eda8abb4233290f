"""Exact solution, for affine muscles, of the allocation problem [A] for the stiffness felt by a push.

With the secant of the hysteresis (`allocator.joint.felt`) and S = P1 + P2

    T = T_0 + t1 P1 + t2 P2,     K_felt = K(P) (1 + α + β S) + g(P)

where K is the isobaric stiffness, g the contribution of gas, Dahl's friction and separate springs, all affine in P, and
α, β are constant in each region of S between the kinks. In a region K_felt is quadratic, hence quadratic in s along
every straight line P = p + s d. All candidates for the optimum lie on straight lines:

* an interior optimum without residual is on the torque level T = T*;
* one with a residual r has JᵀW r = 0, hence det ∂(T, K_felt)/∂(P1, P2) = 0, which is affine in P: a *fold*. The same
  holds for the extremes of the torque along a stiffness level, and for those of the stiffness;
* every other optimum lies on the border of a region: an edge of the box, or P1 + P2 = a kink (or co-contraction floor).

On each line the candidates are the ends, T = T* (linear), K = K* (quadratic), K' = 0, and for the weighted cost its
stationary points (cubic). The best of all of them is the global optimum, up to rounding.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice, pairwise
from typing import NamedTuple, Self

import numpy as np

from allocator.allocation.two_muscles.problem import Problem
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.joint.torque_levels import Pair

_SLACK = 1e-12  # of the supply range: a line within this of the border lies on it
_HALVINGS = 60  # of an interval on which a cubic is monotone
_TIE = 1e-13  # of a scale: rounding
_PARALLEL = 1e-12  # of a unit vector


class Quadratic(NamedTuple):
    """c_0 + c_1 s + c_2 s² along a line, each (n,)."""

    c0: Array
    c1: Array
    c2: Array

    def at(self, s: Array) -> Array:
        """Return the values at s (n,)."""
        return self.c0 + s * (self.c1 + s * self.c2)


class Line(NamedTuple):
    """Straight lines p + s d of unit directions d, between s = low and s = high; low > high for none."""

    p: Pair  # [span]
    d: Pair  # [-]
    low: Array
    high: Array

    def at(self, s: Array) -> Pair:
        """Return the pressures [span] at s (n,), clipped to the line; NaN without one."""
        s = np.where(self.low <= self.high, np.clip(s, self.low, self.high), np.nan)
        return self.p[0] + s * self.d[0], self.p[1] + s * self.d[1]


@dataclass(frozen=True)
class Affine:
    """Affine functions f + f1 P1 + f2 P2 of pressures in `span`, each coefficient (n,)."""

    f: Array
    f1: Array
    f2: Array

    def along(self, line: Line) -> Pair:
        """Return the value at s = 0 and the slope along a line."""
        return self.f + self.f1 * line.p[0] + self.f2 * line.p[1], self.f1 * line.d[0] + self.f2 * line.d[1]

    def __add__(self, other: Self) -> "Affine":
        return Affine(self.f + other.f, self.f1 + other.f1, self.f2 + other.f2)


class Pieces(NamedTuple):
    """Functions of torque and felt stiffness in one region, pressures in `span`."""

    T: Affine
    K: Affine  # isobaric
    share: Affine  # 1 + α + β S
    added: Affine  # g
    low: Array  # least P1 + P2 (n,)
    high: Array  # greatest

    def stiffness(self, line: Line) -> Quadratic:
        """Return K_felt along a line."""
        (k0, k1), (m0, m1), (g0, g1) = (f.along(line) for f in (self.K, self.share, self.added))
        return Quadratic(k0 * m0 + g0, k0 * m1 + k1 * m0 + g1, k1 * m1)

    @property
    def fold(self) -> Affine:
        """det ∂(T, K_felt)/∂(P1, P2), affine as K_felt is quadratic with β (1, 1) for the gradient of its share."""
        T, K, m, g = self.T, self.K, self.share, self.added
        c = T.f1 * K.f2 - T.f2 * K.f1  # of the share
        b = (T.f1 - T.f2) * m.f1  # of K
        rest = T.f1 * g.f2 - T.f2 * g.f1
        return Affine(c * m.f + b * K.f + rest, c * m.f1 + b * K.f1, c * m.f2 + b * K.f2)


def solve(problem: Problem) -> Pair:
    """Return the optimal pressures (P1, P2) [Pa], (n,). Raises `InvalidInput` for muscles that are not affine."""
    check(problem)
    if not problem.theta.size:
        return problem.theta, problem.theta
    span = problem.joint.pressure_span
    found = [point for piece in pieces(problem) for point in _candidates(problem, piece)]
    P1, P2 = (np.stack([point[i] for point in found]) * span for i in (0, 1))  # (m, n)
    P1, P2 = (np.clip(P, side.lo, side.hi) for P, side in zip((P1, P2), problem.box, strict=True))
    return _best(problem, P1, P2)


def check(problem: Problem) -> None:
    """Raise `InvalidInput` for problems without a closed form."""
    if not problem.joint.affine:
        raise InvalidInput(
            "the felt stiffness of muscles that are not affine in the pressure has no exact allocation where widths of "
            "loops depend on the pressures (base below 1); fit an affine law (Sarosi2012, Hildebrandt2005, …), or "
            "allocate an isobaric stiffness and read Allocation.felt_stiffness"
        )
    if problem.pull:
        raise InvalidInput("a pull has no exact answer for a felt stiffness; leave out pull or amplitude")


def pieces(problem: Problem) -> Iterator[Pieces]:
    """Yield the functions of each region of P1 + P2, over all targets."""
    assert problem.felt is not None
    span, (one, two), zero = problem.joint.pressure_span, problem.sides, np.zeros(problem.theta.shape)
    a, b = one.isobaric, two.isobaric
    T = _affine(span, a.torque(zero) + b.torque(zero), a.torque_gain(zero), b.torque_gain(zero))
    K = _affine(span, a.stiffness(zero) + b.stiffness(zero), a.stiffness_gain(zero), b.stiffness_gain(zero))
    drag = problem.felt.drag
    pull = _affine(span, drag * (a.torque(zero) - b.torque(zero)), drag * T.f1 / span, -drag * T.f2 / span)
    gas = [
        (s.stiffness(zero) - i.stiffness(zero), s.stiffness_gain(zero) - i.stiffness_gain(zero))
        for s, i in ((one, a), (two, b))
    ]
    added = pull + _affine(span, gas[0][0] + gas[1][0], gas[0][1], gas[1][1])
    floor = np.broadcast_to(problem.box.least_sum, zero.shape)
    for r in problem.felt.regions:
        share = _affine(span, zero + 1 + r.share, zero + r.share_slope, zero + r.share_slope)
        own = _affine(span, zero + r.own, zero + r.own_slope, zero + r.own_slope)
        yield Pieces(T, K, share, added + own, np.maximum(floor, r.low) / span, zero + r.high / span)


def _affine(span: float, f: Array, f1: Array, f2: Array) -> Affine:
    return Affine(f, f1 * span, f2 * span)


# --- lines ------------------------------------------------------------------------------------------------------------


def _lines(problem: Problem, piece: Pieces) -> Iterator[Line]:
    """Yield every line that may hold the optimum within a region: level and fold, edges and borders."""
    T, n = problem.T_aim, np.ones(problem.theta.shape)
    (lo1, hi1), (lo2, hi2) = ((side.lo / problem.joint.pressure_span, side.hi / problem.joint.pressure_span)
                              for side in problem.box)  # fmt: skip
    yield _clipped(problem, piece, piece.T.f - T, piece.T.f1, piece.T.f2)
    fold = piece.fold
    yield _clipped(problem, piece, fold.f, fold.f1, fold.f2)
    for end in (lo1, hi1):
        yield _clipped(problem, piece, -end, n, 0 * n)
    for end in (lo2, hi2):
        yield _clipped(problem, piece, -end, 0 * n, n)
    for end in (piece.low, piece.high):
        yield _clipped(problem, piece, -np.where(np.isfinite(end), end, np.nan), n, n)


def _clipped(problem: Problem, piece: Pieces, f: Array, f1: Array, f2: Array) -> Line:
    """Return the part of the lines f + f1 P1 + f2 P2 = 0 within box and region."""
    with np.errstate(divide="ignore", invalid="ignore"):
        length = np.hypot(f1, f2)
        n1, n2 = f1 / length, f2 / length
        p = -f / length * n1, -f / length * n2
        d = -n2, n1
        span = problem.joint.pressure_span
        bounds = [(i, side.lo / span, side.hi / span) for i, side in enumerate(problem.box)]
        low, high = np.full(f.shape, -np.inf), np.full(f.shape, np.inf)
        for at, along, lo, hi in (
            *((p[i], d[i], lo, hi) for i, lo, hi in bounds),
            (p[0] + p[1], d[0] + d[1], piece.low, piece.high),
        ):
            parallel = np.abs(along) <= _PARALLEL
            slope = np.where(parallel, 1.0, along)
            a, b = (lo - at) / slope, (hi - at) / slope
            outside = (at < lo - _SLACK) | (at > hi + _SLACK)
            low = np.maximum(low, np.where(parallel, np.where(outside, np.inf, -np.inf), np.minimum(a, b)))
            high = np.minimum(high, np.where(parallel, np.where(outside, -np.inf, np.inf), np.maximum(a, b)))
        touching = (low > high) & (low <= high + _SLACK)
        middle = np.where(touching, (low + high) / 2, 0.0)
        known = np.isfinite(p[0]) & np.isfinite(p[1])
        low, high = np.where(touching, middle, low), np.where(touching, middle, high)
    return Line(p, d, np.where(known, low, 1.0), np.where(known, high, -1.0))


# --- candidates -------------------------------------------------------------------------------------------------------


def _candidates(problem: Problem, piece: Pieces) -> Iterator[Pair]:
    """Yield candidate pressures [span] for the optimum within a region, NaN for none."""
    for line in _lines(problem, piece):
        if not (line.low <= line.high).any():
            continue
        T0, T1 = piece.T.along(line)
        K = piece.stiffness(line)
        for s in (line.low, line.high, *_met(problem, T0, T1, K), *_stationary(problem, line, T0, T1, K)):
            yield line.at(np.where(np.isfinite(s), s, line.low))


def _met(problem: Problem, T0: Array, T1: Array, K: Quadratic) -> tuple[Array, ...]:
    """Return s where the torque is met, where the stiffness is met, and where the stiffness turns."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return (problem.T_aim - T0) / T1, *roots(K, problem.K_aim), -K.c1 / (2 * K.c2)


def roots(K: Quadratic, value: Array) -> Pair:
    """Return both s (n,) with K(s) = value, NaN for none, without cancellation."""
    with np.errstate(divide="ignore", invalid="ignore"):
        c = K.c0 - value
        square = K.c1**2 - 4 * K.c2 * c
        square = np.where((square < 0) & (square > -1e-14 * (K.c1**2 + np.abs(4 * K.c2 * c))), 0.0, square)
        q = -(K.c1 + np.copysign(np.sqrt(square), K.c1)) / 2
        return q / K.c2, c / q


def _stationary(problem: Problem, line: Line, T0: Array, T1: Array, K: Quadratic) -> list[Array]:
    """Return the stationary points of the weighted cost along a line: up to three roots of a cubic, bracketed."""
    if problem.priority != "weighted":
        return []
    w_T, w_K = problem.weights
    e, c1, c2, t = K.c0 - problem.K_aim, K.c1, K.c2, T0 - problem.T_aim
    a0, a1 = w_K * c1 * e + w_T * T1 * t, w_K * (c1**2 + 2 * c2 * e) + w_T * T1**2
    a2, a3 = w_K * 3 * c1 * c2, w_K * 2 * c2**2

    def slope(s: Array) -> Array:
        return np.asarray(a0 + s * (a1 + s * (a2 + s * a3)))

    turns = [np.where(np.isfinite(s), np.clip(s, line.low, line.high), line.low)
             for s in roots(Quadratic(a1, 2 * a2, 3 * a3), np.zeros(e.shape))]  # fmt: skip
    ends = [line.low, np.minimum(*turns), np.maximum(*turns), line.high]
    return [_bisected(slope, left, right) for left, right in pairwise(ends)]


def _bisected(f, left: Array, right: Array) -> Array:  # type: ignore[no-untyped-def]
    """Return the root of a function that is monotone between left and right; an end if there is none."""
    sign = np.sign(f(left))
    for _ in range(_HALVINGS):
        middle = (left + right) / 2
        before = np.sign(f(middle)) == sign
        left, right = np.where(before, middle, left), np.where(before, right, middle)
    return (left + right) / 2


# --- the best ---------------------------------------------------------------------------------------------------------


def _best(problem: Problem, P1: Array, P2: Array) -> Pair:
    """Return the best of candidates (m, n); among equals the nearest to `previous`, or the least pressures."""
    (e_T, e_K), (w_T, w_K) = problem.errors(P1, P2), problem.weights
    T_tie, K_tie = (_TIE * scale for scale in problem.scales)
    weighted = w_T * e_T**2 + w_K * e_K**2
    tie = np.asarray(w_T * T_tie**2 + w_K * K_tie**2)
    goals = {
        "torque": ((np.abs(e_T), T_tie), (np.abs(e_K), K_tie)),
        "stiffness": ((np.abs(e_K), K_tie), (np.abs(e_T), T_tie)),
    }.get(problem.priority, ((weighted, tie),))
    missing = np.isnan(P1) | ~problem.box.contains(P1, P2, _TIE * problem.joint.pressure_span)
    left = ~missing
    for cost, near in goals:
        cost = np.where(left, cost, np.inf)
        left = left & (cost <= cost.min(axis=0) + 4 * near)
    now = problem.limits.previous
    far = P1 + P2 if now is None else (P1 - now[0]) ** 2 + (P2 - now[1]) ** 2
    return _picked(np.where(left, far, np.inf), P1, P2)


def _picked(cost: Array, P1: Array, P2: Array) -> Pair:
    winner = np.argmin(cost, axis=0)[None]
    one, two = (np.take_along_axis(P, winner, 0)[0] for P in (P1, P2))
    return one, two


# --- existence --------------------------------------------------------------------------------------------------------


def levels(problem: Problem, T: Array, K: Array) -> Array:
    """Return the pairs (m, n, 2) [Pa] with these torques and stiffnesses (n,), NaN where a target has fewer."""
    aimed = replace(problem, T=T, K=K, stiffness_tolerance=0.0)
    span, (T_scale, K_scale) = problem.joint.pressure_span, aimed.scales
    found = []
    for piece in pieces(aimed):
        line = next(_lines(aimed, piece))
        for s in roots(piece.stiffness(line), K):
            inside = (s >= line.low - _SLACK) & (s <= line.high + _SLACK)
            P1, P2 = (np.where(inside, P * span, np.nan) for P in line.at(s))
            found.append(np.stack([P1, P2], axis=-1))
    pairs = np.stack(found)
    e_T, e_K = (np.abs(e) for e in _errors(aimed, pairs, T, K))
    wrong = ~((e_T <= 1e-9 * T_scale) & (e_K <= 1e-9 * K_scale))
    return np.where(wrong[..., None], np.nan, pairs)


def _errors(problem: Problem, pairs: Array, T: Array, K: Array) -> Pair:
    given = problem.given(pairs[..., 0], pairs[..., 1])
    return given[0] - T, given[1] - K


def turning_torques(problem: Problem, K: Array) -> Array:
    """Return the torques (m, n) [N·m] at which the number of pairs with the stiffnesses K (n,) may change."""
    aimed, found = replace(problem, K=K, stiffness_tolerance=0.0), []
    for piece in pieces(aimed):
        for line in islice(_lines(aimed, piece), 1, None):  # without the torque level
            T0, T1 = piece.T.along(line)
            for s in roots(piece.stiffness(line), K):
                inside = (s >= line.low - _SLACK) & (s <= line.high + _SLACK)
                found.append(np.where(inside, T0 + s * T1, np.nan))
    return np.sort(np.stack(found), axis=0)  # NaN last
