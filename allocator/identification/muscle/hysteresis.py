"""Hysteresis of measured forces, as the difference between the branches of rising and falling pressure or contraction.

    F = f(ε, P) - s_P h_P/2 - s_ε h_ε/2        s = +1 on a rising branch, -1 on a falling one, 0 where it rests

f is a polynomial in contraction and pressure, and h is found by least squares: the mean by which the falling branch
pulls harder. A law without memory runs between the branches, ± h/2 from both. The branches follow from a column of
directions or from the order of the rows, each of which is a step of the quantity that moves further in its range.
"""

from typing import NamedTuple

import numpy as np

from allocator.calculus import Array, Mask
from allocator.identification.muscle.load_cell import polynomial
from allocator.identification.muscle.samples import Samples

_STILL = 1e-3  # of the range: a smaller step is rest
_WINDOWS = 500  # of a log, over each of which it is seen what moves
_JUMP = 0.3  # of the range: a greater step is a new row of a table rather than a motion
_LEAST_RUN = 3  # rows of one branch after each other
_LEAST_ROWS = 5  # on either branch
_SURE = 4.0  # standard deviations that a difference has to exceed
_LEAST = 0.005  # of full scale: a smaller difference is not worth a sentence


class Branches(NamedTuple):
    """Difference between falling and rising branches of one quantity."""

    quantity: str  # "pressure" or "contraction"
    difference: float  # h, mean force on falling branches less that on rising ones [N]
    std: float  # of h [N]
    percent: float  # h in percent of the mean force of the taut samples

    def __str__(self) -> str:
        """Return a sentence without a full stop."""
        return (
            f"hysteresis: with falling {self.quantity} it pulls {self.difference:+.2g} ± {self.std:.1g} N "
            f"({self.percent:+.2g} % of the mean force) against rising {self.quantity}; a law without memory lies "
            "between"
        )


def hysteresis(samples: Samples) -> tuple[Branches, ...]:
    """Return the differences between branches that the taut samples, in their order, show beyond doubt."""
    taut = ~samples.slack
    terms = polynomial(samples, int(taut.sum()))
    if terms is None:
        return ()
    signs = _signs(samples)
    both = {q: s for q, s in signs.items() if min((s[taut] > 0).sum(), (s[taut] < 0).sum()) >= _LEAST_ROWS}
    if not both:
        return ()
    A = np.column_stack([*(-s[taut] / 2 for s in both.values()), terms[taut]])
    found, _, rank, _ = np.linalg.lstsq(A, samples.force[taut], rcond=1e-10)
    freedom = int(taut.sum()) - rank
    if freedom < _LEAST_ROWS:
        return ()
    residual = samples.force[taut] - A @ found
    variance = np.diag(np.linalg.pinv(A.T @ A)) * (residual @ residual) / freedom
    mean = float(samples.force[taut].mean())
    every = [
        Branches(q, float(h), float(std), 100 * float(h) / mean)
        for q, h, std in zip(both, found, np.sqrt(np.maximum(variance, 0.0)), strict=False)
    ]
    least = _LEAST * samples.full_scale
    return tuple(b for b in every if abs(b.difference) > max(_SURE * b.std, least))


def _signs(samples: Samples) -> dict[str, Array]:
    """Return +1, -1 or 0 (n,) of both quantities."""
    moves = {"pressure": _steps(samples.pressure), "contraction": _steps(samples.contraction)}
    further = np.abs(moves["pressure"]) >= np.abs(moves["contraction"])
    signs = {}
    for quantity, step in moves.items():
        moving = (further == (quantity == "pressure")) & (np.abs(step) > _STILL)
        signs[quantity] = np.where(moving, np.sign(step), 0.0)
    if samples.direction is None:
        return {q: np.where(_in_a_branch(s) & (np.abs(moves[q]) < _JUMP), s, 0.0) for q, s in signs.items()}
    moved = max(signs, key=lambda q: int((signs[q] != 0).sum()))
    return {moved: np.array(samples.direction)}


def _in_a_branch(sign: Array) -> Mask:
    """Return which rows (n,) lie in a run of rows of one sign that is long enough for a branch."""
    run = np.cumsum(np.diff(sign, prepend=sign[:1]) != 0)
    return np.asarray(np.bincount(run)[run] >= _LEAST_RUN)


def _steps(q: Array) -> Array:
    """Return by how much of its range q (n,) changes about each row."""
    width = max(1, q.size // _WINDOWS)
    after, before = np.minimum(np.arange(q.size) + width - 1, q.size - 1), np.maximum(np.arange(q.size) - width, 0)
    step = (q[after] - q[before]) / max(float(np.ptp(q)), 1e-300)
    if q.size > 1:
        step[0] = step[1]
    return np.asarray(step)
