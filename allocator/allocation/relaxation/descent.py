"""Descent of pressures to a local optimum of all levels of problem [M], by the Gauss–Newton method.

Around the pressures of a step every muscle's F and k are linearised. [M] is then that of affine muscles, which the
kernel solves exactly, level after level, within a trust region. The step is taken in the forces, so it gives the
intended torques. It is accepted if it lowers the cost of the first level that it changes; else the trust region
shrinks. Its limit satisfies the optimality conditions of all levels of [M], measured by the same residual as for affine
muscles.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple, cast

import numpy as np

from allocator.allocation.box import pivoting
from allocator.allocation.box.pivoting import Solved
from allocator.allocation.box.problem import BoxProblem
from allocator.allocation.relaxation.model import Model
from allocator.calculus import Array
from allocator.mechanism.mechanism import Indices

_STEPS = 100
_SETTLED = 1e-13  # of the supply: a smaller step ends the descent
_SMALLEST = 1e-9  # trust region, of the supply
_NOTHING = 1e-10  # of the scale of y: smaller errors are rounding
_CHANGES = 1e-13  # of a cost: a smaller change is rounding
_ALIKE = 1e-6  # of a cost: a smaller change does not matter while the steps become smaller …
_CONTRACTS = 0.9  # … to this ratio per step
_RESTORED = 2  # steps back to the values of earlier levels
_DIFFERENCE = 1e-4  # of the supply, of second derivatives
_MATTERS = 1e-4  # of a level's Hessian: smaller curvature is left out
_STRETCHES = 0.05, 20.0  # between which the Hessian's diagonal is kept
_NEWTON = 8  # steps of the inverse of a force law


class Found(NamedTuple):
    """Results of S descents."""

    P: Array  # (S, m) [Pa]
    costs: Array  # (S, K + 1) of the levels [cost], and of the distance from the reference, of the supply
    left: Array  # weighted errors C v - y* (S, p)

    def of(self, target: int) -> "Found":
        """Return the result of one of them."""
        return Found(*(array[target : target + 1] for array in self))


@dataclass(frozen=True, eq=False)
class _Linear:
    """Linearised problem, for `pivoting`."""

    A: Array
    b: Array
    ends: Indices
    x_bounds: tuple[Array, Array, Array]
    pull: float = 0.0

    @property
    def rows(self) -> tuple[Indices, Indices]:
        return np.arange(self.ends[-1]), self.ends

    @property
    def which(self) -> Indices:
        return np.arange(len(self.b))

    @property
    def problem(self) -> BoxProblem:
        return cast(BoxProblem, self)

    def multipliers(self, model: Model, solved: Solved) -> Array:
        """Return the multipliers of the rows of the model (S, K + 1, p)."""
        sizes = np.diff(model.problem.rows[1], prepend=0).tolist()
        own = [np.arange(begin, begin + size) for begin, size in zip([0, *self.ends[:-1].tolist()], sizes, strict=True)]
        return np.asarray(solved.mu[:, :, np.concatenate(own)])


def descend(model: Model, which: Indices, P: Array, steps: int = _STEPS) -> Found:
    """Return the limits of descents of the targets `which` (S,) from pressures `P` (S, m) [Pa]."""
    now = _at(model, which, np.array(P))
    radius, last, bent = np.ones(len(P)), np.full(len(P), np.inf), _unbent(model, P)
    going = np.arange(len(P))
    for _ in range(steps):
        here, before = which[going], Found(*(array[going] for array in now))
        tried, mu = _restored(model, here, before, radius[going], bent[going])
        moved = np.abs(tried.P - before.P).max(axis=1) / model.problem.unit
        good = lower(model, here, tried.costs, before.costs)
        good = good | ((moved < _CONTRACTS * last[going]) & lower(model, here, tried.costs, before.costs, _ALIKE))
        for array, new in zip(now, tried, strict=True):
            array[going[good]] = new[good]
        bent[going] = _bent(model, here, now.P[going], mu)
        last[going] = moved
        radius[going] = np.where(good, np.minimum(2 * radius[going], 1.0), np.minimum(radius[going], moved) / 4)
        going = going[(moved > _SETTLED) & (radius[going] > _SMALLEST)]
        if not going.size:
            break
    return now


def _at(model: Model, which: Indices, P: Array) -> Found:
    """Return the results at pressures (S, m)."""
    left = model.left(which, model.states(which, P))
    levels = [(left[:, a:b] ** 2).sum(axis=1) for a, b in _levels(model)]
    away = (((P - model.reference[which]) / model.problem.unit) ** 2).sum(axis=1)
    return Found(P, np.stack([*levels, away], axis=1), left)


def _restored(model: Model, which: Indices, now: Found, radius: Array, bent: Array) -> tuple[Found, Array]:
    """Return the results after a step and some restoration steps to the levels' values, and the step's multipliers."""
    P, mu = _step(model, which, now.P, now.left, radius, model.reference[which], bent)
    for _ in range(_RESTORED):
        P, _ = _step(model, which, P, model.left(which, model.states(which, P)), radius, P, bent)
    return _at(model, which, P), mu


def certified(model: Model, P: Array) -> tuple[Solved, Array]:
    """Return the multipliers at the pressures `P` (N, m) of all targets, and the residuals of optimality (N,)."""
    every = np.arange(len(P))
    left = model.left(every, model.states(every, P))
    errors = np.zeros((len(P), len(_levels(model)) + 1, left.shape[1]))
    for k, (a, b) in enumerate(_levels(model)):
        errors[:, k, a:b] = left[:, a:b]
    linear = _linear(model, every, P, left, (*model.bounds, model.reference), _bent(model, every, P, errors))
    solved = pivoting.solve(linear.problem)._replace(x=P / model.problem.unit)
    return solved._replace(mu=linear.multipliers(model, solved)), pivoting.residuals(linear.problem, solved)


def _linear(
    model: Model, which: Indices, P: Array, left: Array, box: tuple[Array, Array, Array], bent: Array
) -> _Linear:
    """Return the problem linearised at `P`, within box = (lo, hi, centre), in bent[:, K]·P/unit.

    Positive curvature in a level is a row of its own, bent[:, k, j] times the step of muscle j.
    """
    unit, m = model.problem.unit / bent[:, -1], P.shape[1]
    rows = model.weighted if len(model.weighted) == 1 else model.weighted[model.posture(which)]
    gains = model.state_gains(which, P) * np.repeat(unit, 2, axis=1)
    A = (rows * gains[:, None, :]).reshape(len(P), -1, m, 2).sum(axis=-1)
    extra = bent[:, :-1, :, None] / bent[:, -1, :, None][:, None] * np.eye(m)
    x, parts, error, upto = P / unit, [], [], []
    for k, (begin, end) in enumerate(_levels(model)):
        some = (extra[:, k] != 0).any(axis=(0, 2))
        parts += [A[:, begin:end], extra[:, k, some]]
        error += [left[:, begin:end], np.zeros((len(P), int(some.sum())))]
        upto.append(end - begin + int(some.sum()))
    whole = np.concatenate(parts, axis=1)
    b = (whole @ x[:, :, None])[:, :, 0] - np.concatenate(error, axis=1)
    lo, hi, centre = (np.ascontiguousarray(end / unit) for end in box)
    return _Linear(whole, b, np.cumsum(upto), (lo, hi, centre))


def _levels(model: Model) -> list[tuple[int, int]]:
    """Return the first and last rows of each level."""
    return list(pairwise([0, *model.problem.rows[1].tolist()]))


def _unbent(model: Model, P: Array) -> Array:
    """Return the values (S, K + 1, m) of `_bent` for affine muscles."""
    found = np.zeros((len(P), len(model.problem.rows[1]) + 1, P.shape[1]))
    found[:, -1] = 1.0
    return found


def _bent(model: Model, which: Indices, P: Array, mu: Array) -> Array:
    """Return the roots (S, K + 1, m) of the diagonals that the curves add to the Hessians of the levels' Lagrangians.

    `mu` (S, K + 1, p) are the multipliers. The levels are in forces, in which torques are linear, and only positive
    curvature counts; the distance from the reference is in pressures, with its own Hessian.
    """
    h, unit, m = _DIFFERENCE * model.problem.unit, model.problem.unit, P.shape[1]
    gains = model.state_gains(which, P)
    second = (model.state_gains(which, P + h) - model.state_gains(which, P - h)) / (2 * h)
    rows = model.weighted if len(model.weighted) == 1 else model.weighted[model.posture(which)]
    pull = (mu @ np.broadcast_to(rows, (len(P), *rows.shape[1:]))) * unit**2  # (S, K + 1, 2m)
    along_force = second[:, 1::2] - gains[:, 1::2] * second[:, ::2] / gains[:, ::2]
    found = pull[:, :, 1::2] * along_force[:, None]
    straight = [((rows[:, a:b] * gains[:, None] * unit) ** 2).max(axis=(1, 2)) for a, b in _levels(model)]
    found[:, :-1] *= found[:, :-1] > _MATTERS * np.stack(straight, axis=1)[:, :, None]
    found[:, -1] = np.clip(1 + (pull[:, -1] * second).reshape(len(P), m, 2).sum(axis=-1), *_STRETCHES)
    return np.asarray(np.sqrt(found))


def _step(
    model: Model, which: Indices, P: Array, left: Array, radius: Array, centre: Array, bent: Array
) -> tuple[Array, Array]:
    """Return the pressures (S, m) after one step of at most `radius` (S,) of the supply, and the multipliers.

    Among equally good ones it has the least Σ bent[:, K]² (P - P_now)²/2 + (P_now - centre)·P.
    """
    unit, F, gain, stretch = model.problem.unit, model.forces(which, P), model.force_gains(which, P), bent[:, -1]
    (lo, hi), reach = (end[which] for end in model.bounds), radius[:, None] * unit
    least, most = (P + (end[which] - F) / gain for end in model.force_bounds)
    box = np.maximum(np.minimum(least, P), P - reach), np.minimum(np.maximum(most, P), P + reach)
    linear = _linear(model, which, P, left, (*box, P + (centre - P) / stretch**2), bent)
    solved = pivoting.solve(linear.problem)
    x = solved.x * unit / stretch
    wanted = F + gain * (x - P)
    found = np.clip(x, lo, hi)
    for _ in range(_NEWTON):
        off = (wanted - model.forces(which, found)) / model.force_gains(which, found)
        found = np.clip(found + off, lo, hi)
        if np.abs(off).max() <= _SETTLED * unit:
            break
    near = 1e-12 * unit
    return np.where(x <= least + near, lo, np.where(x >= most - near, hi, found)), linear.multipliers(model, solved)


def lower(model: Model, which: Indices, new: Array, old: Array, alike: float = _CHANGES) -> Array:
    """Return whether the first level that changes by more than `alike` of it has a lower cost, or none changes."""
    scale = (_NOTHING * model.scale[which]) ** 2
    small = np.concatenate([scale, np.full((len(new), 1), 1e-12)], axis=1) + alike * old
    changes = np.abs(new - old) > small
    first = np.where(changes.any(axis=1), changes.argmax(axis=1), new.shape[1] - 1)
    row = np.arange(len(new))
    return np.asarray(~changes.any(axis=1) | (new[row, first] < old[row, first]))
