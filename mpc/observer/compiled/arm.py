"""Template of the motion of an arm over a sample, for `mpc.observer.compiled.sample`.

`mpc.observer.compiled.module` replaces the lines below that begin with `FORMULAS` by names of the arm's
`mpc.model.arm.compiled.motion`, with slopes by the external torques.
"""

from typing import Any

import numpy as np

from mpc.codegen.addresses import floats
from mpc.codegen.jit import inlined
from mpc.observer.compiled.layout import Sample

FORMULAS: Any = None
move = n = m = MOVING = COLUMNS = FORMULAS


@inlined
def advance(o: Sample) -> None:
    """Store in S the Jacobian by ξ of a sample from the nearest state, and next to it the state at its end."""
    w, later, S = o.work, np.empty(2 * n + m), np.empty((MOVING, COLUMNS))
    decay = floats(o.decay).reshape(-1, 3, m)
    move(floats(o.c), o.known.h, decay, w.near, w.acting, w.torque, later, S)
    for i in range(MOVING):
        for j in range(2 * n + m):
            w.S[i, j] = S[i, j]
        for j in range(n):
            w.S[i, 2 * n + m + j] = S[i, 2 * n + 2 * m + j]  # the columns between are those of the commands
        w.S[i, 3 * n + m] = later[i]
    for i in range(MOVING, 2 * n + m):
        for j in range(3 * n + m):
            w.S[i, j] = decay[-1, 2, i - 2 * n] if i == j else 0.0
        w.S[i, 3 * n + m] = later[i]
