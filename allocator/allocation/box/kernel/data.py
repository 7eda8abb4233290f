"""The rows, the box and the memory of the kernel are what its functions hand each other."""

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array, Mask

Places: TypeAlias = NDArray[np.int64]


class Levels(NamedTuple):
    """The `Levels` are the rows of [L]: p of them for m variables, in K levels."""

    A: Array  # (p, m)
    b: Array  # (p)
    onesided: Mask  # (p) whether A x <= b is asked for, not A x = b
    ends: Places  # (K) where each level ends


class Box(NamedTuple):
    """The `Box` holds the bounds and what the last level draws to."""

    lo: Array  # (m)
    hi: Array  # (m)
    centre: Array  # (m)


class Work(NamedTuple):
    """The `Work` is memory; `workspace` says how much of it."""

    Q: Array  # orthonormal rows
    B: Array  # what is left of the rows of the free variables
    L: Array  # the rows are L Q
    U: Array  # and L = U R
    R: Array  # its diagonal inverted
    H: Array  # matrix of the guess's QP
    C: Array  # its factor, the diagonal inverted
    g: Array  # and its linear term
    weights: Array  # of the rows in it
    z: Array
    step: Array  # from the centre along Q
    rhs: Array  # right-hand sides, and then what is left of them: b - A x
    first: Places  # where the basis of each level begins
    free: Places  # the free variables
    right: NDArray[np.int8]  # where each variable and row belongs
    largest: Array  # the greatest multiplier of each level
    used: Mask  # whether a row is in Q
    tries: Places  # the fewest violations so far, and the patience that is left
    sizes: Array  # of each level: the greatest row sum, the greatest squared row, the size of a gradient
    scales: Array  # of each level and the centre: what is large for a residual, and for a gradient


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
