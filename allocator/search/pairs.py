"""All pairs of pressures that give a torque and a stiffness, and the nearest where there are none.

Torque and stiffness are sums of one function for each pressure, T = t_1 + t_2 and K = k_1 + k_2. On a level of one of
them, x_1 + x_2 = X, the other is searched, stretch by stretch (`stretches`), one for each pair of pieces of the curves
(`curves`). Thus all roots and the nearest point are found, and what was dropped gives a bound. A co-contraction floor
P1 + P2 ≥ least sum cuts the stretches where the level crosses it: that is the same search with y = P.

Plain Python without NumPy, compiled or not, as `allocator.allocation.two_muscles.kernels.source`.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
# numba compiles the functions for lists and for arrays, so that they have no types
from collections.abc import Callable
from math import inf, isnan

from allocator.search.curves import K_P, P_K, P_T, T_K, T_P, at, pieces, pressure_at, put_in_order
from allocator.search.stretches import along, follow, slope, state

_ROUNDING = 1e-15  # of what is added
_FLAT = 1e-12  # of the values: a piece along which they change less is flat
_FAR = 1e3  # times all there is: nearest to that is the extreme
_MEET = 1e-7  # of the values: intervals no farther apart than that are one
_SAME = 1e-9  # of the pressures: pairs this near to each other are one


# --- lexicographic --------------------------------------------------------------------------------------------------


def nearest(X, Y, one, two, box, view, now1, now2):
    """Return (P1, P2, gap): first x nearest to X, then y nearest to Y, in the view T_K or K_T.

    Of several pairs that give both it takes the one nearest to (now1, now2), or where these are NaN the least. `gap`:
    how much nearer to Y a point might be that the search has dropped.
    """
    arcs1, arcs2 = pieces(one, box[0], box[1], view), pieces(two, box[2], box[3], view)
    low, high = corner(arcs1, arcs2, 1.0), corner(arcs1, arcs2, -1.0)
    if not low[0] < X < high[0]:
        X, P1, P2 = low if X <= low[0] else high
        if box[4] == -inf and not (flat(arcs1) or flat(arcs2)):
            return P1, P2, 0.0  # the one pair that gives it
    roots, found, bound = level(X, Y, one, two, arcs1, arcs2, view, crossings(X, one, two, box, view), box[4])
    if len(roots) > 0:
        P1, P2 = chosen(roots, now1, now2)
        return P1, P2, 0.0
    if found[0] == inf:  # the floor keeps all of the level off
        found, bound = nearest_on_floor(X, one, two, arcs1, arcs2, box, view)
    return found[1], found[2], max(found[0] - bound, 0.0)


def flat(arcs):
    """Return whether x stands still along a piece."""
    least = inf
    for arc in arcs:
        least = min(least, abs(arc[7] - arc[3]) - _FLAT * (abs(arc[3]) + abs(arc[7])))
    return least <= 0


def crossings(X, one, two, box, view):
    """Return the pairs at which the level x = X crosses the floor P1 + P2 = least sum."""
    if box[4] == -inf:
        return [(0.0, 0.0)][:0]
    sums = T_P if view == T_K else K_P
    arcs1, arcs2 = pieces(one, box[0], box[1], sums), pieces(two, box[2], box[3], sums)
    return level(X, box[4], one, two, arcs1, arcs2, sums, [(0.0, 0.0)][:0], -inf)[0]


def nearest_on_floor(X, one, two, arcs1, arcs2, box, view):
    """Return ((|x - X|, P1, P2), bound) of the x nearest to X on the floor and at the corners of the cells above it."""
    values = P_T if view == T_K else P_K
    floor1, floor2 = pieces(one, box[0], box[1], values), pieces(two, box[2], box[3], values)
    roots, found, _ = level(box[4], X, one, two, floor1, floor2, values, [(0.0, 0.0)][:0], -inf)
    if len(roots) > 0:
        found = (0.0, roots[0][0], roots[0][1])
    for arc1 in arcs1:
        for arc2 in arcs2:
            for P1, x1 in ((arc1[1], arc1[3]), (arc1[2], arc1[7])):
                for P2, x2 in ((arc2[1], arc2[3]), (arc2[2], arc2[7])):
                    if P1 + P2 >= box[4] and abs(x1 + x2 - X) < found[0]:
                        found = (abs(x1 + x2 - X), P1, P2)
    return found, found[0]


def all_pairs(T, K, one, two, box):
    """Return all pairs of pressures (P1, P2) in the box that give both targets."""
    arcs1, arcs2 = pieces(one, box[0], box[1], T_K), pieces(two, box[2], box[3], T_K)
    return level(T, K, one, two, arcs1, arcs2, T_K, crossings(T, one, two, box, T_K), box[4])[0]


def determinant_sign(one, two, box):
    """Return the sign of det ∂(T, K)/∂(P1, P2) all over the box, 0 where it is not proved to have one.

    Not zero it proves that no two pairs give the same: the columns of the Jacobian depend on one pressure each.
    """
    sign = 0.0
    for arc1 in pieces(one, box[0], box[1], T_K):
        for arc2 in pieces(two, box[2], box[3], T_K):
            a1, b1 = slope(arc1[5], arc1[6], arc1), slope(arc1[9], arc1[10], arc1)
            a2, b2 = slope(arc2[5], arc2[6], arc2), slope(arc2[9], arc2[10], arc2)
            least, most = min(a1, b1) - max(a2, b2), max(a1, b1) - min(a2, b2)
            here = 1.0 if least > 0 else (-1.0 if most < 0 else 0.0)
            here = here if (arc1[7] > arc1[3]) != (arc2[7] > arc2[3]) else -here  # det = t1't2'(m2 - m1)
            if here == 0 or here * sign < 0:
                return 0.0
            sign = here
    return sign


def spans(X, one, two, box, view):
    """Return the intervals (least y, greatest y) within reach at x = X in the view T_K or K_T, rising and apart."""
    arcs1, arcs2 = pieces(one, box[0], box[1], view), pieces(two, box[2], box[3], view)
    X = min(max(X, corner(arcs1, arcs2, 1.0)[0]), corner(arcs1, arcs2, -1.0)[0])
    cuts = crossings(X, one, two, box, view)
    found = [(0.0, 0.0)][:0]
    for arc1 in arcs1:
        for arc2 in arcs2:
            first, free, other, segments = paired(arc1, arc2, one, two)
            met, A, B = stretch(X, free, other, segments, view)
            for C, D in parts(X, met, A, B, free, other, segments, view, first, cuts, box[4]):
                far = _FAR * (abs(C[3]) + abs(C[4]) + abs(D[3]) + abs(D[4]))
                low = along(X, -far, C, D, free, other, segments, view, inf)[1]
                high = along(X, far, C, D, free, other, segments, view, inf)[1]
                found.append((value_at(low, segments, view), value_at(high, segments, view)))
    put_in_order(found)
    return merged(found)


def paired(arc1, arc2, one, two):
    """Return (whether the agonist's piece is varied: that on which x varies less; the varied piece; the other;
    segments).
    """
    first = abs(arc1[7] - arc1[3]) <= abs(arc2[7] - arc2[3])
    s1, s2 = one[int(arc1[0])], two[int(arc2[0])]
    return first, arc1 if first else arc2, arc2 if first else arc1, (s1, s2) if first else (s2, s1)


def value_at(nearer, segments, view):
    """Return y of the pair that was nearest."""
    return at(nearer[1], segments[0], view)[1] + at(nearer[2], segments[1], view)[1]


def merged(found):
    """Return the union of intervals in order.

    Those that meet at a turning point do so up to the square root of rounding.
    """
    apart = found[:0]
    for low, high in found:
        if len(apart) > 0 and low <= apart[-1][1] + _MEET * (abs(low) + abs(apart[-1][1])):
            apart[-1] = (apart[-1][0], max(high, apart[-1][1]))
        else:
            apart.append((low, high))
    return apart


def corner(arcs1, arcs2, sign):
    """Return (x, P1, P2) where x is least (`sign` 1) or greatest (-1)."""
    one, two = extreme(arcs1, sign), extreme(arcs2, sign)
    return one[0] + two[0], one[1], two[1]


def extreme(arcs, sign):
    """Return (x, P) of the end of a piece at which x is least (`sign` 1) or greatest (-1)."""
    x, P = sign * inf, 0.0
    for arc in arcs:
        if sign * arc[3] < sign * x:
            x, P = arc[3], arc[1]
        if sign * arc[7] < sign * x:
            x, P = arc[7], arc[2]
    return x, P


def chosen(roots, now1, now2):
    """Return the pair nearest to the pressures now, or without them the one with the least sum."""
    best, least = roots[0], inf
    for root in roots:
        far = root[0] + root[1] if isnan(now1) else max(abs(root[0] - now1), abs(root[1] - now2))
        if far < least:
            best, least = root, far
    return best


# --- levels ---------------------------------------------------------------------------------------------------------


def level(X, Y, one, two, arcs1, arcs2, view, cuts, least_sum):
    """Return (all pairs that give X and Y, the nearest (|y - Y|, P1, P2), a bound on |y - Y| of what was dropped).

    Only pairs above the floor P1 + P2 = `least_sum`, which the level crosses at `cuts`.
    """
    roots, best, bound = [(0.0, 0.0)][:0], (inf, 0.0, 0.0), inf
    for arc1 in arcs1:
        for arc2 in arcs2:
            first, free, other, segments = paired(arc1, arc2, one, two)
            met, A, B = stretch(X, free, other, segments, view)
            for C, D in parts(X, met, A, B, free, other, segments, view, first, cuts, least_sum):
                found, nearer, dropped = along(X, Y, C, D, free, other, segments, view, best[0])
                bound = min(bound, dropped)
                for P, Q in found:
                    add(roots, P if first else Q, Q if first else P, _SAME * (abs(P) + abs(Q)))
                if nearer[0] < best[0]:
                    best = (nearer[0], nearer[1] if first else nearer[2], nearer[2] if first else nearer[1])
    return roots, best, bound


def parts(X, met, A, B, free, other, segments, view, first, cuts, least_sum):
    """Return the parts (state, state) of a stretch that lie above the floor; none where there is no stretch."""
    if not met:
        return [(A, B)][:0]
    if least_sum == -inf:
        return [(A, B)]
    found, ends = [(A, B)][:0], [A]
    inside = [cut[0] if first else cut[1] for cut in cuts]
    put_in_order(inside)
    rising = A[0] <= B[0]
    for i in range(len(inside)):
        P = inside[i] if rising else inside[-1 - i]
        if min(A[0], B[0]) < P < max(A[0], B[0]):
            ends.append(follow(P, ends[-1][1], X, free, other, segments, view))
    ends.append(B)
    near = _SAME * abs(least_sum)
    for i in range(len(ends) - 1):
        C, D = ends[i], ends[i + 1]
        M = follow((C[0] + D[0]) / 2, C[1], X, free, other, segments, view)
        if M[0] + M[1] >= least_sum - (near if len(ends) == 2 else 0.0):
            found.append((C, D))
    return found


def add(roots, P1, P2, near):
    """Append a pair that is not there yet."""
    for root in roots:
        if abs(root[0] - P1) <= near and abs(root[1] - P2) <= near:
            return
    roots.append((P1, P2))


def stretch(X, free, other, segments, view):
    """Return (whether the level X passes these two pieces, the states at both ends)."""
    Pl, pl, Ph, ph = ordered(free)
    Ql, ql, Qh, qh = ordered(other)
    met = max(pl, X - qh) <= min(ph, X - ql) + _ROUNDING * (abs(X) + abs(pl) + abs(ph) + abs(ql) + abs(qh))
    if not met:
        A = state(Pl, Ql, free, other, segments, view)
        return False, A, A
    if pl >= X - qh:
        A = state(Pl, pressure_at(X - pl, other, segments[1], view, Qh), free, other, segments, view)
    else:
        A = state(pressure_at(X - qh, free, segments[0], view, Pl), Qh, free, other, segments, view)
    if ph <= X - ql:
        B = state(Ph, pressure_at(X - ph, other, segments[1], view, Ql), free, other, segments, view)
    else:
        B = state(pressure_at(X - ql, free, segments[0], view, Ph), Ql, free, other, segments, view)
    return True, A, B


def ordered(arc):
    """Return (pressure and x of the end with the lesser x, the same of the other end)."""
    return (arc[1], arc[3], arc[2], arc[7]) if arc[3] <= arc[7] else (arc[2], arc[7], arc[1], arc[3])


FUNCTIONS: tuple[Callable[..., object], ...] = (
    *(nearest, flat, crossings, nearest_on_floor, corner, extreme, chosen, all_pairs, determinant_sign),
    *(spans, value_at, merged, level, paired, parts, add, stretch, ordered),
)
