"""The best that can be had of a joint, by a dense search that uses nothing of the library's allocation.

Lexicographic priorities: every level of the first quantity through the box is sampled twice, over the samples of P1 and
over those of P2, so that its ends are samples of one or the other. Between samples with a change of the second error's
sign the target can be had; around every sample that is nearer to it than its neighbours the error is minimised by
golden section, the level being kept by a bracketed Newton's method. Weighted priority: `weighted_search`.

Found are pressures in the box and what the joint gives there: what is called attainable here is attained.
"""

from typing import NamedTuple

import numpy as np

from .curves import image, runs
from .weighted_search import on_paths

GOLDEN = (np.sqrt(5) - 1) / 2
_STEPS = 24  # of the golden section: a bracket shrinks to 1e-5 of itself, its minimum is found to 1e-10
_NEWTON = 60  # bound
_KEPT = 4e-15  # of the scale: a level held so well is held


class Targets(NamedTuple):
    """m targets at angles that an `Image` has; all (m,)."""

    row: np.ndarray  # index of the angle
    T: np.ndarray  # [N·m]
    K: np.ndarray  # [N·m/rad]

    def take(self, where):
        return Targets(*(array[where] for array in self))


class Found(NamedTuple):
    """The best pressures, and what they leave; all (m,)."""

    P1: np.ndarray  # [Pa]
    P2: np.ndarray
    T_error: np.ndarray  # |T - T*| [N·m]
    K_error: np.ndarray


class Brackets(NamedTuple):
    """Stretches of levels, in each of which the second error has one minimum; all (c,)."""

    target: np.ndarray
    side: np.ndarray  # whose pressure x is; the other muscle's is y
    x_lo: np.ndarray
    x_hi: np.ndarray
    y_lo: np.ndarray  # a monotone run of the other muscle's curve, the first quantity rises from y_lo to y_hi
    y_hi: np.ndarray


def best(joint, theta, T, K, priority, weights=(1.0, 1.0)):
    """What is to be had of targets (m,); at angles where no pressures keep both cables taut everything is NaN."""
    angles, row = np.unique(np.asarray(theta, float), return_inverse=True)
    reach = image(joint, angles)
    there = np.isin(angles[row], reach.theta)
    targets = Targets(np.searchsorted(reach.theta, angles[row][there]), np.asarray(T)[there], np.asarray(K)[there])
    found = Found(*(np.full(len(row), np.nan) for _ in Found._fields))
    for whole, part in zip(found, search(joint, reach, targets, priority, weights), strict=True):
        whole[there] = part
    return found


def search(joint, reach, targets, priority, weights=(1.0, 1.0)):
    """The same for an image that is there already."""
    if priority != "weighted":
        return lexicographic(joint, reach, targets, priority)
    found = lexicographic(joint, reach, targets, "torque")
    missed = (found.T_error > 1e-11 * reach.T_scale[targets.row]) | (found.K_error > 1e-11 * reach.K_scale[targets.row])
    if missed.any():
        P1, P2 = (P[missed] for P in found[:2])
        better = _found(joint, reach, targets.take(missed), *on_paths(joint, reach, targets.take(missed), weights, P1, P2))
        for whole, part in zip(found, better, strict=True):
            whole[missed] = part
    return found


def _found(joint, reach, targets, P1, P2):
    theta = reach.theta[targets.row]
    T, K = joint.torque(theta, P1, P2), joint.stiffness(theta, P1, P2)
    return Found(P1, P2, np.abs(T - targets.T), np.abs(K - targets.K))


def lexicographic(joint, reach, targets, priority):
    """First the nearest torque (or stiffness), then the nearest of the other."""
    first = "tk"[priority == "stiffness"]
    P1, P2 = _nearest_ends(reach, targets, first)
    held, brackets = [], []
    for row in np.unique(targets.row):
        mine = np.flatnonzero(targets.row == row)
        nearest = _within(reach, targets.take(mine), first)
        held.append((mine[nearest], row))
        brackets += [*_levels(reach, targets, mine[nearest], row, first)]
    if brackets:
        P1, P2 = _refined(joint, reach, targets, first, Brackets(*map(np.concatenate, zip(*brackets, strict=True))), P1, P2)
    return _found(joint, reach, targets, P1, P2)


