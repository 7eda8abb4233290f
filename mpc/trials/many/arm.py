"""Template of a fine step of a `RealArm`, for `mpc.trials.many.process`.

`mpc.trials.many.plant` replaces the lines below that begin with `FORMULAS` by the formulas of the arm, functions that
fill flat arrays: `rate` (x, u, d, T_f) ↦ x' and `rubbed` (q, z, x) ↦ the frictions' memory and T_f, see
`mpc.model.real`. The array c holds their numbers.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from mpc.codegen.jit import inlined
from mpc.model.experiment import NODES, SHARES

FORMULAS: Any = None
n = SIZE = rate = rubbed = FORMULAS


@inlined
def stepped(full: Array, u: Array, dh: Array, c: Array, later: Array) -> None:
    """Fill in the state and memory `later` than `full` by h = dh[n] [s] under the torques dh[:n]."""
    now, slope, total, T_f = np.empty(SIZE), np.zeros(SIZE), np.zeros(SIZE), np.empty(n)
    memory = full[SIZE:]
    for node in range(4):
        for i in range(SIZE):
            now[i] = full[i] + dh[n] * NODES[node] * slope[i]
        rubbed(full[:n], memory, now, c, later[SIZE:], T_f)
        rate(now, u, dh[:n], T_f, c, slope)
        for i in range(SIZE):
            total[i] += dh[n] * SHARES[node] * slope[i]
    for i in range(SIZE):
        later[i] = full[i] + total[i]
    rubbed(full[:n], memory, later[:SIZE], c, later[SIZE:], T_f)
