"""Weighted optimum of two curves where no pressures meet both targets: branch and bound along arcs.

At the optimum JᵀW r = 0 with a residual r that is not zero wherever no limit holds and no curve has a kink, so that J
is singular there: both curves have the same slope, m_1 = m_2 with m = dk/dt. Hence the optimum lies on one of these:

    an *edge*    one pressure at an end of the box or at a kink of its muscle, the other varies along a piece
    a *fold*     both pressures vary along pieces of which the slopes stay equal
    the *floor*  both pressures vary, and their sum is the least one allowed

Along an edge and a fold the slope dK/dT = m is monotone, along the floor the derivatives by the pressure are. Between
two points of an arc each curve therefore lies between its chord and its end tangents, and (T, K) in a parallelogram,
whose distance from the target bounds the cost from below.

Plain Python without NumPy, compiled or not, as in `allocator.allocation`. All bounds hold up to rounding.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
# numba compiles the functions for lists and for arrays, so that they have no types
from collections.abc import Callable
from math import inf

from allocator.search.curves import T_K, T_P, at, narrowed, next_guess, pieces
from allocator.search.pairs import chosen, crossings, level
from allocator.search.stretches import sag, slope, within

_STEPS = 100  # of a root finding; about eight are used
_NEAR = 1e-14  # of a piece: a root is not sought closer than this
_CLOSE = 1e-13  # of what a target away from all that can be given costs: arcs are dropped that gain no more
_NARROW = 1e-12  # of the box: an arc this short is not halved
_EDGE, _FOLD, _FLOOR = 0.0, 1.0, 2.0


def weighted(T, K, weights, one, two, box, now1, now2):
    """Return (P1, P2, gap) of the least cost w_T (T - T*)² + w_K (K - K*)².

    `gap` is how much less the search may have missed.

    Of several pairs that meet both targets it takes the one nearest to (now1, now2), or where these are NaN the least.
    """
    arcs1, arcs2 = pieces(one, box[0], box[1], T_K), pieces(two, box[2], box[3], T_K)
    roots, _, _ = level(T, K, one, two, arcs1, arcs2, T_K, crossings(T, one, two, box, T_K), box[4])
    if len(roots) > 0:
        P1, P2 = chosen(roots, now1, now2)
        return P1, P2, 0.0
    found = edges(one, arcs1, arcs2, 1.0, box[4])
    found.extend(edges(two, arcs2, arcs1, 0.0, box[4]))
    for arc1 in arcs1:
        for arc2 in arcs2:
            found.extend(fold(arc1, arc2, one, two))
    if box[4] > -inf:
        found.extend(floor(one, two, pieces(one, box[0], box[1], T_P), pieces(two, box[2], box[3], T_P), box[4]))
    return least((T, K, weights[0], weights[1]), found, one, two, box)


# --- arcs -----------------------------------------------------------------------------------------------------------
# A point of an arc: (P, Q, t_P, k_P, t_Q, k_Q, m): pressure of the curve that is varied and of the other, what they add
# to torque and stiffness, and the slope. An arc: (1.0 where the varied curve is the agonist's, segment of the varied
# curve, of the other, kind, point A …, point B …).


def edges(curve, arcs, others, first, least_sum):
    """Return the edges along the pieces `arcs` of a curve, the other pressure at the ends and kinks of `others`."""
    found = [(0.0,) * 18][:0]
    last = len(others) - 1
    for j in range(last + 1):
        other = others[j]
        if j == 0 or others[j - 1][0] != other[0]:
            for arc in arcs:
                found.extend(edge(first, curve, arc, other[0], other[1], other[3], other[4], least_sum))
        if j == last:
            for arc in arcs:
                found.extend(edge(first, curve, arc, other[0], other[2], other[7], other[8], least_sum))
    return found


def edge(first, curve, arc, other, Q, tQ, kQ, least_sum):
    """Return the edge along a piece with the other pressure at Q, as far as it lies above the floor."""
    found = [(0.0,) * 18][:0]
    if arc[2] + Q < least_sum:
        return found
    A = (arc[1], Q, arc[3], arc[4], tQ, kQ, slope(arc[5], arc[6], arc))
    B = (arc[2], Q, arc[7], arc[8], tQ, kQ, slope(arc[9], arc[10], arc))
    if arc[1] + Q < least_sum:
        P = min(least_sum - Q, arc[2])
        tP, kP, t, k = at(P, curve[int(arc[0])], T_K)
        A = (P, Q, tP, kP, tQ, kQ, slope(t, k, arc))
    found.append((first, arc[0], other, _EDGE, *A, *B))
    return found


def fold(arc1, arc2, one, two):
    """Return the fold of two pieces, or none.

    Of the two the straighter one is varied, on which the slope changes less.
    """
    found = [(0.0,) * 18][:0]
    low1, high1 = slopes(arc1)
    low2, high2 = slopes(arc2)
    low, high = max(low1, low2), min(high1, high2)
    if low > high or low1 == high1 == low2 == high2:  # two straight pieces: what they reach is reached on edges
        return found
    first = high1 - low1 <= high2 - low2
    free, other = (arc1, arc2) if first else (arc2, arc1)
    s1, s2 = one[int(arc1[0])], two[int(arc2[0])]
    P_segment, Q_segment = (s1, s2) if first else (s2, s1)
    P_low, P_high = free[1], free[2]  # all of it where it is straight
    if slopes(free)[0] < slopes(free)[1]:
        P_low = pressure_of_slope(low, P_segment, free[1], free[2])
        P_high = pressure_of_slope(high, P_segment, free[1], free[2])
    Q_low = pressure_of_slope(low, Q_segment, other[1], other[2])
    Q_high = pressure_of_slope(high, Q_segment, other[1], other[2])
    A, B = point(P_low, Q_low, low, P_segment, Q_segment), point(P_high, Q_high, high, P_segment, Q_segment)
    found.append((1.0 if first else 0.0, free[0], other[0], _FOLD, *A, *B))
    return found


def floor(one, two, arcs1, arcs2, least_sum):
    """Return the floor P1 + P2 = least sum, cut where a piece of either curve ends."""
    found = [(0.0,) * 18][:0]
    for arc1 in arcs1:
        for arc2 in arcs2:
            a, b = max(arc1[1], least_sum - arc2[2]), min(arc1[2], least_sum - arc2[1])
            if a <= b:
                s1, s2 = one[int(arc1[0])], two[int(arc2[0])]
                A, B = point(a, least_sum - a, 0.0, s1, s2), point(b, least_sum - b, 0.0, s1, s2)
                found.append((1.0, arc1[0], arc2[0], _FLOOR, *A, *B))
    return found


def slopes(arc):
    """Return the least and the greatest slope of a piece."""
    a, b = slope(arc[5], arc[6], arc), slope(arc[9], arc[10], arc)
    return min(a, b), max(a, b)


def point(P, Q, m, P_segment, Q_segment):
    """Return the point at two pressures."""
    tP, kP, _, _ = at(P, P_segment, T_K)
    tQ, kQ, _, _ = at(Q, Q_segment, T_K)
    return P, Q, tP, kP, tQ, kQ, m


def pressure_of_slope(m, segment, u, v):
    """Return the pressure between u and v, on one piece, at which k' = m t'; the nearer of the two if there is none."""
    fu, fv, near = off_slope(m, segment, u), off_slope(m, segment, v), _NEAR * abs(v - u)
    if fu * fv >= 0:
        return u if abs(fu) < abs(fv) else v
    for i in range(_STEPS):
        P = next_guess(u, fu, v, fv, i)
        if abs(P - v) <= near or P == u:
            break
        u, fu, v, fv = narrowed(u, fu, v, fv, P, off_slope(m, segment, P))
    return v


def off_slope(m, segment, P):
    """Return k' - m t', or t' for an infinite slope."""
    _, _, t, k = at(P, segment, T_K)
    return t if abs(m) == inf else k - m * t


