"""The global optimum for two curves, by search in one variable that cannot skip a solution.

Torque and stiffness are sums of one function for each pressure, T = t_1 + t_2 and K = k_1 + k_2. Along a level of one of
them, x_1 + x_2 = X, the other is y = y_1(x_1) + y_2(X - x_1), and for two pieces of the curves (`curves`) both slopes
dy_i/dx_i are monotone. So on any stretch of a level the values at its two ends alone say:

1. where the slope of y does not vanish y is monotone: a root is bracketed, or there is none;
2. where both summands bend the same way, so does y: its one stationary point is found, and two monotone stretches remain;
3. else each summand lies between its chord and its end tangents. If the sum of these bands leaves out what is sought the
   stretch is dropped; if not it is halved.

Thus all roots and the nearest point are found, and what was dropped gives a bound (priorities "torque", "stiffness").

A weighted optimum that is not a root lies on the image's border or where the Jacobian is singular, m_1 = m_2 for the
slopes m = dk/dt: on an edge of the box, on a kink of one of the muscles, or on a *fold*, where both pressures move so
that both curves keep the same slope. Along each of these arcs m is monotone, so that it too lies between chords and end
tangents: branch and bound, and again a bound on what was dropped.

Plain Python without NumPy, compiled or not, as `allocator.allocation.kernels`. All bounds hold up to rounding.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
# numba compiles the functions for lists and arrays; types would say Any
from collections.abc import Callable
from math import inf, isnan
from typing import Any

from allocator.allocation.curves import at, narrowed, next_guess, pieces, pressure_at

_STEPS = 100  # of a root finding; about six are used
_NEAR = 1e-14  # of a piece: a root is not sought closer than this
_TINY = 1e-13  # of the scale of what is compared: rounding
_NARROW = 1e-12  # of a piece: a stretch this short is not halved
_FAR = 1e3  # times all there is: nearest to that is the extreme
_MEET = 1e-7  # of the values: intervals no farther apart than that are one
_SAME = 1e-9  # of the box: pairs this near to each other are one


# --- lexicographic --------------------------------------------------------------------------------------------------


def nearest(X, Y, one, two, box, swap, now1, now2):
    """(P1, P2, gap): first x nearest to X, then y nearest to Y; x is T, or with `swap` K.

    Of several pairs that give both it takes the one nearest to (now1, now2), or where these are NaN the least. `gap`:
    how much nearer to Y a point might be that the search has dropped.
    """
    arcs1, arcs2 = pieces(one, box[0], box[1], swap), pieces(two, box[2], box[3], swap)
    low, high = corner(arcs1, arcs2, 1.0), corner(arcs1, arcs2, -1.0)
    if X <= low[0]:
        return low[1], low[2], 0.0
    if X >= high[0]:
        return high[1], high[2], 0.0
    roots, found, bound = level(X, Y, one, two, arcs1, arcs2, swap)
    if len(roots) > 0:
        P1, P2 = chosen(roots, box[4], now1, now2)
        return P1, P2, 0.0
    return found[1], found[2], max(found[0] - bound, 0.0)


def all_pairs(T, K, one, two, box):
    """All pairs of pressures (P1, P2) in the box that give both targets."""
    arcs1, arcs2 = pieces(one, box[0], box[1], False), pieces(two, box[2], box[3], False)
    return level(T, K, one, two, arcs1, arcs2, False)[0]


def determinant_sign(one, two, box):
    """The sign of det ∂(T, K)/∂(P1, P2) all over the box, 0 where it is not proved to have one.

    Not zero it proves that no two pairs give the same: the columns of the Jacobian depend on one pressure each.
    """
    sign = 0.0
    for arc1 in pieces(one, box[0], box[1], False):
        for arc2 in pieces(two, box[2], box[3], False):
            a1, b1 = slope(arc1[5], arc1[6], arc1), slope(arc1[9], arc1[10], arc1)
            a2, b2 = slope(arc2[5], arc2[6], arc2), slope(arc2[9], arc2[10], arc2)
            least, most = min(a1, b1) - max(a2, b2), max(a1, b1) - min(a2, b2)
            here = 1.0 if least > 0 else (-1.0 if most < 0 else 0.0)
            here = here if (arc1[7] > arc1[3]) != (arc2[7] > arc2[3]) else -here  # det = t1't2'(m2 - m1)
            if here == 0 or here * sign < 0:
                return 0.0
            sign = here
    return sign


def spans(X, one, two, box, swap):
    """The intervals (least y, greatest y) of all that can be had at x = X, rising and apart; x is T, or with `swap` K."""
    arcs1, arcs2 = pieces(one, box[0], box[1], swap), pieces(two, box[2], box[3], swap)
    X = min(max(X, corner(arcs1, arcs2, 1.0)[0]), corner(arcs1, arcs2, -1.0)[0])
    found = [(0.0, 0.0)][:0]
    for arc1 in arcs1:
        for arc2 in arcs2:
            segments = one[int(arc1[0])], two[int(arc2[0])]
            first = abs(arc1[7] - arc1[3]) <= abs(arc2[7] - arc2[3])
            free, other = (arc1, arc2) if first else (arc2, arc1)
            segments = (segments[0], segments[1]) if first else (segments[1], segments[0])
            met, A, B = stretch(X, free, other, segments, swap)
            if met:
                far = _FAR * (abs(A[3]) + abs(A[4]) + abs(B[3]) + abs(B[4]))
                ends = [value_at(along(X, Y, A, B, free, other, segments, swap, inf)[1], segments, swap) for Y in (-far, far)]
                found.append((ends[0], ends[1]))
    found.sort()
    return merged(found)


def value_at(nearer, segments, swap):
    """y of the pair that was nearest."""
    return at(nearer[1], segments[0], swap)[1] + at(nearer[2], segments[1], swap)[1]


def merged(found):
    """The union of intervals that are in order; those that meet at a turning point do so up to rounding's square root."""
    apart = found[:0]
    for low, high in found:
        if len(apart) > 0 and low <= apart[-1][1] + _MEET * (abs(low) + abs(apart[-1][1])):
            apart[-1] = (apart[-1][0], max(high, apart[-1][1]))
        else:
            apart.append((low, high))
    return apart


