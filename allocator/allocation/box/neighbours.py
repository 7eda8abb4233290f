"""Targets that share the binding limits of a known one, solved together: neighbours on a trajectory mostly do.

If all rows can be met, the free variables are those nearest to the centre,

    A_freeᵀ = Q R,   Rᵀ s = b - A c',   x = c' + Q s,   R μ = -s,

c' being the centre, with the other variables at their bounds. The answer is proved by the rules of
`allocator.allocation.box.kernel.levels.violations`: x lies in the box, and the gradient x - c + Aᵀμ holds the others at
their bounds. NumPy takes a tenth of the time of the kernel in plain Python; the compiled kernel needs no help.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.allocation.box.kernel.levels import CANCELS, OUTSIDE
from allocator.calculus import Array, Mask

_INDEPENDENT = 1e-6  # of the longest row: least remainder of another one


class Neighbours(NamedTuple):
    """Answers for N targets with m variables and p rows."""

    x: Array  # (N, m)
    mu: Array  # multipliers of the rows in the last level (N, p)
    proved: Mask  # (N,) whether they are the solutions


def solved(A: Array, b: Array, lo: Array, hi: Array, centre: Array, side: NDArray[np.int8]) -> Neighbours:
    """Return the answers for the rows `A` (N, p, m) and `b` (N, p), the box and the centre (N, m) of the targets.

    `side` (m,) of a variable is -1 at lo, 0 free, +1 at hi.
    """
    N, p, m = A.shape
    free = side == 0
    if free.sum() < p:
        return Neighbours(np.zeros((N, m)), np.zeros((N, p)), np.zeros(N, bool))
    start = np.where(free, centre, np.where(side < 0, lo, hi))
    Q, R = np.linalg.qr((A * free).swapaxes(1, 2))
    longest, pivots = np.sqrt((A**2).sum(axis=2).max(axis=1)), np.abs(np.diagonal(R, axis1=1, axis2=2)).min(axis=1)
    independent = pivots > _INDEPENDENT * longest
    R[~independent] = np.eye(p)
    s = np.linalg.solve(R.swapaxes(1, 2), (b - (A @ start[:, :, None])[:, :, 0])[:, :, None])
    x = start + (Q @ s)[:, :, 0]
    mu = np.linalg.solve(R, -s)[:, :, 0]
    gradient = x - centre + (mu[:, None] @ A)[:, 0]
    size = np.abs(x - centre) + (np.abs(A) * np.abs(mu).max(axis=1, initial=0.0)[:, None, None]).sum(axis=1)
    held = np.where(lo < hi, (gradient * side <= 0) | (np.abs(gradient) <= CANCELS * size), side < 0)
    inside = (x >= lo - OUTSIDE) & (x <= hi + OUTSIDE) & (lo < hi)
    proved = independent & np.where(free, inside, held).all(axis=1)
    return Neighbours(np.clip(x, lo, hi), mu, proved)