# --- branch and bound -----------------------------------------------------------------------------------------------


def least(goal, arcs, one, two, box):
    """Return (P1, P2, gap) of the least cost on the arcs; of those left that with the least bound is halved first."""
    best, queue = (inf, 0.0, 0.0), [(0.0,) * 19][:0]
    for arc in arcs:
        best = better(goal, best, arc, arc[4:11], box[4])
        best = better(goal, best, arc, arc[11:18], box[4])
        enqueue(goal, queue, arc, arc[4:11], arc[11:18], one, two, box[4])
    bound = inf
    close = _CLOSE * (goal[2] * goal[0] * goal[0] + goal[3] * goal[1] * goal[1] + best[0])
    narrow = _NARROW * (box[1] - box[0] + box[3] - box[2])
    while len(queue) > 0:
        lower, arc = foremost(queue)
        if lower >= best[0] - close:
            bound = lower
            break
        A, B = arc[4:11], arc[11:18]
        if abs(B[0] - A[0]) <= narrow:
            bound = min(bound, lower)
            continue
        segments = both(arc, one, two)
        inside, single = falls_and_rises(goal, A, B, arc, segments), convex(goal, A, B, arc, box[4])
        if single and not inside:
            continue  # the least is at an end
        M = moved((A[0] + B[0]) / 2, A, B, segments, arc[3])
        if inside:
            lowest = descend(goal, A, B, segments, arc)
            best = better(goal, best, arc, lowest, box[4])
            if min(abs(lowest[0] - A[0]), abs(lowest[0] - B[0])) > abs(B[0] - A[0]) / 16:
                M = lowest
        best = better(goal, best, arc, M, box[4])
        if not single:
            enqueue(goal, queue, arc, A, M, one, two, box[4])
            enqueue(goal, queue, arc, M, B, one, two, box[4])
    return best[1], best[2], max(best[0] - bound, 0.0)