def corner(arcs1, arcs2, sign):
    """(x, P1, P2) where x is least (`sign` 1) or greatest (-1)."""
    one, two = extreme(arcs1, sign), extreme(arcs2, sign)
    return one[0] + two[0], one[1], two[1]


def extreme(arcs, sign):
    """(x, P) of the end of a piece at which x is least (`sign` 1) or greatest (-1)."""
    x, P = sign * inf, 0.0
    for arc in arcs:
        if sign * arc[3] < sign * x:
            x, P = arc[3], arc[1]
        if sign * arc[7] < sign * x:
            x, P = arc[7], arc[2]
    return x, P


def chosen(roots, least_sum, now1, now2):
    """The pair nearest to the pressures now, or without them the one with the least sum, of those that keep a floor."""
    best, least = roots[0], inf
    for root in roots:
        far = root[0] + root[1] if isnan(now1) else max(abs(root[0] - now1), abs(root[1] - now2))
        if far < least and root[0] + root[1] >= least_sum:
            best, least = root, far
    return best


# --- levels ---------------------------------------------------------------------------------------------------------
# A state is a point of a level: (P, Q, x, y_P, y_Q, m_P, m_Q, det): pressures of the piece that is varied and of the
# one that follows, x of the first, y and slope dy/dx of both, and a multiple of m_P - m_Q that is finite.


def level(X, Y, one, two, arcs1, arcs2, swap):
    """(all pairs that give X and Y, the nearest (|y - Y|, P1, P2), a bound on |y - Y| of what was dropped)."""
    roots, best, bound = [(0.0, 0.0)][:0], (inf, 0.0, 0.0), inf
    for arc1 in arcs1:
        for arc2 in arcs2:
            first = abs(arc1[7] - arc1[3]) <= abs(arc2[7] - arc2[3])  # the one on which x varies less is varied
            free, other = (arc1, arc2) if first else (arc2, arc1)
            P_curve, Q_curve = (one, two) if first else (two, one)
            segments = P_curve[int(free[0])], Q_curve[int(other[0])]
            met, A, B = stretch(X, free, other, segments, swap)
            if met:
                found, nearer, dropped = along(X, Y, A, B, free, other, segments, swap, best[0])
                bound = min(bound, dropped)
                for P, Q in found:
                    add(roots, P if first else Q, Q if first else P, _SAME * (abs(P) + abs(Q)))
                if nearer[0] < best[0]:
                    best = (nearer[0], nearer[1] if first else nearer[2], nearer[2] if first else nearer[1])
    return roots, best, bound


