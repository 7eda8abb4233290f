"""Loops of `pairs` and `arcs` over many targets: compiled, or as plain Python without NumPy.

`one` and `two` are rows of segments (n, segments, numbers), `box` (lo1, hi1, lo2, hi2, least sum) a target, `now` the
pressures from which the nearest of several pairs is chosen, NaN for the least; `out` is filled, a row a target.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
# numba compiles the functions for lists and for arrays, so that they have no types
from collections.abc import Callable

from allocator.search.arcs import weighted
from allocator.search.curves import K_T, T_K
from allocator.search.pairs import all_pairs, determinant_sign, nearest, spans

MOST = 9  # pairs, and intervals, that are kept of a target


def optima(T, K, priority, weights, one, two, box, now, out):
    """Return (P1, P2, gap) of the optimum; `priority` 0: torque, 1: stiffness, 2: weighted."""
    for i in range(len(T)):
        if priority == 2:
            found = weighted(T[i], K[i], weights, one[i], two[i], box[i], now[i][0], now[i][1])
        elif priority == 1:
            found = nearest(K[i], T[i], one[i], two[i], box[i], K_T, now[i][0], now[i][1])
        else:
            found = nearest(T[i], K[i], one[i], two[i], box[i], T_K, now[i][0], now[i][1])
        out[i][0] = snapped(found[0], box[i][0], box[i][1])
        out[i][1] = snapped(found[1], box[i][2], box[i][3])
        out[i][2] = found[2]


def snapped(P, lo, hi):
    """Return P within its bounds, and on one where only rounding keeps it off."""
    near = 1e-14 * (abs(lo) + abs(hi))
    return lo if lo + near >= P else (hi if hi - near <= P else P)


def pairs(T, K, one, two, box, out):
    """Return the number of pairs that give both targets, then P1, P2 of all of them."""
    for i in range(len(T)):
        found = all_pairs(T[i], K[i], one[i], two[i], box[i])
        out[i][0] = min(len(found), MOST)
        for j in range(min(len(found), MOST)):
            out[i][2 * j + 1], out[i][2 * j + 2] = found[j]


def intervals(X, view, one, two, box, out):
    """Return the number of intervals within reach at a torque (`view` T_K) or a stiffness (K_T), then their ends."""
    for i in range(len(X)):
        found = spans(X[i], one[i], two[i], box[i], view)
        out[i][0] = min(len(found), MOST)
        for j in range(min(len(found), MOST)):
            out[i][2 * j + 1], out[i][2 * j + 2] = found[j]


def signs(one, two, box, out):
    """Return the proved sign of the determinant."""
    for i in range(len(box)):
        out[i][0] = determinant_sign(one[i], two[i], box[i])


LOOPS: dict[str, Callable[..., object]] = {"optima": optima, "pairs": pairs, "intervals": intervals, "signs": signs}
FUNCTIONS = (snapped,)
