"""Calls of the allocation of many targets, and of its proof, from an arm's compiled step."""

from functools import cache
from typing import Any

import numpy as np
from numba import typeof, types

from allocator.allocation.box import pivoting
from allocator.allocation.box.kernel.data import workspace
from allocator.calculus import Array
from allocator.joint.limits import BINDS
from mpc.codegen.arguments import described, described_at
from mpc.tracking.compiled.arm.records import ArmTargets
from mpc.tracking.compiled.sample.arrays import Allocating
from mpc.tracking.compiled.sample.calls import address_of, caller

LEVELS = 2  # torques before stiffness

_ROWS, _SIGNS, _PLACES = np.zeros((1, 1)), np.zeros((1, 1), np.int8), np.zeros(1, np.int64)
_TARGETS = _ROWS[None], _ROWS, np.zeros(1, np.bool_), _PLACES, _ROWS, _ROWS, _ROWS, _PLACES
_MU, _WORK = _ROWS[None], workspace(1, 1, LEVELS)
_KINDS: dict[str, tuple[Any, ...]] = {
    name: tuple(map(typeof, (*_TARGETS, *others)))
    for name, others in {
        "allocate_batch": (True, _ROWS, _SIGNS, _MU, _PLACES, _WORK),
        "residual_batch": (_ROWS, _MU, 0.0, 0.0, np.zeros(1), np.zeros(1, np.bool_), _WORK),
    }.items()
}  # of the arguments in `allocator.allocation.box.kernel.batch`

allocate_at, prove_at = (caller(kinds, types.none) for kinds in _KINDS.values())
allocation_at, proof_at = map(described_at, _KINDS.values())


@cache
def addresses() -> tuple[int, int] | None:
    """Return the addresses for `allocate_at` and `prove_at`, or None if the allocation cannot be compiled."""
    loops: dict[str, Any] = {name: pivoting.loop(name) for name in _KINDS}
    if not all(hasattr(loop, "overloads") for loop in loops.values()):  # plain Python
        return None
    one, other = (address_of(loops[name], kinds, types.none) for name, kinds in _KINDS.items())
    return one, other


def allocating(flat: Array, t: ArmTargets, of_hand: bool) -> Allocating:
    """Return the allocation of the targets `t`, which are views into `flat`, or of those for a hand."""
    functions = addresses()
    assert functions is not None  # otherwise the feed-forward is not compiled
    samples, p, m = t.A.shape
    side, rounds, work = np.zeros((samples, m + p), np.int8), np.zeros(samples, np.int64), workspace(p, m, LEVELS)
    onesided, ends, held = np.zeros(p, np.bool_), np.array([t.T.size, p]), np.empty(p + m, np.bool_)
    by_row = *((t.hand_A, t.hand_b) if of_hand else (t.A, t.b)), t.lo, t.hi, np.zeros((samples, m)), np.arange(samples)
    mu, words = np.empty((samples, LEVELS + 1, p)), []
    for rows in (1, samples):
        A, b, *box = (array[:rows] for array in by_row)
        problem, P, multipliers = (A, b, onesided, ends, *box), t.P[:rows], mu[:rows]
        words.append(described(*problem, True, P, side[:rows], multipliers, rounds[:rows], work))
        words.append(described(*problem, P, multipliers, 0.0, BINDS, t.residual[:rows], held, work))
    (one, prove_one, every, prove_every), (allocate, prove) = (word.ctypes.data for word in words), functions
    calls = allocate, one, every, prove, prove_one, prove_every
    return Allocating(flat, side.ravel(), rounds, calls, (words, by_row, mu, onesided, ends, held, work))