def better(goal, best, arc, A, least_sum):
    """Return the better of (cost, P1, P2) and a point of an arc, if that lies above the floor."""
    value = cost(goal, A[2] + A[4], A[3] + A[5])
    if value >= best[0] or A[0] + A[1] < least_sum - 1e-15 * abs(least_sum):
        return best
    return (value, A[0], A[1]) if arc[0] == 1 else (value, A[1], A[0])


def enqueue(goal, queue, arc, A, B, one, two, least_sum):
    """Append the part of an arc from A to B with its bound, unless all of it lies below the floor."""
    if max(A[0], B[0]) + max(A[1], B[1]) >= least_sum - 1e-15 * abs(least_sum):
        lower = floor_bound(goal, A, B, both(arc, one, two)) if arc[3] == _FLOOR else bounded(goal, A, B)
        queue.append((lower, *arc[:4], *A, *B))


def foremost(queue):
    """Take the arc with the least bound from the queue: (bound, arc)."""
    first = 0
    for i in range(len(queue)):
        if queue[i][0] < queue[first][0]:
            first = i
    queue[first], queue[-1] = queue[-1], queue[first]
    found = queue.pop()
    return found[0], found[1:]


def both(arc, one, two):
    """Return the segments of the varied curve and of the other one."""
    if arc[0] == 1:
        return one[int(arc[1])], two[int(arc[2])]
    return two[int(arc[1])], one[int(arc[2])]


def cost(goal, T, K):
    """Return w_T (T - T*)² + w_K (K - K*)²."""
    return goal[2] * (T - goal[0]) * (T - goal[0]) + goal[3] * (K - goal[1]) * (K - goal[1])


def moved(P, A, B, segments, kind):
    """Return the point of the arc between A and B at the pressure P of the varied curve."""
    _, _, t, k = at(P, segments[0], T_K)
    m = k / t if t != 0 else inf
    if kind == _EDGE:
        return point(P, A[1], m, segments[0], segments[1])
    if kind == _FLOOR:
        return point(P, A[0] + A[1] - P, 0.0, segments[0], segments[1])
    return point(P, pressure_of_slope(m, segments[1], A[1], B[1]), m, segments[0], segments[1])


def falls_and_rises(goal, A, B, arc, segments):
    """Return whether the cost falls from A and rises to B."""
    dP, dQ = B[2] - A[2], B[4] - A[4]
    forward = B[0] - A[0] if arc[3] == _FLOOR else dP + dQ
    return gradient(goal, A, arc[3], segments) * forward < 0 < gradient(goal, B, arc[3], segments) * forward