def add(roots, P1, P2, near):
    """Append a pair that is not there yet."""
    for root in roots:
        if abs(root[0] - P1) <= near and abs(root[1] - P2) <= near:
            return
    roots.append((P1, P2))


def stretch(X, free, other, segments, swap):
    """(whether the level X passes these two pieces, the states at both ends)."""
    Pl, pl, Ph, ph = ordered(free)
    Ql, ql, Qh, qh = ordered(other)
    met = max(pl, X - qh) <= min(ph, X - ql)
    if not met:
        A = state(Pl, Ql, free, other, segments, swap)
        return False, A, A
    if pl >= X - qh:
        A = state(Pl, pressure_at(X - pl, other, segments[1], swap, Qh), free, other, segments, swap)
    else:
        A = state(pressure_at(X - qh, free, segments[0], swap, Pl), Qh, free, other, segments, swap)
    if ph <= X - ql:
        B = state(Ph, pressure_at(X - ph, other, segments[1], swap, Ql), free, other, segments, swap)
    else:
        B = state(pressure_at(X - ql, free, segments[0], swap, Ph), Ql, free, other, segments, swap)
    return True, A, B


def ordered(arc):
    """(pressure and x of the end with the lesser x, the same of the other end)."""
    return (arc[1], arc[3], arc[2], arc[7]) if arc[3] <= arc[7] else (arc[2], arc[7], arc[1], arc[3])


def state(P, Q, free, other, segments, swap):
    """The state at two pressures that belong together."""
    x, yP, dx, dyP = at(P, segments[0], swap)
    _, yQ, dxQ, dyQ = at(Q, segments[1], swap)
    sign = (1.0 if free[7] >= free[3] else -1.0) * (1.0 if other[7] >= other[3] else -1.0)
    return P, Q, x, yP, yQ, slope(dx, dyP, free), slope(dxQ, dyQ, other), sign * (dyP * dxQ - dyQ * dx)


def follow(P, Q, X, free, other, segments, swap):
    """The state at P on the level X; Q is a guess."""
    x, _, _, _ = at(P, segments[0], swap)
    return state(P, pressure_at(X - x, other, segments[1], swap, Q), free, other, segments, swap)


def slope(dx, dy, arc):
    """dy/dx with the sign of dx that the piece has, infinite where x turns."""
    rises = arc[7] >= arc[3]
    if dx != 0 and (dx > 0) == rises:
        return dy / dx
    return inf if (dy >= 0) == rises else -inf


def along(X, Y, A, B, free, other, segments, swap, best):
    """(pairs (P, Q) with y = Y, the nearest (|y - Y|, P, Q), a bound on what was dropped) between two states.

    Only points nearer than `best` are of interest where there is no root.
    """
    roots, nearer, bound = [(0.0, 0.0)][:0], (inf, A[0], A[1]), inf
    scale = abs(A[3]) + abs(A[4]) + abs(B[3]) + abs(B[4]) + abs(Y)
    width = _NARROW * (free[2] - free[1])
    for end in (A, B):
        if abs(end[3] + end[4] - Y) < nearer[0]:
            nearer = (abs(end[3] + end[4] - Y), end[0], end[1])
    stack = [(A, B)]
    while len(stack) > 0:
        A, B = stack.pop()
        yA, yB = A[3] + A[4] - Y, B[3] + B[4] - Y
        shape = bend(A, B)
        if shape == 0:  # monotone
            if yA * yB <= 0:
                roots.append(root(X, Y, A, yA, B, yB, free, other, segments, swap))
            continue
        if abs(shape) == 1:  # convex or concave
            if yA * yB <= 0:
                roots.append(root(X, Y, A, yA, B, yB, free, other, segments, swap))
            elif shape * yA > 0:  # its inside may come nearer than its ends
                M = stationary(X, A, B, free, other, segments, swap)
                y = M[3] + M[4] - Y
                if y * yA <= 0:
                    roots.append(root(X, Y, A, yA, M, y, free, other, segments, swap))
                    roots.append(root(X, Y, M, y, B, yB, free, other, segments, swap))
                elif abs(y) < nearer[0]:
                    nearer = (abs(y), M[0], M[1])
            continue
        below, above = band(A, B)
        least = max(below - Y, Y - above, 0.0)
        goal = 0.0 if len(roots) > 0 else min(best, nearer[0]) - _TINY * scale
        if least > goal or least == goal > 0 or abs(B[0] - A[0]) <= width:
            bound = min(bound, least)
            continue
        M = follow((A[0] + B[0]) / 2, (A[1] + B[1]) / 2, X, free, other, segments, swap)
        y = M[3] + M[4] - Y
        if abs(y) < nearer[0]:
            nearer = (abs(y), M[0], M[1])
        stack.append((A, M))
        stack.append((M, B))
    return roots, nearer, bound


