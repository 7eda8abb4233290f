"""Best feasible answers of a joint, by a dense search independent of the library's allocation.

Lexicographic priorities: every level of the first quantity through the box is sampled twice, over the samples of P1 and
over those of P2, so that its ends are samples of one or the other. Between samples with opposite signs of the second
error the target is feasible; around every sample that is nearer to it than its neighbours the error is minimised by
golden section, on the level by a bracketed Newton's method. Weighted priority: `weighted_search`.

The results are pressures in the box and the joint's values there, so every result is attained.
"""

from typing import NamedTuple

import numpy as np

from .curves import image, runs
from .line_search import change, golden_section, pick
from .weighted_search import on_paths

_STILL = 4e-15  # of a pressure: a smaller step is rounding
_NEWTON = 60  # bound
_HALVINGS = 50
_KEPT = 4e-15  # of the scale: tolerance of a level


class Targets(NamedTuple):
    """m targets at angles of an `Image`; all (m,)."""

    row: np.ndarray  # index of the angle
    T: np.ndarray  # [N·m]
    K: np.ndarray  # [N·m/rad]

    def take(self, where):
        return Targets(*(array[where] for array in self))


class Found(NamedTuple):
    """Best pressures, and their errors; all (m,)."""

    P1: np.ndarray  # [Pa]
    P2: np.ndarray
    T_error: np.ndarray  # |T - T*| [N·m]
    K_error: np.ndarray


class Brackets(NamedTuple):
    """Stretches of levels, each with one minimum of the second error; all (c,)."""

    target: np.ndarray
    side: np.ndarray  # muscle with the pressure x; the other has y
    x_lo: np.ndarray
    x_hi: np.ndarray
    y_lo: np.ndarray  # a monotone run of the other muscle's curve, the first quantity rises from y_lo to y_hi
    y_hi: np.ndarray

    def take(self, where):
        return Brackets(*(array[where] for array in self))


def best(joint, theta, T, K, priority, weights=(1.0, 1.0)):
    """Return the best answers to targets (m,); NaN at angles where no pressures keep both cables taut."""
    angles, row = np.unique(np.asarray(theta, float), return_inverse=True)
    reach = image(joint, angles)
    there = np.isin(angles[row], reach.theta)
    targets = Targets(np.searchsorted(reach.theta, angles[row][there]), np.asarray(T)[there], np.asarray(K)[there])
    found = Found(*(np.full(len(row), np.nan) for _ in Found._fields))
    for whole, part in zip(found, search(joint, reach, targets, priority, weights), strict=True):
        whole[there] = part
    return found


def search(joint, reach, targets, priority, weights=(1.0, 1.0)):
    """Return the same for a given image."""
    if priority != "weighted":
        return lexicographic(joint, reach, targets, priority)
    found = lexicographic(joint, reach, targets, "torque")
    missed = (found.T_error > 1e-11 * reach.T_scale[targets.row]) | (found.K_error > 1e-11 * reach.K_scale[targets.row])
    if missed.any():
        P1, P2 = (P[missed] for P in found[:2])
        better = _found(
            joint, reach, targets.take(missed), *on_paths(joint, reach, targets.take(missed), weights, P1, P2)
        )
        for whole, part in zip(found, better, strict=True):
            whole[missed] = part
    return found


def _found(joint, reach, targets, P1, P2):
    theta = reach.theta[targets.row]
    T, K = joint.torque(theta, P1, P2), joint.stiffness(theta, P1, P2)
    return Found(P1, P2, np.abs(T - targets.T), np.abs(K - targets.K))


def lexicographic(joint, reach, targets, priority):
    """Return the nearest torque (or stiffness), then the nearest other one; only the latter if the first is fixed."""
    first = "tk"[priority == "stiffness"]
    constant = _constant(reach, first)[targets.row]
    found = Found(*np.empty((4, constant.size)))
    for where, name in ((constant, "kt"[first == "k"]), (~constant, first)):
        for whole, part in zip(found, _on_levels(joint, reach, targets.take(where), name), strict=True):
            whole[where] = part
    return found