def _aims(targets, first):
    return (targets.T, targets.K) if first == "t" else (targets.K, targets.T)


def _within(reach, targets, first):
    """Whether there is a level of the first target."""
    (aim, _), row = _aims(targets, first), targets.row
    one, two = (getattr(curve, first)[row] for curve in reach.curves)
    return (aim >= one.min(1) + two.min(1)) & (aim <= one.max(1) + two.max(1))


def _nearest_ends(reach, targets, first):
    """Where the first quantity is greatest, or least if less than that is wanted."""
    (aim, _), row = _aims(targets, first), targets.row
    values = [getattr(curve, first)[row] for curve in reach.curves]
    above = aim > sum(value.max(1) for value in values)
    at = [np.where(above, value.argmax(1), value.argmin(1)) for value in values]
    return tuple(curve.P[row, i] for curve, i in zip(reach.curves, at, strict=True))


def _levels(reach, targets, mine, row, first):
    """Brackets on the sampled levels of the targets `mine`, all at the angle `row`."""
    aim, other_aim = (a[mine] for a in _aims(targets, first))
    second = "kt"[first == "k"]
    for side in (0, 1):
        own, other = (reach.curves[i].at(row) for i in (side, 1 - side))
        needed = aim[:, None] - getattr(own, first)  # (m, n)
        for run in runs(getattr(other, first), other.P, getattr(other, second)):
            inside = (needed >= run.q[0]) & (needed <= run.q[-1])
            error = getattr(own, second) + np.interp(needed, run.q, run.rest[0]) - other_aim[:, None]
            which, lo, hi = promising(np.where(inside, error, np.nan))
            full = np.full(which.shape, 1.0)
            yield mine[which], (side * full).astype(int), own.P[lo], own.P[hi], run.P[0] * full, run.P[-1] * full


def promising(error):
    """(row, first and last sample) of stretches of rows of errors, NaN where there are none, that may hold the least.

    A stretch may if its samples, minus twice what they change by, are not above the least error in the row.
    """
    size = np.where(np.isfinite(error), np.abs(error), np.inf)
    border = np.full((len(size), 1), np.inf)
    left, right = np.hstack([border, size[:, :-1]]), np.hstack([size[:, 1:], border])
    with np.errstate(invalid="ignore"):
        change = np.fmax(np.where(np.isfinite(left), left - size, 0), np.where(np.isfinite(right), right - size, 0))
        low = np.isfinite(size) & (size <= left) & (size <= right)
        low &= size - 2 * change <= size.min(axis=1, keepdims=True)
        crossing = error[:, 1:] * error[:, :-1] < 0
    row, i = np.nonzero(low)
    lo, hi = np.where(np.isfinite(left[row, i]), i - 1, i), np.where(np.isfinite(right[row, i]), i + 1, i)
    rows, j = np.nonzero(crossing)
    return np.concatenate([row, rows]), np.concatenate([lo, j]), np.concatenate([hi, j + 1])


def _refined(joint, reach, targets, first, brackets, P1, P2):
    """The pressures of the bracket with the least second error, of each target; its start where it has none."""
    level = _Level(joint, reach, targets, first, brackets)
    x, y, error = level.minimum()
    order = np.lexsort((error, brackets.target))
    chosen = order[np.unique(brackets.target[order], return_index=True)[1]]
    own_is_2, at = brackets.side[chosen] == 1, brackets.target[chosen]
    P1[at] = np.where(own_is_2, y[chosen], x[chosen])
    P2[at] = np.where(own_is_2, x[chosen], y[chosen])
    return P1, P2


