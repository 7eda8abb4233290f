"""Calls of the allocation of many targets, and of its proof, from an arm's compiled step."""

from functools import cache
from typing import Any

import numpy as np
from numba import typeof, types

from allocator.allocation.box import pivoting
from allocator.allocation.box.kernel.data import workspace
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


@cache
def addresses() -> tuple[int, int] | None:
    """Return the addresses for `allocate_at` and `prove_at`, or None if the allocation cannot be compiled."""
    loops: dict[str, Any] = {name: pivoting.loop(name) for name in _KINDS}
    if not all(hasattr(loop, "overloads") for loop in loops.values()):  # plain Python
        return None
    one, other = (address_of(loops[name], kinds, types.none) for name, kinds in _KINDS.items())
    return one, other
