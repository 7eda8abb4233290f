"""Pressures go down to a local optimum of all levels of problem [M] here, by Gauss and Newton's method.

About the pressures of a step every muscle's F and k are straight lines, and [M] is that of affine muscles, which the
kernel solves exactly, level after level, within a trust region. The step is taken in the forces, so that torques are
what the step has meant them to be. It counts if, of the first level that it changes, it lowers the cost; else the trust
region shrinks. What it settles at satisfies the optimality conditions of [M], of all levels: the same residual as for
affine muscles measures that.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple, cast

import numpy as np

from allocator.calculus import Array
from allocator.mechanism import batches
from allocator.mechanism.batches import Solved
from allocator.mechanism.mechanism import Indices
from allocator.mechanism.problem import MechanismProblem
from allocator.mechanism.relaxation.model import Model

_STEPS = 60
_SETTLED = 1e-13  # of the supply: a smaller step ends it
_SMALLEST = 1e-9  # trust region, of the supply
_NOTHING = 1e-10  # of the scale of y: smaller errors are none
_CHANGES = 1e-13  # of a cost: a smaller change is none
_ALIKE = 1e-6  # of a cost: a smaller change does not matter while the steps become smaller …
_CONTRACTS = 0.9  # … from one to the next, to so much of it
_RESTORED = 2  # steps back to what the earlier levels had
_DIFFERENCE = 1e-4  # of the supply, of second derivatives
_STRETCHES = 0.05, 20.0  # between which the Hessian's diagonal is kept
_NEWTON = 8  # steps of the inverse of a force law


class Found(NamedTuple):
    """`Found` is what S descents have come to."""

    P: Array  # (S, m) [Pa]
    costs: Array  # (S, K + 1) of the levels [cost], and of the distance from the reference, of the supply
    left: Array  # weighted errors C v - y* (S, p)

    def of(self, target: int) -> "Found":
        """Return what one of them has come to."""
        return Found(*(array[target : target + 1] for array in self))


@dataclass(frozen=True, eq=False)
class _Linear:
    """A `_Linear` is the problem of the straight lines, as `batches` takes it."""

    A: Array
    b: Array
    rows: tuple[Indices, Indices]
    x_bounds: tuple[Array, Array, Array]

    @property
    def which(self) -> Indices:
        return np.arange(len(self.b))

    @property
    def problem(self) -> MechanismProblem:
        return cast(MechanismProblem, self)


def descend(model: Model, which: Indices, P: Array, steps: int = _STEPS) -> Found:
    """Return where the descents of the targets `which` (S,) from pressures `P` (S, m) [Pa] settle."""
    now = _at(model, which, np.array(P))
    radius, stretch, last = np.ones(len(P)), np.ones(P.shape), np.full(len(P), np.inf)
    going = np.arange(len(P))
    for _ in range(steps):
        here, before = which[going], Found(*(array[going] for array in now))
        tried, mu = _restored(model, here, before, radius[going], stretch[going])
        moved = np.abs(tried.P - before.P).max(axis=1) / model.problem.unit
        good = _lower(model, here, tried.costs, before.costs, _CHANGES)
        good = good | ((moved < _CONTRACTS * last[going]) & _lower(model, here, tried.costs, before.costs, _ALIKE))
        for array, new in zip(now, tried, strict=True):
            array[going[good]] = new[good]
        stretch[going] = _stretch(model, here, now.P[going], mu)
        last[going] = moved
        radius[going] = np.where(good, np.minimum(2 * radius[going], 1.0), np.minimum(radius[going], moved) / 4)
        going = going[(moved > _SETTLED) & (radius[going] > _SMALLEST)]
        if not going.size:
            break
    return now


def _at(model: Model, which: Indices, P: Array) -> Found:
    """Return what pressures (S, m) are worth."""
    left = model.left(which, model.states(which, P))
    ends = [0, *model.problem.rows[1].tolist()]
    levels = [(left[:, a:b] ** 2).sum(axis=1) for a, b in pairwise(ends)]
    away = (((P - model.reference[which]) / model.problem.unit) ** 2).sum(axis=1)
    return Found(P, np.stack([*levels, away], axis=1), left)


def _restored(model: Model, which: Indices, now: Found, radius: Array, stretch: Array) -> tuple[Found, Array]:
    """Return where a step leads, and some from there back to what the levels can have; and its multipliers."""
    P, mu = _step(model, which, now.P, now.left, radius, model.reference[which], stretch)
    for _ in range(_RESTORED):
        P, _ = _step(model, which, P, model.left(which, model.states(which, P)), radius, P, stretch)
    return _at(model, which, P), mu


def certified(model: Model, P: Array) -> tuple[Solved, Array]:
    """Return the multipliers at the pressures `P` (N, m) of all targets, and the residuals of optimality (N,)."""
    every = np.arange(len(P))
    left = model.left(every, model.states(every, P))
    linear = _linear(model, every, P, left, (*model.bounds, model.reference), np.ones(P.shape))
    solved = batches.solve(linear.problem)
    solved = solved._replace(x=P / model.problem.unit)
    return solved, batches.residuals(linear.problem, solved)


def _linear(
    model: Model, which: Indices, P: Array, left: Array, box: tuple[Array, Array, Array], stretch: Array
) -> _Linear:
    """Return the problem of the straight lines about `P`, within box = (lo, hi, centre), in stretch·P/unit."""
    unit, m = model.problem.unit / stretch, P.shape[1]
    rows = model.weighted if len(model.weighted) == 1 else model.weighted[model.posture(which)]
    gains = model.state_gains(which, P) * np.repeat(unit, 2, axis=1)
    A = (rows * gains[:, None, :]).reshape(len(P), -1, m, 2).sum(axis=-1)
    b = (A @ (P / unit)[:, :, None])[:, :, 0] - left
    lo, hi, centre = (np.ascontiguousarray(end / unit) for end in box)
    return _Linear(np.ascontiguousarray(A), np.ascontiguousarray(b), model.problem.rows, (lo, hi, centre))


def _stretch(model: Model, which: Indices, P: Array, mu: Array) -> Array:
    """Return the roots (S, m) of the diagonal of the Hessian of the last level's Lagrangian, over the reference's."""
    h, unit, m = _DIFFERENCE * model.problem.unit, model.problem.unit, P.shape[1]
    bent = (model.state_gains(which, P + h) - model.state_gains(which, P - h)) / (2 * h) * unit**2
    rows = model.weighted if len(model.weighted) == 1 else model.weighted[model.posture(which)]
    pull = (mu[:, :, None] * rows).sum(axis=1)
    diagonal = 1 + (pull * bent).reshape(len(P), m, 2).sum(axis=-1)
    return np.asarray(np.sqrt(np.clip(diagonal, *_STRETCHES)))


def _step(
    model: Model, which: Indices, P: Array, left: Array, radius: Array, centre: Array, stretch: Array
) -> tuple[Array, Array]:
    """Return the pressures (S, m) that one step leads to, `radius` (S,) of the supply at most, and the multipliers.

    Of equally good ones it seeks the least Σ stretch (P - P_now)²/2 + (P_now - centre)·P.
    """
    unit, F, gain = model.problem.unit, model.forces(which, P), model.force_gains(which, P)
    (lo, hi), reach = (end[which] for end in model.bounds), radius[:, None] * unit
    least, most = (P + (model.forces(which, end) - F) / gain for end in (lo, hi))
    box = np.maximum(np.minimum(least, P), P - reach), np.minimum(np.maximum(most, P), P + reach)
    linear = _linear(model, which, P, left, (*box, P + (centre - P) / stretch**2), stretch)
    solved = batches.solve(linear.problem)
    x = solved.x * unit / stretch
    wanted = F + gain * (x - P)
    found = np.clip(x, lo, hi)
    for _ in range(_NEWTON):
        off = (wanted - model.forces(which, found)) / model.force_gains(which, found)
        found = np.clip(found + off, lo, hi)
        if np.abs(off).max() <= _SETTLED * unit:
            break
    near = 1e-12 * unit
    return np.where(x <= least + near, lo, np.where(x >= most - near, hi, found)), solved.mu[:, -1]


def _lower(model: Model, which: Indices, new: Array, old: Array, alike: float) -> Array:
    """Return where the first level that changes, by more than `alike` of it, has a lower cost, or none changes."""
    scale = (_NOTHING * model.scale[which]) ** 2
    small = np.concatenate([scale, np.full((len(new), 1), 1e-12)], axis=1) + alike * old
    changes = np.abs(new - old) > small
    first = np.where(changes.any(axis=1), changes.argmax(axis=1), new.shape[1] - 1)
    row = np.arange(len(new))
    return np.asarray(~changes.any(axis=1) | (new[row, first] < old[row, first]))


__all__ = ["Found", "certified", "descend"]