def bend(A, B):
    """0: y is monotone from A to B; 1: convex in x; -1: concave; 2: it may be anything."""
    if A[2] == B[2]:
        return 0  # x of the varied piece stands still: y is that piece's
    least = min(A[5], B[5]) - max(A[6], B[6])
    most = max(A[5], B[5]) - min(A[6], B[6])
    if least >= 0 or most <= 0:
        return 0
    P_bend, Q_bend = B[5] - A[5], A[6] - B[6]  # of the slopes of y_P(x) and y_Q(X - x)
    if P_bend >= 0 and Q_bend >= 0:
        return 1
    if P_bend <= 0 and Q_bend <= 0:
        return -1
    return 2


def band(A, B):
    """Between what values y stays from A to B: both summands between their chords and end tangents."""
    dx = B[2] - A[2]
    P_sag, Q_sag = sag(A[5], B[5], dx, B[3] - A[3]), sag(A[6], B[6], -dx, B[4] - A[4])
    P_convex, Q_convex = B[5] > A[5], A[6] > B[6]
    yA, yB = A[3] + A[4], B[3] + B[4]
    below = min(yA, yB) - (P_sag if P_convex else 0.0) - (Q_sag if Q_convex else 0.0)
    above = max(yA, yB) + (0.0 if P_convex else P_sag) + (0.0 if Q_convex else Q_sag)
    floor, ceiling = min(A[3], B[3]) + min(A[4], B[4]), max(A[3], B[3]) + max(A[4], B[4])
    return max(below, floor), min(above, ceiling)


def sag(mA, mB, dx, dy):
    """How far an arc with these end slopes may be from its chord; both y and the slope are monotone along it."""
    if dx == 0 or mA == mB:
        return 0.0
    chord = within(dy / dx, mA, mB)
    if abs(mA) == inf and abs(mB) == inf:
        return abs(dy)
    if abs(mA) == inf:
        return abs((mB - chord) * dx)
    if abs(mB) == inf:
        return abs((mA - chord) * dx)
    return abs((chord - mA) * (mB - chord) / (mB - mA) * dx)


def within(m, mA, mB):
    """A chord's slope between those at the ends, whatever rounding has made of it."""
    return min(max(m, min(mA, mB)), max(mA, mB))


def root(X, Y, A, yA, B, yB, free, other, segments, swap):
    """(P, Q) of the level at which y = Y, between two states with y - Y of different sign."""
    if yA == 0:
        return A[0], A[1]
    u, fu, v, fv, Q, near = A[0], yA, B[0], yB, B[1], _NEAR * (free[2] - free[1])
    for i in range(_STEPS):
        P = next_guess(u, fu, v, fv, i)
        if fv == 0 or abs(P - v) <= near or P == u:
            break
        S = follow(P, Q, X, free, other, segments, swap)
        u, fu, v, fv = narrowed(u, fu, v, fv, P, S[3] + S[4] - Y)
        Q = S[1]
    return v, Q


def stationary(X, A, B, free, other, segments, swap):
    """The state between two at which m_P = m_Q."""
    u, fu, v, fv, S, near = A[0], A[7], B[0], B[7], B, _NEAR * (free[2] - free[1])
    for i in range(_STEPS):
        P = next_guess(u, fu, v, fv, i)
        if fu * fv >= 0 or abs(P - v) <= near or P == u:
            break
        S = follow(P, S[1], X, free, other, segments, swap)
        u, fu, v, fv = narrowed(u, fu, v, fv, P, S[7])
    return S


FUNCTIONS: tuple[Callable[..., Any], ...] = (
    *(nearest, all_pairs, determinant_sign, spans, value_at, merged, corner, extreme, chosen, level, add, stretch, ordered, state, follow, slope, along),
    *(bend, band, sag, within, root, stationary),
)

__all__ = ["FUNCTIONS", "all_pairs", "determinant_sign", "nearest", "spans"]
