"""The rows, the box and the memory of the kernel are what its functions hand each other."""

from typing import Any, NamedTuple

import numpy as np


class Levels(NamedTuple):
    """The `Levels` are the rows of [L]: p of them for m variables, in K levels."""

    A: Any  # (p, m)
    b: Any  # (p)
    onesided: Any  # (p) whether A x <= b is asked for, not A x = b
    ends: Any  # (K) where each level ends


class Box(NamedTuple):
    """The `Box` holds the bounds and what the last level draws to."""

    lo: Any  # (m)
    hi: Any  # (m)
    centre: Any  # (m)


class Work(NamedTuple):
    """The `Work` is memory; `workspace` says how much of it."""

    Q: Any  # orthonormal rows
    B: Any  # what is left of the rows of the free variables
    L: Any  # the rows are L Q
    U: Any  # and L = U R
    R: Any  # its diagonal inverted
    H: Any  # matrix of the guess's QP
    C: Any  # its factor, the diagonal inverted
    g: Any  # and its linear term
    weights: Any  # of the rows in it
    z: Any
    step: Any  # from the centre along Q
    rhs: Any  # right-hand sides, and then what is left of them: b - A x
    first: Any  # where the basis of each level begins
    free: Any  # the free variables
    right: Any  # where each variable and row belongs
    largest: Any  # the greatest multiplier of each level
    used: Any  # whether a row is in Q
    tries: Any  # the fewest violations so far, and the patience that is left
    sizes: Any  # of each level: the greatest row sum, the greatest squared row, the size of a gradient
    scales: Any  # of each level and the centre: what is large for a residual, and for a gradient


def workspace(p: int, m: int, K: int) -> Work:
    """Return the memory for p rows, m variables and K levels."""
    return Work(
        np.empty((m, m)),
        np.empty((p, m)),
        np.empty((p, m)),
        np.empty((p, m)),
        np.empty((m, m)),
        np.empty((m, m)),
        np.empty((m, m)),
        np.empty(m),
        np.empty(p),
        np.empty(m),
        np.empty(m),
        np.empty(p),
        np.empty(K + 1, np.int64),
        np.empty(m, np.int64),
        np.empty(m + p, np.int8),
        np.empty(K + 1),
        np.empty(p, np.bool_),
        np.empty(2, np.int64),
        np.empty((3, K)),
        np.empty((2, K + 1)),
    )
