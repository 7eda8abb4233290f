"""Single readings of a log that jump there and back, and pressures that drop out.

A reading is a spike if no more than three rows lie on one side of the rows before and after them, by far more than rows
usually do, and the rows around lie on a parabola in comparison. A commanded pressure may go there and back; it is a
spike only if it leaves the range of the others, or reads zero for less than 60 ms, which is rare.
"""

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array, Mask
from allocator.units import BAR, DEG

_LONGEST = 3  # rows of a spike
_USUAL = 5.0  # times the jump there and back that 97 % of the rows keep to
_NEAR = 5  # rows, in which three have to be without a jump
_AROUND = 3.0  # times the range of the rows around, about their parabola
_LEAST_ANGLE = 2 * DEG
_LEAST_PRESSURE = 1 * BAR
_LEAST_DROP = 0.3 * BAR  # from which a pressure drops out,
_EMPTY = 0.05 * BAR  # and to which
_RARE = 0.05  # share of the rows that drop-outs are less than
_LONGEST_DROP = 1.0  # [s] of a measured pressure, and
_LONGEST_DROP_COMMANDED = 0.06  # [s] of one that is commanded


def angle_spikes(t: Array, theta: Array) -> Mask:
    """Return which rows (n,) of the angle [rad] at times t [s] are spikes."""
    return _spikes(t, theta, _LEAST_ANGLE)


def pressure_spikes(t: Array, P: Array) -> Mask:
    """Return which rows (n,) of a pressure [Pa] at times t [s] are spikes, or have dropped out."""
    if P.size <= _NEAR:
        return np.zeros(P.size, bool)
    commanded = not np.median(np.abs(np.diff(P, 2))) > 0
    spikes = _spikes(t, P, _LEAST_PRESSURE)
    if commanded:
        held = P[~spikes]
        spikes &= (P < held.min()) | (P > held.max())
    return np.asarray(spikes | _dropouts(t, P, _LONGEST_DROP_COMMANDED if commanded else _LONGEST_DROP))


def _spikes(t: Array, a: Array, least: float) -> Mask:
    found = np.zeros(a.size, bool)
    for count in range(1, _LONGEST + 1):
        back = _there_and_back(a, count)
        if back.size <= _NEAR:
            break
        limit = max(least, _USUAL * float(np.quantile(back, 0.97)))
        starts = (np.flatnonzero(back > limit) + 1).tolist()
        far = found.copy()
        for first in starts:
            far[first : first + count] = True
        for first in starts:
            last = first + count
            around = _around(far, first, last)
            if around is not None:
                curve = np.polynomial.Polynomial.fit(t[around], a[around], 2)
                size = np.abs(a[first:last] - curve(t[first:last])).min()
                found[first:last] |= size > max(least, _AROUND * float(np.ptp(a[around] - curve(t[around]))))
    return found


def _there_and_back(a: Array, count: int) -> Array:
    """Return the smaller of the jumps into and out of every `count` rows from the second on, 0 if not on one side."""
    into, out = a[1:-count] - a[: -count - 1], a[count:-1] - a[count + 1 :]
    return np.where(into * out > 0, np.minimum(np.abs(into), np.abs(out)), 0.0)


def _dropouts(t: Array, P: Array, longest: float) -> Mask:
    """Return the rows of pressures that fall to zero within a row, and within a row are back.

    They are no drop-outs if the pressure is at zero often; those above 60 ms have to come back to the level before, and
    are none if the pressure is at zero at other times.
    """
    found = np.zeros(P.size, bool)
    empty = np.asarray(np.abs(P) <= _EMPTY)
    runs = _runs(empty)
    inner = [(first, last) for first, last in runs if 0 < first and last < P.size]
    sudden = [(first, last) for first, last in inner if min(P[first - 1], P[last]) > _LEAST_DROP]
    brief = [run for run in sudden if t[run[1]] - t[run[0]] < _LONGEST_DROP_COMMANDED]
    back = [
        (first, last)
        for first, last in sudden
        if t[last] - t[first] < longest and _AROUND * abs(P[last] - P[first - 1]) < P[first - 1]
    ]
    for first, last in {*brief, *back} if {*brief, *back} == {*runs} else brief:
        found[first:last] = True
    return found if found.mean() < _RARE else np.zeros(P.size, bool)


def _runs(mask: Mask) -> list[tuple[int, int]]:
    """Return first row, and row after the last, of every run of marked rows."""
    edges = np.diff(np.concatenate([[0], mask.astype(int), [0]]))
    return list(zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True))


def _around(mask: Mask, first: int, last: int) -> NDArray[np.intp] | None:
    """Return the three rows before and after a run that are not marked themselves; None if they are not near it."""
    before = [i for i in range(max(first - _NEAR, 0), first) if not mask[i]][-3:]
    after = [i for i in range(last, min(last + _NEAR, mask.size)) if not mask[i]][:3]
    return np.array(before + after) if len(before) == len(after) == 3 else None
