"""The box of taut pressures and the two curves whose sum is the reachable set, by brute force at many angles.

Torque and stiffness are sums of one function per pressure: (T, K) = (t1, k1)(P1) + (t2, k2)(P2), up to a constant that
is given to muscle 1. Of the library only a joint's values at given pressures are used. Turning points of k and kinks
are enclosed between adjacent samples as close as possible, so that everything between two samples is monotone and
smooth.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

SUPPLY_SAMPLES = 2001
SAMPLES = 400  # of each curve, without those at special points
_TURNS = 4  # turning points of k in a curve, at most
_HALVINGS = 60


class Curve(NamedTuple):
    """Contribution of one muscle at one angle, or at A angles in rows."""

    P: np.ndarray  # (A, n) [Pa], increasing
    t: np.ndarray  # added torque [N·m]
    k: np.ndarray  # added stiffness [N·m/rad]
    m: np.ndarray  # dk/dt [1/rad]

    def at(self, row):
        """Return the curve at one angle, or at some."""
        return Curve(*(array[row] for array in self))


class Image(NamedTuple):
    """Reachable sets of a joint at A angles."""

    theta: np.ndarray  # (A,) [rad]
    curves: tuple[Curve, Curve]
    T_scale: np.ndarray  # (A,) scale [N·m]
    K_scale: np.ndarray  # [N·m/rad]

    @property
    def lo(self):
        """Least pressures (A,) of both muscles [Pa]."""
        return tuple(curve.P[:, 0] for curve in self.curves)

    @property
    def hi(self):
        return tuple(curve.P[:, -1] for curve in self.curves)

    def take(self, rows):
        """Return the sets at some of the angles."""
        return Image(self.theta[rows], tuple(c.at(rows) for c in self.curves), self.T_scale[rows], self.K_scale[rows])


def image(joint, theta):
    """Return the reachable sets at those of the angles (A,) at which both muscles can be taut."""
    lo, hi, taut = taut_box(joint, theta)
    theta, lo, hi = theta[taut], lo[:, taut], hi[:, taut]
    curves = tuple(_curve(joint, theta, side, lo, hi) for side in (0, 1))
    (t1, t2), (k1, k2) = (c.t for c in curves), (c.k for c in curves)
    T_ends, K_ends = (np.stack([a.min(1) + b.min(1), a.max(1) + b.max(1)]) for a, b in ((t1, t2), (k1, k2)))
    return Image(theta, curves, *(np.abs(ends).max(0) + np.ptp(ends, axis=0) for ends in (T_ends, K_ends)))


def taut_box(joint, theta):
    """Return the least and greatest pressures of both muscles (2, A) with a force ≥ 0, and whether they exist."""
    muscles, A = (joint.agonist, joint.antagonist), len(theta)
    lo, hi, taut = np.empty((2, A)), np.empty((2, A)), np.ones(A, bool)
    for side, muscle in enumerate(muscles):
        P = np.linspace(joint.pressure_limits[0], min(joint.pressure_limits[1], muscle.max_pressure), SUPPLY_SAMPLES)
        slack = joint.forces(theta[:, None], P, P)[side] < 0  # (A, samples)
        last = np.where(slack.any(1), SUPPLY_SAMPLES - 1 - slack[:, ::-1].argmax(1), -1)
        taut &= last < SUPPLY_SAMPLES - 1
        left, right = P[np.maximum(last, 0)], P[np.minimum(last + 1, SUPPLY_SAMPLES - 1)]
        for _ in range(_HALVINGS):
            middle = (left + right) / 2
            pulls = joint.forces(theta, middle, middle)[side] >= 0
            left, right = np.where(pulls, left, middle), np.where(pulls, middle, right)
        lo[side], hi[side] = np.where(last < 0, P[0], right), P[-1]
    return lo, hi, taut & (hi - lo > 1e-6 * joint.pressure_span).all(0)


def _curve(joint, theta, side, lo, hi):
    P = lo[side][:, None] + np.linspace(0, 1, SAMPLES) * (hi - lo)[side][:, None]
    P[:, -1] = hi[side]
    P = np.sort(np.hstack([P, _special(joint, theta, side, lo, P)]), axis=1)
    other, column = lo[1 - side][:, None], theta[:, None]
    t, k = joint.torque(column, *_pair(side, P, other)), joint.stiffness(column, *_pair(side, P, other))
    if side:
        t, k = t - joint.torque(column, *lo[:, :, None]), k - joint.stiffness(column, *lo[:, :, None])
    return Curve(P, t, k, np.divide(*_gains(joint, column, side, P, other)))


def _pair(side, own, other):
    """(P1, P2)."""
    return (other, own) if side else (own, other)


def _gains(joint, theta, side, P, other):
    """Return (dk/dP, dt/dP) of one muscle."""
    (t1, t2), (k1, k2) = joint.jacobian(theta, *_pair(side, P, other))
    return (k2, t2) if side else (k1, t1)


def _special(joint, theta, side, lo, P):
    """Return pressures (A, 2·_TURNS + 2) around turning points of k and the sharpest bend; else arbitrary ones."""

    def turn(row, P):
        return np.sign(_gains(joint, theta[row], side, P, lo[1 - side][row])[0])

    def slope(row, P):
        return np.divide(*_gains(joint, theta[row], side, P, lo[1 - side][row]))

    every = np.arange(theta.size)
    turns = np.diff(turn(every[:, None], P), axis=1) != 0
    number = np.cumsum(turns, axis=1)  # of the turning point, from 1
    row, cell = np.nonzero(turns & (number <= _TURNS))
    steps = np.abs(np.diff(slope(every[:, None], P), axis=1))
    bend = 1 + np.argmax(steps[:, 1:-1] - np.maximum(steps[:, 2:], steps[:, :-2]), axis=1)
    found = (P[:, : 2 * _TURNS + 2] + P[:, 1 : 2 * _TURNS + 3]) / 2
    for value, where, i, column in ((turn, row, cell, 2 * number[row, cell] - 2), (slope, every, bend, 2 * _TURNS)):
        found[where, column], found[where, column + 1] = _enclosed(value, where, P[where, i], P[where, i + 1])
    return found


def _enclosed(value, row, left, right):
    """Halve cells as far as possible, keeping the half in which the value changes more."""
    at_left, at_right = value(row, left), value(row, right)
    for _ in range(_HALVINGS):
        middle = (left + right) / 2
        at_middle = value(row, middle)
        like_left = np.abs(at_middle - at_left) < np.abs(at_middle - at_right)
        left, right = np.where(like_left, middle, left), np.where(like_left, right, middle)
    return left, right


class Run(NamedTuple):
    """Stretch of a curve on which a quantity is monotone: samples in its rising order."""

    q: np.ndarray
    P: np.ndarray
    rest: tuple[np.ndarray, ...]  # other quantities there


def runs(q, P, *rest):
    """Return the stretches between the turning points of q (n,); none if it is constant up to rounding."""
    steps = np.diff(q)
    moving = np.flatnonzero(np.abs(steps) > 1e-12 * np.abs(q).max())
    if np.ptp(q) <= 1e-12 * np.abs(q).max() or not moving.size:
        return
    signs = np.sign(steps[moving])
    cuts = [0, *(moving[1:][signs[1:] != signs[:-1]]), q.size - 1]
    for start, end in pairwise(cuts):
        piece = slice(start, end + 1)
        arrays = [array[piece] for array in (q, P, *rest)]
        if arrays[0][-1] < arrays[0][0]:
            arrays = [array[::-1] for array in arrays]
        yield Run(np.maximum.accumulate(arrays[0]), arrays[1], tuple(arrays[2:]))