def gradient(goal, A, kind, segments):
    """Return half of d(cost)/dT along an edge or a fold, over 1 + |m| to keep it bounded.

    Along the floor it is half of d(cost)/dP.
    """
    e_T, e_K = goal[2] * (A[2] + A[4] - goal[0]), goal[3] * (A[3] + A[5] - goal[1])
    if kind == _FLOOR:
        _, _, tP, kP = at(A[0], segments[0], T_K)
        _, _, tQ, kQ = at(A[1], segments[1], T_K)
        return e_T * (tP - tQ) + e_K * (kP - kQ)
    if abs(A[6]) == inf:
        return e_K * (1.0 if A[6] > 0 else -1.0)
    return (e_T + e_K * A[6]) / (1 + abs(A[6]))


def descend(goal, A, B, segments, arc):
    """Return the point between A and B at which the cost is stationary."""
    u, v, M, near = A[0], B[0], B, _NEAR * abs(B[0] - A[0])
    fu, fv = gradient(goal, A, arc[3], segments), gradient(goal, B, arc[3], segments)
    for i in range(_STEPS):
        P = next_guess(u, fu, v, fv, i)
        if fu * fv >= 0 or abs(P - v) <= near or P == u:
            break
        M = moved(P, A, B, segments, arc[3])
        u, fu, v, fv = narrowed(u, fu, v, fv, P, gradient(goal, M, arc[3], segments))
    return M


def convex(goal, A, B, arc, least_sum):
    """Return whether the cost is convex in T: on an edge or a fold above the floor that bends away from the target."""
    dP, dQ = B[2] - A[2], B[4] - A[4]
    if arc[3] == _FLOOR or dP * dQ < 0 or min(A[0], B[0]) + min(A[1], B[1]) < least_sum:
        return False
    if (B[6] - A[6]) * (dP + dQ) >= 0:
        return min(A[3], B[3]) + min(A[5], B[5]) >= goal[1]
    return max(A[3], B[3]) + max(A[5], B[5]) <= goal[1]


def bounded(goal, A, B):
    """Return a lower bound on the cost of an edge or a fold from A to B: curves lie between chord and end tangents."""
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
    return distance(goal, T_min, T_max, below, above, m)


def floor_bound(goal, A, B, segments):
    """Return a lower bound on the cost of the floor: t and k of both curves lie between chord and end tangents."""
    t_sag = k_sag = 0.0
    for n in (0, 1):
        _, _, tA, kA = at(A[n], segments[n], T_K)
        _, _, tB, kB = at(B[n], segments[n], T_K)
        dP = B[n] - A[n]
        t_sag += sag(tA, tB, dP, B[2 + 2 * n] - A[2 + 2 * n])
        k_sag += sag(kA, kB, dP, B[3 + 2 * n] - A[3 + 2 * n])
    TA, KA, TB, KB = A[2] + A[4], A[3] + A[5], B[2] + B[4], B[3] + B[5]
    m = (KB - KA) / (TB - TA) if TA != TB else 0.0
    m = m if abs(m) * t_sag <= abs(KB - KA) else 0.0  # all but vertical
    low, high, deviation = min(KA - m * TA, KB - m * TB), max(KA - m * TA, KB - m * TB), k_sag + abs(m) * t_sag
    return distance(goal, min(TA, TB) - t_sag, max(TA, TB) + t_sag, low - deviation, high + deviation, m)


def distance(goal, T_min, T_max, below, above, m):
    """Return the least cost where T_min ≤ T ≤ T_max and below ≤ K - m T ≤ above."""
    T, K, wT, wK = goal
    steep = wT + wK * m * m
    found = inf
    for T_best in (T, (wT * T + wK * m * (K - below)) / steep, (wT * T + wK * m * (K - above)) / steep):
        t = min(max(T_best, T_min), T_max)
        rest = max(0.0, below + m * t - K, K - m * t - above)
        found = min(found, wT * (t - T) * (t - T) + wK * rest * rest)
    return found


FUNCTIONS: tuple[Callable[..., object], ...] = (
    *(weighted, edges, edge, fold, floor, slopes, point, pressure_of_slope, off_slope),
    *(least, better, enqueue, foremost, both, cost, moved, falls_and_rises, gradient, descend, convex),
    *(bounded, floor_bound, distance),
)
