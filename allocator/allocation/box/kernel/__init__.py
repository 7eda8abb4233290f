"""Exact solution of a mechanism's lexicographic least squares in a box, by block principal pivoting.

Over x ∈ Rᵐ within [lo, hi], in the order of the levels k = 0 … K-1 and then of the centre c,

    first minimise ‖A_0 x - b_0‖²,  among all that do ‖A_1 x - b_1‖²,  …,  among all that do ‖x - c‖²          [L]

The values achieved by an earlier level are equality constraints of the later ones, never weighted terms. A row may be
*one-sided*: it requires a x ≤ b, and counts only if that is violated. Every variable is guessed to be free, at lo or at
hi, and every one-sided row to be active or idle. `levels.point` solves [L] for that guess; `levels.violations` finds
its errors.

`box_qp.flip` makes the next guess: it flips all wrong entries at once, or after `PATIENCE` rounds without fewer
violations only the last one (Murty's rule). The iteration ends: [L] is the limit of Σ ε^k ‖A_k x + s_k - b_k‖² + ε^K
‖x - c‖² + ε^(K+1) ‖s‖² as ε → 0, where s ≥ 0 is the slack of one-sided rows. Its matrix is positive definite over the
ordered field of series in ε, over which the rule visits no guess twice.

With a small number for ε this is an ordinary strictly convex QP, whose rounds are cheaper. `box_qp` solves it for the
first guess, which is then nearly always right, and always checked.

J. J. Júdice and F. M. Pires, "A block principal pivoting algorithm for large-scale strictly monotone linear
complementarity problems", Computers & Operations Research 21(5), 1994; K. G. Murty, "Note on a Bard-type scheme for
solving the complementarity problem", Opsearch 11, 1974.

The kernel is plain Python for arrays. numba compiles it unchanged, and `mpc.export` prints it as C.
"""

from allocator.allocation.box.kernel.batch import FUNCTIONS, allocate_batch, residual_batch, weigh_batch

__all__ = ["FUNCTIONS", "allocate_batch", "residual_batch", "weigh_batch"]
