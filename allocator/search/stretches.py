"""Roots and nearest point of one stretch of a level, from the values at its two ends.

Along the level x_1 + x_2 = X of two pieces the other quantity is y = y_1(x_1) + y_2(X - x_1), and both slopes dy_i/dx_i
are monotone. So on any stretch the values at its ends alone say:

1. where the slope of y does not vanish y is monotone: a root is bracketed, or there is none;
2. where both summands bend the same way, so does y: it has one stationary point and falls into two monotone stretches;
3. else each summand lies between its chord and its end tangents. If the sum of these bands leaves out what is sought
   the stretch is dropped; if not it is halved.

A state is a point of a level: (P, Q, x, y_P, y_Q, m_P, m_Q, det): pressures of the piece that is varied and of the
one that follows, x of the first, y and slope dy/dx of both, and a multiple of m_P - m_Q that is finite.

Plain Python without NumPy, compiled or not, as in `allocator.allocation`. All bounds hold up to rounding.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
# numba compiles the functions for lists and for arrays, so that they have no types
from collections.abc import Callable
from math import inf

from allocator.search.curves import at, narrowed, next_guess, pressure_at

_STEPS = 100  # of a root finding; about six are used
_NEAR = 1e-14  # of a piece: a root is not sought closer than this
_TINY = 1e-13  # of the scale of what is compared: rounding
_NARROW = 1e-12  # of a piece: a stretch this short is not halved


def state(P, Q, free, other, segments, view):
    """Return the state at two pressures that belong together."""
    x, yP, dx, dyP = at(P, segments[0], view)
    _, yQ, dxQ, dyQ = at(Q, segments[1], view)
    sign = (1.0 if free[7] >= free[3] else -1.0) * (1.0 if other[7] >= other[3] else -1.0)
    return P, Q, x, yP, yQ, slope(dx, dyP, free), slope(dxQ, dyQ, other), sign * (dyP * dxQ - dyQ * dx)


def follow(P, Q, X, free, other, segments, view):
    """Return the state at P on the level X; Q is a guess."""
    x, _, _, _ = at(P, segments[0], view)
    return state(P, pressure_at(X - x, other, segments[1], view, Q), free, other, segments, view)


def slope(dx, dy, arc):
    """Return dy/dx with the sign of dx that the piece has, infinite where x turns."""
    rises = arc[7] >= arc[3]
    if dx != 0 and (dx > 0) == rises:
        return dy / dx
    return inf if (dy >= 0) == rises else -inf


def along(X, Y, A, B, free, other, segments, view, best):
    """Return (pairs (P, Q) with y = Y, the nearest (|y - Y|, P, Q), a bound on what was dropped) between two states.

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
        if shape != 2:
            if yA * yB <= 0:
                roots.append(root(X, Y, A, yA, B, yB, free, other, segments, view))
            elif shape * yA > 0:  # convex or concave, its inside may come nearer than its ends
                M = stationary(X, A, B, free, other, segments, view)
                y = M[3] + M[4] - Y
                if y * yA <= 0:
                    roots.append(root(X, Y, A, yA, M, y, free, other, segments, view))
                    roots.append(root(X, Y, M, y, B, yB, free, other, segments, view))
                elif abs(y) < nearer[0]:
                    nearer = (abs(y), M[0], M[1])
            continue
        below, above = band(A, B)
        least = max(below - Y, Y - above, 0.0)
        goal = 0.0 if len(roots) > 0 else min(best, nearer[0]) - _TINY * scale
        if least > goal or abs(B[0] - A[0]) <= width:
            bound = min(bound, least)
            continue
        M = halfway(X, A, B, free, other, segments, view)
        y = M[3] + M[4] - Y
        if abs(y) < nearer[0]:
            nearer = (abs(y), M[0], M[1])
        stack.append((A, M))
        stack.append((M, B))
    return roots, nearer, bound


def halfway(X, A, B, free, other, segments, view):
    """Return where to halve a stretch: at a stationary point that is well inside, else in the middle."""
    if A[7] * B[7] < 0:
        M = stationary(X, A, B, free, other, segments, view)
        if min(abs(M[0] - A[0]), abs(M[0] - B[0])) > abs(B[0] - A[0]) / 16:
            return M
    return follow((A[0] + B[0]) / 2, (A[1] + B[1]) / 2, X, free, other, segments, view)


def bend(A, B):
    """Return 0 where y is monotone from A to B, 1 where it is convex in x, -1 concave, 2 where it may be anything."""
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
    """Return between what values y stays from A to B: both summands between their chords and end tangents."""
    dx = B[2] - A[2]
    P_sag, Q_sag = sag(A[5], B[5], dx, B[3] - A[3]), sag(A[6], B[6], -dx, B[4] - A[4])
    P_convex, Q_convex = B[5] > A[5], A[6] > B[6]
    yA, yB = A[3] + A[4], B[3] + B[4]
    below = min(yA, yB) - (P_sag if P_convex else 0.0) - (Q_sag if Q_convex else 0.0)
    above = max(yA, yB) + (0.0 if P_convex else P_sag) + (0.0 if Q_convex else Q_sag)
    floor, ceiling = min(A[3], B[3]) + min(A[4], B[4]), max(A[3], B[3]) + max(A[4], B[4])
    return max(below, floor), min(above, ceiling)


def sag(mA, mB, dx, dy):
    """Return how far an arc with these end slopes may be from its chord; both y and the slope are monotone along it."""
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
    """Return a chord's slope between those at the ends, whatever rounding has made of it."""
    return min(max(m, min(mA, mB)), max(mA, mB))


def root(X, Y, A, yA, B, yB, free, other, segments, view):
    """Return (P, Q) of the level at which y = Y, between two states with y - Y of different sign."""
    if yA == 0:
        return A[0], A[1]
    u, fu, v, fv, Q, near = A[0], yA, B[0], yB, B[1], _NEAR * (free[2] - free[1])
    for i in range(_STEPS):
        P, before = next_guess(u, fu, v, fv, i), v
        if fv == 0 or P == u:
            break
        S = follow(P, Q, X, free, other, segments, view)
        u, fu, v, fv = narrowed(u, fu, v, fv, P, S[3] + S[4] - Y)
        Q = S[1]
        if abs(v - before) <= near:
            break
    return v, Q


def stationary(X, A, B, free, other, segments, view):
    """Return the state between two at which m_P = m_Q."""
    u, fu, v, fv, S, near = A[0], A[7], B[0], B[7], B, _NEAR * (free[2] - free[1])
    for i in range(_STEPS):
        P = next_guess(u, fu, v, fv, i)
        if fu * fv >= 0 or abs(P - v) <= near or P == u:
            break
        S = follow(P, S[1], X, free, other, segments, view)
        u, fu, v, fv = narrowed(u, fu, v, fv, P, S[7])
    return S


FUNCTIONS: tuple[Callable[..., object], ...] = (
    *(state, follow, slope, along, halfway, bend, band, sag, within, root, stationary),
)
