"""Template of the motion of a joint over a sample, for `mpc.observer.compiled.sample`.

`mpc.observer.compiled.module` replaces the lines below that begin with `FORMULAS` by the formulas of a plant:
`rate_slopes` (x, v, d) ↦ x' and its Jacobian by (x, d), columns first, a function of scalars that returns a tuple.
"""

from typing import Any

from mpc.codegen.addresses import floats
from mpc.codegen.jit import inlined
from mpc.model.experiment import NODES, SHARES
from mpc.observer.compiled.layout import Sample

FORMULAS: Any = None
rate_slopes = FORMULAS


@inlined
def advance(o: Sample) -> None:
    """Store in S (5, 6) the Jacobian by ξ of a sample from the nearest state, and next to it the state at its end.

    The slope K (4, 6) of each Runge–Kutta stage is taken at S + a K, and b K is added to the total.
    """
    w, c, h, d = o.work, floats(o.c), o.known.h, o.work.torque[0]
    S, K, at, total = w.S, w.slope, w.at, w.total
    for i in range(4):
        for j in range(5):
            S[i, j] = 1.0 if i == j else 0.0
        S[i, 5] = w.near[i]
    for n in range(4 * o.known.substeps):
        a, b = h * NODES[n % 4], h * SHARES[n % 4]
        for i in range(4):
            for j in range(6):
                if n % 4 == 0:
                    K[i, j] = total[i, j] = 0.0
                at[i, j] = S[i, j] + a * K[i, j]
        f = rate_slopes(at[0, 5], at[1, 5], at[2, 5], at[3, 5], w.acting[0], w.acting[1], d, c)
        for j in range(5):
            s0, s1, s2, s3 = at[0, j], at[1, j], at[2, j], at[3, j]
            K[0, j] = f[4] * s0 + f[8] * s1 + f[12] * s2 + f[16] * s3
            K[1, j] = f[5] * s0 + f[9] * s1 + f[13] * s2 + f[17] * s3
            K[2, j] = f[6] * s0 + f[10] * s1 + f[14] * s2 + f[18] * s3
            K[3, j] = f[7] * s0 + f[11] * s1 + f[15] * s2 + f[19] * s3
        for i in range(4):
            K[i, 4] += f[20 + i]
            K[i, 5] = f[i]
            for j in range(6):
                total[i, j] += b * K[i, j]
                if n % 4 == 3:
                    S[i, j] += total[i, j]
