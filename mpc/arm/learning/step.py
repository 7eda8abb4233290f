"""Template of a function that advances many arms by one sample.

`mpc.arm.learning.plant` replaces the lines below that begin with `FORMULAS` by the formula of an arm:
`rate(x, u, v, d, c, out)` fills in the derivative x' of the state x = (q, ω, P) (2n + m,) under the commands u (m,)
[Pa] and the external torques d (n,) [N·m], for an arm with the varied numbers v. The array c holds the formula's
numbers.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from mpc.codegen.jit import compiled, inlined  # noqa: F401  # `inlined` is for the formula
from mpc.model.experiment import NODES, SHARES

FORMULAS: Any = None
rate = FORMULAS


@compiled
def advance(c: Array, x: Array, u: Array, v: Array, d: Array, h: float, substeps: int) -> None:
    """Advance the states `x` (N, 2n + m) by `substeps` steps of `h` [s] under `u` (N, m), `d` (N, n), varied by `v`."""
    size = x.shape[1]
    stage, slope, total = np.empty(size), np.zeros(size), np.empty(size)
    for i in range(x.shape[0]):
        for _ in range(substeps):
            for k in range(size):
                slope[k] = total[k] = 0.0
            for node in range(4):
                for k in range(size):
                    stage[k] = x[i, k] + h * NODES[node] * slope[k]
                rate(stage, u[i], v[i], d[i], c, slope)
                for k in range(size):
                    total[k] += h * SHARES[node] * slope[k]
            for k in range(size):
                x[i, k] += total[k]
