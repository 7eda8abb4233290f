"""Template of the parts of an arm's step that depend on its formulas: loads, motion, outputs.

`mpc.tracking.compiled.arm.module` replaces the lines below that begin with `FORMULAS` by the formulas of the arm, as
functions that fill flat arrays, matrices by columns:

    outputs          (q, P) ↦ y = (svec K, F)
    output_slopes    (q, P) ↦ y, its Jacobian by q and P
    pressing         x ↦ the loads on the sliding surfaces of each joint
    rigidity         (q, P) ↦ isobaric stiffness, (∂T/∂P)ᵀ

and `move`, the motion over a sample (`mpc.model.arm.compiled.motion`). The array c holds the formulas' numbers,
`decay` (substeps, 3, m) the remaining share of a pressure's error at beginning, middle and end of each step.
Without gas the response of pressures to commands is always the same. With gas the pressures are integrated, and `decay`
only gives the number of steps.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.codegen.jit import inlined, inlined_flat
from mpc.tracking.compiled.arm.records import ArmPath
from mpc.tracking.compiled.sample.layout import Inputs, Known
from mpc.tracking.compiled.structured_qp.sizes import JOINTS, NU

FORMULAS: Any = None
move = outputs = output_slopes = pressing = rigidity = FORMULAS


@inlined_flat
def press(c: Array, x: Array, loads: Array) -> None:
    """Fill in the loads (n, 3) on the sliding surfaces: see `mpc.model.friction.contact.Loads`."""
    pressing(x, c, loads.reshape(-1))


@inlined_flat
def isobaric(c: Array, x: Array, stiffness: Array, gains: Array) -> None:
    """Fill in the isobaric stiffness (n n,) and ∂T/∂P (n m,)."""
    rigidity(x[:JOINTS], x[2 * JOINTS :], c, stiffness, gains)


@inlined
def motion(i: Inputs, known: Known, start: Array, u: Array, d: Array, x: Array) -> None:
    """Fill in the states `x` (N+1, 2n + m) from `start` (2n + m,) under the commands `u` (N, m) [bar]."""
    decay, P = i.decay.reshape(-1, 3, NU), np.empty(NU)
    for j in range(start.size):
        x[0, j] = start[j]
    for k in range(u.shape[0]):
        for j in range(NU):
            P[j] = BAR * u[k, j]
        move(i.c, known.h, decay, x[k], P, d[k * JOINTS : (k + 1) * JOINTS], x[k + 1], None)


@inlined
def linear_model(i: Inputs, known: Known, start: Array, u: Array, d: Array, path: ArmPath) -> None:
    """Fill in the motion, its Jacobians, and the outputs with theirs, sample by sample."""
    decay, P, x = i.decay.reshape(-1, 3, NU), np.empty(NU), path.x
    for j in range(start.size):
        x[0, j] = start[j]
    for k in range(u.shape[0]):
        for j in range(NU):
            P[j] = BAR * u[k, j]
        move(i.c, known.h, decay, x[k], P, d[k * JOINTS : (k + 1) * JOINTS], x[k + 1], path.S[k])
    for k in range(x.shape[0]):
        output_slopes(x[k, :JOINTS], x[k, 2 * JOINTS :], i.c, path.y[k], path.slope[k].reshape(-1))


@inlined_flat
def read(c: Array, x: Array, y: Array) -> None:
    """Fill in the outputs `y` of a state."""
    outputs(x[:JOINTS], x[2 * JOINTS :], c, y)
