"""The weighted optimum of two curves where no pressures meet both targets: branch and bound along arcs.

At the optimum JᵀW r = 0 with a residual r that is not zero wherever no limit holds and no curve has a kink, so that J
is singular there: both curves have the same slope, m_1 = m_2 with m = dk/dt. Hence the optimum lies on one of these:

    an *edge*    one pressure at an end of the box or at a kink of its muscle, the other varies along a piece
    a *fold*     both pressures vary along pieces of which the slopes stay equal

Along each of these arcs the slope dK/dT = m is monotone. Between two of its points each curve therefore lies between
its chord and its end tangents, and (T, K) in a parallelogram, whose distance from the target bounds the cost from below.

Plain Python without NumPy, compiled or not, as `allocator.allocation.kernels`. All bounds hold up to rounding.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
# numba compiles the functions for lists and arrays; types would say Any
from collections.abc import Callable
from math import inf
from typing import Any

from allocator.allocation.curves import at, narrowed, next_guess, pieces
from allocator.allocation.search import chosen, level, sag, slope, within

_STEPS = 100  # of a root finding; about eight are used
_NEAR = 1e-14  # of a piece: a root is not sought closer than this
_CLOSE = 1e-13  # of what a target away from all that can be given costs: arcs are dropped that gain no more
_NARROW = 1e-11  # of a piece: an arc this short is not halved


def weighted(T, K, weights, one, two, box, now1, now2):
    """(P1, P2, gap) of the least cost w_T (T - T*)² + w_K (K - K*)²; `gap`: how much less the search may have missed.

    Of several pairs that meet both targets it takes the one nearest to (now1, now2), or where these are NaN the least.
    """
    arcs1, arcs2 = pieces(one, box[0], box[1], False), pieces(two, box[2], box[3], False)
    roots, _, _ = level(T, K, one, two, arcs1, arcs2, False)
    if len(roots) > 0:
        P1, P2 = chosen(roots, box[4], now1, now2)
        return P1, P2, 0.0
    goal = T, K, weights[0], weights[1]
    stack = [arc for arc in edges(one, arcs1, arcs2, 1.0)]
    stack.extend(edges(two, arcs2, arcs1, 0.0))
    for i in range(len(arcs1)):
        for j in range(len(arcs2)):
            stack.extend(fold(i, j, one, two, arcs1[i], arcs2[j]))
    return least(goal, stack, one, two, arcs1, arcs2)


# --- arcs -----------------------------------------------------------------------------------------------------------
# A point of an arc: (P, Q, t_P, k_P, t_Q, k_Q, m): pressure of the curve that is varied and of the other, what they add
# to torque and stiffness, and the slope. An arc: (first, i, j, whether Q follows, point A …, point B …) with `first` 1.0
# where the varied curve is the agonist's, i and j its piece and that of the other.


def edges(curve, arcs, others, first):
    """The edges along the pieces `arcs` of a curve, the other pressure at the ends and kinks of `others`."""
    found = [(0.0,) * 18][:0]
    last = len(others) - 1
    for j in range(last + 1):
        other = others[j]
        if j == 0 or others[j - 1][0] != other[0]:
            for i in range(len(arcs)):
                found.append(edge(first, i, j, arcs[i], other[1], other[3], other[4]))
        if j == last:
            for i in range(len(arcs)):
                found.append(edge(first, i, j, arcs[i], other[2], other[7], other[8]))
    return found


def edge(first, i, j, arc, Q, tQ, kQ):
    """The edge along a piece with the other pressure at Q."""
    A = (arc[1], Q, arc[3], arc[4], tQ, kQ, slope(arc[5], arc[6], arc))
    B = (arc[2], Q, arc[7], arc[8], tQ, kQ, slope(arc[9], arc[10], arc))
    return (first, float(i), float(j), 0.0, *A, *B)


def fold(i, j, one, two, arc1, arc2):
    """The fold of two pieces, or none; of the two the straighter one is varied, on which the slope is less."""
    found = [(0.0,) * 18][:0]
    low1, high1 = slopes(arc1)
    low2, high2 = slopes(arc2)
    low, high = max(low1, low2), min(high1, high2)
    if low > high or low1 == high1 == low2 == high2:  # two straight pieces: what they reach is reached on edges
        return found
    if high1 - low1 <= high2 - low2:
        ends = fold_ends(low, high, one[int(arc1[0])], two[int(arc2[0])], arc1, arc2)
        found.append((1.0, float(i), float(j), 1.0, *ends[0], *ends[1]))
    else:
        ends = fold_ends(low, high, two[int(arc2[0])], one[int(arc1[0])], arc2, arc1)
        found.append((0.0, float(j), float(i), 1.0, *ends[0], *ends[1]))
    return found


def slopes(arc):
    """The least and the greatest slope of a piece."""
    a, b = slope(arc[5], arc[6], arc), slope(arc[9], arc[10], arc)
    return min(a, b), max(a, b)


def fold_ends(low, high, P_segment, Q_segment, free, other):
    """The points of a fold at which the slope is `low` and `high`; where one piece is straight its two ends."""
    P_low, P_high = pressure_of_slope(low, P_segment, free), pressure_of_slope(high, P_segment, free)
    if slopes(free)[0] == slopes(free)[1]:
        P_low, P_high = free[1], free[2]
    Q_low, Q_high = pressure_of_slope(low, Q_segment, other), pressure_of_slope(high, Q_segment, other)
    return point(P_low, Q_low, low, P_segment, Q_segment), point(P_high, Q_high, high, P_segment, Q_segment)


def point(P, Q, m, P_segment, Q_segment):
    """The point at two pressures."""
    tP, kP, _, _ = at(P, P_segment, False)
    tQ, kQ, _, _ = at(Q, Q_segment, False)
    return P, Q, tP, kP, tQ, kQ, m


def pressure_of_slope(m, segment, arc):
    """The pressure of a piece at which k' = m t'; the end that is nearer to it beyond them."""
    u, v = arc[1], arc[2]
    mu, mv = slope(arc[5], arc[6], arc), slope(arc[9], arc[10], arc)
    if (m <= mu) == (mu <= mv) or m == mu:
        return u
    if (m >= mv) == (mu <= mv) or m == mv:
        return v
    fu, fv, near = arc[6] - m * arc[5], arc[10] - m * arc[9], _NEAR * (v - u)
    for i in range(_STEPS):
        P = next_guess(u, fu, v, fv, i)
        if fu * fv >= 0 or abs(P - v) <= near or P == u:
            break
        _, _, t, k = at(P, segment, False)
        u, fu, v, fv = narrowed(u, fu, v, fv, P, k - m * t)
    return v


# --- branch and bound -----------------------------------------------------------------------------------------------


def least(goal, arcs, one, two, arcs1, arcs2):
    """(P1, P2, gap) of the least cost on the arcs; of those left that with the least bound is halved first."""
    T, K, wT, wK = goal
    best, P1, P2 = inf, 0.0, 0.0
    queue = []
    for arc in arcs:
        queue.append((bounded(goal, arc[4:11], arc[11:18]), *arc))
        for n in (4, 11):
            value = cost(goal, arc[n + 2] + arc[n + 4], arc[n + 3] + arc[n + 5])
            if value < best:
                best = value
                P1, P2 = (arc[n], arc[n + 1]) if arc[0] == 1 else (arc[n + 1], arc[n])
    bound, close = inf, _CLOSE * (wT * T * T + wK * K * K + best)
    while len(queue) > 0:
        arc = foremost(queue)
        if arc[0] >= best - close:
            bound = min(bound, arc[0])
            break
        A, B, follows = arc[5:12], arc[12:19], arc[4]
        free, other = (arcs1, arcs2) if arc[1] == 1 else (arcs2, arcs1)
        P_piece, Q_piece = free[int(arc[2])], other[int(arc[3])]
        segments = (one if arc[1] == 1 else two)[int(P_piece[0])], (two if arc[1] == 1 else one)[int(Q_piece[0])]
        if abs(B[0] - A[0]) <= _NARROW * (P_piece[2] - P_piece[1]):
            bound = min(bound, arc[0])
            continue
        inside, single = stationary_between(goal, A, B), convex(goal, A, B)
        if single and not inside:
            continue  # the least is at an end
        M = moved((A[0] + B[0]) / 2, A, segments, Q_piece, follows)
        if inside:
            lowest = descend(goal, A, B, segments, Q_piece, follows)
            if single or min(abs(lowest[0] - A[0]), abs(lowest[0] - B[0])) > abs(B[0] - A[0]) / 16:
                M = lowest
            value = cost(goal, lowest[2] + lowest[4], lowest[3] + lowest[5])
            if value < best:
                best = value
                P1, P2 = (lowest[0], lowest[1]) if arc[1] == 1 else (lowest[1], lowest[0])
        value = cost(goal, M[2] + M[4], M[3] + M[5])
        if value < best:
            best = value
            P1, P2 = (M[0], M[1]) if arc[1] == 1 else (M[1], M[0])
        if not single:
            queue.append((bounded(goal, A, M), *arc[1:5], *A, *M))
            queue.append((bounded(goal, M, B), *arc[1:5], *M, *B))
    return P1, P2, max(best - bound, 0.0)


def foremost(queue):
    """Take the arc with the least bound from the queue."""
    first = 0
    for i in range(len(queue)):
        if queue[i][0] < queue[first][0]:
            first = i
    queue[first], queue[-1] = queue[-1], queue[first]
    return queue.pop()


def cost(goal, T, K):
    """w_T (T - T*)² + w_K (K - K*)²"""
    return goal[2] * (T - goal[0]) * (T - goal[0]) + goal[3] * (K - goal[1]) * (K - goal[1])


def moved(P, A, segments, other, follows):
    """The point of the arc through A at the pressure P of the varied curve."""
    tP, kP, t, k = at(P, segments[0], False)
    m = k / t if t != 0 else inf
    if follows == 0:
        return P, A[1], tP, kP, A[4], A[5], m
    return point(P, pressure_of_slope(m, segments[1], other), m, segments[0], segments[1])


def stationary_between(goal, A, B):
    """Whether the cost falls from A and rises to B, along an arc on which T is monotone."""
    dP, dQ = B[2] - A[2], B[4] - A[4]
    if dP * dQ < 0 or dP + dQ == 0:
        return False
    return gradient(goal, A) * (dP + dQ) < 0 < gradient(goal, B) * (dP + dQ)


def gradient(goal, A):
    """Half of d(cost)/dT along an arc; that by K where the arc is vertical."""
    if abs(A[6]) == inf:
        return goal[3] * (A[3] + A[5] - goal[1]) * (1.0 if A[6] > 0 else -1.0)
    return goal[2] * (A[2] + A[4] - goal[0]) + goal[3] * (A[3] + A[5] - goal[1]) * A[6]


def descend(goal, A, B, segments, other, follows):
    """The point between A and B at which the cost is stationary."""
    u, fu, v, fv, M, near = A[0], gradient(goal, A), B[0], gradient(goal, B), B, _NEAR * abs(B[0] - A[0])
    for i in range(_STEPS):
        P = next_guess(u, fu, v, fv, i)
        if fu * fv >= 0 or abs(P - v) <= near or P == u:
            break
        M = moved(P, A, segments, other, follows)
        u, fu, v, fv = narrowed(u, fu, v, fv, P, gradient(goal, M))
    return M


def convex(goal, A, B):
    """Whether the cost is convex in T on the arc: T is monotone, and it bends away from the target's stiffness."""
    dP, dQ = B[2] - A[2], B[4] - A[4]
    if dP * dQ < 0:
        return False
    bends = (B[6] - A[6]) * (dP + dQ)
    if bends >= 0:
        return min(A[3], B[3]) + min(A[5], B[5]) >= goal[1]
    return max(A[3], B[3]) + max(A[5], B[5]) <= goal[1]