class _Level:
    """Points on levels of the first quantity, one in each bracket."""

    def __init__(self, joint, reach, targets, first, brackets):
        self.joint, self.first, self.brackets = joint, first, brackets
        self.theta = reach.theta[targets.row[brackets.target]]
        self.aim, self.second_aim = (a[brackets.target] for a in _aims(targets, first))
        self.scale = (reach.T_scale if first == "t" else reach.K_scale)[targets.row[brackets.target]]

    def given(self, x, y):
        """(first, second) quantity."""
        P1, P2 = np.where(self.brackets.side == 1, y, x), np.where(self.brackets.side == 1, x, y)
        values = self.joint.torque(self.theta, P1, P2), self.joint.stiffness(self.theta, P1, P2)
        return values if self.first == "t" else values[::-1]

    def gain(self, x, y):
        """Derivative of the first quantity by y."""
        P1, P2 = np.where(self.brackets.side == 1, y, x), np.where(self.brackets.side == 1, x, y)
        gains = self.joint.jacobian(self.theta, P1, P2)[self.first == "k"]
        return np.where(self.brackets.side == 1, *gains)

    def partner(self, x, y):
        """The y that keeps the level at x, by Newton's method from y, in a bracket."""
        low, high = self.brackets.y_lo, self.brackets.y_hi
        for _ in range(_NEWTON):
            excess = self.given(x, y)[0] - self.aim
            if (np.abs(excess) <= _KEPT * self.scale).all():
                break
            low, high = np.where(excess < 0, y, low), np.where(excess > 0, y, high)
            with np.errstate(divide="ignore", invalid="ignore"):
                step = y - excess / self.gain(x, y)
            inside = (step - low) * (step - high) < 0
            y = np.where(np.abs(excess) <= _KEPT * self.scale, y, np.where(inside, step, (low + high) / 2))
        return y

    def error(self, x, y):
        """(y on the level, second error there)."""
        y = self.partner(x, y)
        return y, self.given(x, y)[1] - self.second_aim

    def minimum(self):
        """(x, y, |second error|) of the least error found in each bracket; 0 where its sign changes."""
        low, high = self.brackets.x_lo, self.brackets.x_hi
        y = (self.brackets.y_lo + self.brackets.y_hi) / 2
        tried = []
        for x in (low, high):
            y, error = self.error(x, y)
            tried.append((x, y, error))
        sign = np.sign(tried[0][2])
        points = [high - GOLDEN * (high - low), low + GOLDEN * (high - low)]
        values = []
        for x in points:
            y, error = self.error(x, y)
            values.append(sign * error)
            tried.append((x, y, error))
        for _ in range(_STEPS):
            keep_left = values[0] < values[1]
            low, high = np.where(keep_left, low, points[0]), np.where(keep_left, points[1], high)
            new = np.where(keep_left, high - GOLDEN * (high - low), low + GOLDEN * (high - low))
            y, error = self.error(new, y)
            tried.append((new, y, error))
            points = [np.where(keep_left, new, points[1]), np.where(keep_left, points[0], new)]
            values = [np.where(keep_left, sign * error, values[1]), np.where(keep_left, values[0], sign * error)]
        return self._least(*(np.stack(column) for column in zip(*tried, strict=True)))

    def _least(self, x, y, error):
        """Of all that was tried; between errors of both signs their root by bisection."""
        at = np.abs(error).argmin(axis=0)[None]
        x_best, y_best, e_best = (np.take_along_axis(array, at, 0)[0] for array in (x, y, error))
        up, down = error.argmax(axis=0)[None], error.argmin(axis=0)[None]
        positive, negative = (np.take_along_axis(x, i, 0)[0] for i in (up, down))
        crosses = (error.max(axis=0) > 0) & (error.min(axis=0) < 0)
        for _ in range(50 if crosses.any() else 0):
            middle = (positive + negative) / 2
            y_best, e_middle = self.error(np.where(crosses, middle, x_best), y_best)
            positive, negative = np.where(e_middle > 0, middle, positive), np.where(e_middle > 0, negative, middle)
            nearer = crosses & (np.abs(e_middle) < np.abs(e_best))
            x_best, e_best = np.where(nearer, middle, x_best), np.where(nearer, e_middle, e_best)
        return x_best, self.partner(x_best, y_best), np.abs(e_best)


__all__ = ["Found", "Targets", "best", "lexicographic", "search"]