def _constant(reach, first):
    """Return the angles at which no pressure changes the first quantity, up to rounding."""
    one, two = (getattr(curve, first) for curve in reach.curves)
    return np.ptp(one, axis=1) + np.ptp(two, axis=1) < 1e-12 * (np.abs(one).max(axis=1) + np.abs(two).max(axis=1))


def _on_levels(joint, reach, targets, first):
    P1, P2 = _nearest_ends(reach, targets, first)
    brackets = []
    for row in np.unique(targets.row):
        mine = np.flatnonzero(targets.row == row)
        brackets += _levels(reach, targets, mine[_within(reach, targets.take(mine), first)], row, first)
    if brackets:
        _refine(joint, reach, targets, first, Brackets(*map(np.concatenate, zip(*brackets, strict=True))), P1, P2)
    return _found(joint, reach, targets, P1, P2)


def _aims(targets, first):
    return (targets.T, targets.K) if first == "t" else (targets.K, targets.T)


def _within(reach, targets, first):
    """Return whether there is a level of the first target."""
    (aim, _), row = _aims(targets, first), targets.row
    one, two = (getattr(curve, first)[row] for curve in reach.curves)
    return (aim >= one.min(1) + two.min(1)) & (aim <= one.max(1) + two.max(1))


def _nearest_ends(reach, targets, first):
    """Return the pressures of the greatest first quantity, or of the least if the target is lower."""
    (aim, _), row = _aims(targets, first), targets.row
    values = [getattr(curve, first)[row] for curve in reach.curves]
    above = aim > sum(value.max(1) for value in values)
    at = [np.where(above, value.argmax(1), value.argmin(1)) for value in values]
    return tuple(curve.P[row, i] for curve, i in zip(reach.curves, at, strict=True))


def _levels(reach, targets, mine, row, first):
    """Return brackets on the sampled levels of the targets `mine`, all at the angle `row`."""
    aim, other_aim = (a[mine] for a in _aims(targets, first))
    second = "kt"[first == "k"]
    for side in (0, 1):
        own, other = (reach.curves[i].at(row) for i in (side, 1 - side))
        needed = aim[:, None] - getattr(own, first)  # (m, n)
        for run in runs(getattr(other, first), other.P, getattr(other, second)):
            inside = (needed >= run.q[0]) & (needed <= run.q[-1])
            error = getattr(own, second) + np.interp(needed, run.q, run.rest[0]) - other_aim[:, None]
            which, lo, hi = promising(np.where(inside, error, np.nan))
            ends = (np.full(which.shape, run.P[i]) for i in (0, -1))
            yield mine[which], np.full(which.shape, side), own.P[lo], own.P[hi], *ends


def promising(error):
    """Return (row, first and last sample) of stretches of rows of errors (NaN: none) that may contain the least.

    It may if its samples, minus half of their changes, are not above the least error in the row.
    """
    size = np.where(np.isfinite(error), np.abs(error), np.inf)
    border = np.full((len(size), 1), np.inf)
    left, right = np.hstack([border, size[:, :-1]]), np.hstack([size[:, 1:], border])
    swing = change(error)[:, [0, *range(size.shape[1] - 1)]]  # of the cell before a sample, and those near
    low = (size <= left) & (size <= right) & (size - swing / 2 <= size.min(axis=1, keepdims=True)) & np.isfinite(size)
    with np.errstate(invalid="ignore"):
        crossing = error[:, 1:] * error[:, :-1] < 0
    row, i = np.nonzero(low)
    lo, hi = np.where(np.isfinite(left[row, i]), i - 1, i), np.where(np.isfinite(right[row, i]), i + 1, i)
    rows, j = np.nonzero(crossing)
    return np.concatenate([row, rows]), np.concatenate([lo, j]), np.concatenate([hi, j + 1])