def bounded(goal, A, B):
    """A lower bound on the cost from A to B: that of the parallelogram between chords and end tangents."""
    dT, dK = B[2] + B[4] - A[2] - A[4], B[3] + B[5] - A[3] - A[5]
    m = within(dK / dT if dT != 0 else 0.0, A[6], B[6])
    m = m if abs(m) < inf else 0.0
    below = above = T_min = T_max = 0.0
    for n in (2, 4):
        tA, kA, tB, kB = A[n], A[n + 1], B[n], B[n + 1]
        deviation = sag(A[6], B[6], tB - tA, kB - kA)
        below_chord = (B[6] - A[6]) * (tB - tA) > 0
        below += min(kA - m * tA, kB - m * tB) - (deviation if below_chord else 0.0)
        above += max(kA - m * tA, kB - m * tB) + (0.0 if below_chord else deviation)
        T_min, T_max = T_min + min(tA, tB), T_max + max(tA, tB)
    T, K, wT, wK = goal
    found = inf
    for T_best in (
        T,
        (wT * T + wK * m * (K - below)) / (wT + wK * m * m),
        (wT * T + wK * m * (K - above)) / (wT + wK * m * m),
    ):
        t = min(max(T_best, T_min), T_max)
        rest = max(0.0, below + m * t - K, K - m * t - above)
        found = min(found, wT * (t - T) * (t - T) + wK * rest * rest)
    return found


FUNCTIONS: tuple[Callable[..., Any], ...] = (
    *(weighted, edges, edge, fold, slopes, fold_ends, point, pressure_of_slope),
    *(least, foremost, cost, moved, stationary_between, gradient, descend, convex, bounded),
)

__all__ = ["FUNCTIONS", "weighted"]
