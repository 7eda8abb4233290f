"""Discrete algebraic Riccati equation for semidefinite costs, and a factor of its solution.

The least cost of bringing ξ to zero, ½ ξᵀ S ξ = min ½ Σ (ξᵀ Q ξ + 2 ξᵀ N u + uᵀ R u) over ξ⁺ = A ξ + B u, solves

    S = Aᵀ S A + Q - (Aᵀ S B + N) (R + Bᵀ S B)⁻¹ (Bᵀ S A + Nᵀ)                                                [R]

If a change of pressures costs nothing (a joint whose stiffness does not depend on its pressures, an arm with more
muscles than targets), S is singular. Its least eigenvalue is then a rounding error of either sign, so that a Cholesky
factorisation may fail, depending on the processor.

[R] is solved by structured doubling (Chu, Fan, Lin, Wang, Int. J. Control 77, 2004): step k gives the cost of 2ᵏ
samples, as a sum of semidefinite terms without cancellation. The ordered Schur form of
`scipy.linalg.solve_discrete_are` is less accurate by four digits and fails for some weights.
"""

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput

_DOUBLINGS = 60  # at most; a horizon of 2⁶⁰ samples
_ENDLESS = 1e60  # of the largest entry of Q: a larger S means a motion that no input can bring to zero
_SETTLED = 1e-16  # of sqrt(S_ii S_jj): a smaller change of S_ij counts as none
_GROWING = 1e-6  # of the largest entry of S: a greater change by the last doubling is not rounding
_NONE = "the Riccati equation has no solution: a motion that costs something never ends"


def solve_riccati(A: Array, B: Array, Q: Array, R: Array, N: Array) -> Array:
    """Return the least semidefinite S (n, n) of [R] for A (n, n), B (n, m), Q (n, n), R (m, m), N (n, m).

    R has to be positive definite and [Q N; Nᵀ R] semidefinite. Raises `InvalidInput` if there is no S, because no input
    can bring a motion with a cost to zero.
    """
    undone = np.linalg.solve(R, N.T)  # u = v - R⁻¹ Nᵀ ξ removes N
    A, S, G = A - B @ undone, Q - N @ undone, B @ np.linalg.solve(R, B.T)
    n, one = len(A), np.eye(len(A))
    for _ in range(_DOUBLINGS):
        both = np.linalg.solve(one + G @ S, np.hstack([A, G]))
        more, G = A.T @ S @ both[:, :n], G + A @ both[:, n:] @ A.T
        A, S = A @ both[:, :n], S + more
        S, G = (S + S.T) / 2, (G + G.T) / 2
        if np.abs(S).max() > _ENDLESS * np.abs(Q).max():
            raise InvalidInput(_NONE)
        size = np.sqrt(np.maximum(np.diag(S), 0.0))
        if (np.abs(more) <= _SETTLED * np.outer(size, size)).all():
            break
    if not np.abs(more).max() <= _GROWING * np.abs(S).max():
        raise InvalidInput(_NONE)
    return np.asarray(S)


def semidefinite_factor(S: Array) -> Array:
    """Return the upper triangular L (n, n), with a diagonal ≥ 0 and LᵀL = S, for a semidefinite S (n, n).

    Eigenvalues that rounding made negative count as zero.
    """
    values, vectors = np.linalg.eigh((S + S.T) / 2)
    L = np.linalg.qr(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T, mode="r")
    return np.asarray(np.where(np.diag(L) < 0, -1.0, 1.0)[:, None] * L)