def _refine(joint, reach, targets, first, brackets, P1, P2):
    """Write into P1, P2 the pressures of the bracket with the least second error, for targets that have brackets."""
    sides = joint.sides(reach.theta[targets.row[brackets.target]])
    found = np.empty((3, brackets.target.size))  # P1, P2, |second error|
    for side in (0, 1):
        mine = np.flatnonzero(brackets.side == side)
        level = _Level(reach, targets, first, brackets.take(mine), _of(sides[side], mine), _of(sides[1 - side], mine))
        x, y, error = level.minimum()
        found[:, mine] = (y, x, error) if side else (x, y, error)
    order = np.lexsort((found[2], brackets.target))
    at, start = np.unique(brackets.target[order], return_index=True)
    P1[at], P2[at] = found[:2, order[start]]


def _of(side, where):
    """Return the same muscle at a selection of the angles."""
    return side.moved(*(np.asarray(array)[where] for array in side.arrays))


class _Level:
    """Points on levels of the first quantity, one in each bracket."""

    def __init__(self, reach, targets, first, brackets, own, other):
        self.brackets = brackets
        names = ("torque", "stiffness") if first == "t" else ("stiffness", "torque")
        (self.own_first, self.own_second), (self.other_first, self.other_second) = (
            tuple(getattr(side, name) for name in names) for side in (own, other)
        )
        self.gain = getattr(other, f"{names[0]}_gain")
        self.aim, self.second_aim = (a[brackets.target] for a in _aims(targets, first))
        self.enough = _KEPT * (reach.T_scale if first == "t" else reach.K_scale)[targets.row[brackets.target]]

    def partner(self, x, y):
        """Return the y on the level at x, by Newton's method from y, in a bracket."""
        low, high, needed = self.brackets.y_lo, self.brackets.y_hi, self.aim - self.own_first(x)
        for _ in range(_NEWTON):
            excess = self.other_first(y) - needed
            held = np.abs(excess) <= self.enough
            if held.all():
                break
            low, high = np.where(excess < 0, y, low), np.where(excess > 0, y, high)
            with np.errstate(divide="ignore", invalid="ignore"):
                step = y - excess / self.gain(y)
            inside = (step - low) * (step - high) < 0
            last, y = y, np.where(held, y, np.where(inside, step, (low + high) / 2))
            if (np.abs(y - last) <= _STILL * np.abs(y)).all():
                break
        return y

    def error(self, x, y):
        """Return (y on the level, second error there)."""
        y = self.partner(x, y)
        return y, self.own_second(x) + self.other_second(y) - self.second_aim

    def minimum(self):
        """Return (x, y, |second error|) of the least error found in each bracket; 0 if its sign changes."""
        y = (self.brackets.y_lo + self.brackets.y_hi) / 2
        sign = np.sign(self.error(self.brackets.x_lo, y)[1])
        partners, errors = [y], []

        def size(x):
            y, error = self.error(x, partners[-1])
            partners.append(y), errors.append(error)
            return sign * error

        x = golden_section(size, self.brackets.x_lo, self.brackets.x_hi)
        return self._least(x, np.stack(partners[1:]), np.stack(errors))

    def _least(self, x, y, error):
        """Return the least of all trials (s, c); between errors of both signs their root by bisection."""
        x_best, y_best, e_best = (pick(array, np.abs(error).argmin(axis=0)) for array in (x, y, error))
        positive, negative = pick(x, error.argmax(axis=0)), pick(x, error.argmin(axis=0))
        crosses = (error.max(axis=0) > 0) & (error.min(axis=0) < 0)
        for _ in range(_HALVINGS if crosses.any() else 0):
            middle = np.where(crosses, (positive + negative) / 2, x_best)
            y_best, e_middle = self.error(middle, y_best)
            positive, negative = np.where(e_middle > 0, middle, positive), np.where(e_middle > 0, negative, middle)
            nearer = np.abs(e_middle) < np.abs(e_best)
            x_best, e_best = np.where(nearer, middle, x_best), np.where(nearer, e_middle, e_best)
        return x_best, self.partner(x_best, y_best), np.abs(e_best)
