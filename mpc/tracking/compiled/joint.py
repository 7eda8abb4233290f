"""Template of the parts of a joint's step that depend on its formulas: feed-forward, loads, motion, outputs.

`mpc.tracking.compiled.module` replaces the lines below that begin with `FORMULAS` by the formulas of the joint, as
functions of scalars that return tuples: `rate` (x, u, d) ↦ x', `variational` (x, S, u, d) ↦ (x', S') with the `layout`
of `mpc.tracking.compiled.module`, `outputs` x ↦ y = (K, F1, F2), `output_slopes` x ↦ (y, its Jacobian by columns),
`expansion` x ↦ the pressures' fall as the muscles swell, `pressing` x ↦ the loads on the sliding surfaces
(pull, isobaric stiffness) and ∂T/∂P. `allocated` (θ, K, T) ↦ (P1, P2, T, K, …, sure) is the kernel of
`allocator.allocation` for the joint, if there is one. The array c holds the numbers of the formulas, p those of the
kernel.

The motion is that of `mpc.model.experiment`, and its derivatives are those of the formula. Each formula occurs once
and is evaluated four times: writing it out would make the graph and the compilation four times as long.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from mpc.codegen.jit import inlined_flat
from mpc.model.experiment import NODES, SHARES
from mpc.tracking.compiled.records import Path, Reference
from mpc.tracking.compiled.sample.layout import Inputs, Known, joint_inverse_in

FORMULAS: Any = None
rate = variational = begun = advanced = ended = outputs = output_slopes = expansion = pressing = allocated = FORMULAS


@inlined_flat
def press(c: Array, x: Array, loads: Array) -> None:
    """Fill in the loads (1, 3) on the sliding surfaces: see `mpc.model.friction.contact.Loads`."""
    found = pressing(x[0], x[1], x[2], x[3], c)
    loads[0, 0], loads[0, 1], loads[0, 2] = found[0], x[2] + x[3], found[1]


@inlined_flat
def isobaric(c: Array, x: Array, stiffness: Array, gains: Array) -> None:
    """Fill in the isobaric stiffness (1,) and ∂T/∂P (2,)."""
    found = pressing(x[0], x[1], x[2], x[3], c)
    stiffness[0], gains[0], gains[1] = found[1], found[2], found[3]


@inlined_flat
def feed_forward(i: Inputs, asked: Array, K: Array, d: Array, found: Reference, moved: Array) -> bool:
    """Fill in the feed-forward of `mpc.tracking.feedforward.InverseDynamics`, and the distances `moved` (3,).

    Return whether the kernel is sure.
    """
    c, p, known, M = i.c, i.p, joint_inverse_in(i.inverse), asked.size
    slopes = i.slopes.reshape(2, M, M)  # derivatives of a preview, transposed
    inertia, damping, gravity, left, right = known.inertia, known.damping, known.gravity, known.left, known.right
    q1, q2, sure, x, y, u = 0.0, 0.0, True, found.x, found.y, found.u
    for k in range(M):
        x[k, 0], x[k, 1], x[k, 2] = min(max(asked[k], left), right), 0.0, 0.0
    for j in range(M):
        for k in range(M):
            x[k, 1] += slopes[0, j, k] * x[j, 0]
            x[k, 2] += slopes[1, j, k] * x[j, 0]  # the acceleration, in the place of the pressures
    moved[0] = moved[1] = moved[2] = 0.0
    for k in range(M):
        theta, omega = x[k, 0], x[k, 1]
        T = inertia * x[k, 2] + damping * omega + gravity * np.sin(theta - known.hanging) - d[k]
        pair = allocated(theta, K[k], T, p, left, right, known.min_force, c)
        x[k, 2], x[k, 3] = pair[0], pair[1]
        y[k, 0], y[k, 1], y[k, 2], sure = pair[3], 0.0, 0.0, sure and pair[6]
        moved[0] = max(moved[0], abs(asked[k] - theta))
        moved[1] = max(moved[1], abs(K[k] - y[k, 0]))
        moved[2] = max(moved[2], abs(T - pair[2]))
        last1, last2 = q1, q2
        q1, q2 = expansion(theta, omega, pair[0], pair[1], c)
        if k > 0:
            fall1, fall2 = (q1 + last1) / 2, (q2 + last2) / 2
            rises1 = x[k, 2] - x[k - 1, 2] + known.dt * fall1 > 0
            rises2 = x[k, 3] - x[k - 1, 3] + known.dt * fall2 > 0
            lag1, alpha1 = (known.up1, known.kept_up1) if rises1 else (known.down1, known.kept_down1)
            lag2, alpha2 = (known.up2, known.kept_up2) if rises2 else (known.down2, known.kept_down2)
            u[k - 1, 0] = (x[k, 2] - alpha1 * x[k - 1, 2]) / (1 - alpha1) + lag1 * fall1
            u[k - 1, 1] = (x[k, 3] - alpha2 * x[k - 1, 3]) / (1 - alpha2) + lag2 * fall2
    return sure


@inlined_flat
def motion(i: Inputs, known: Known, start: Array, u: Array, d: Array, x: Array) -> None:
    """Fill in the states `x` (N+1, 4) from `start` (4,) under the commands `u` (N, 2) [bar]."""
    c, h, substeps = i.c, known.h, known.substeps
    x0, x1, x2, x3 = start[0], start[1], start[2], start[3]
    x[0, 0], x[0, 1], x[0, 2], x[0, 3] = x0, x1, x2, x3
    for k in range(u.shape[0]):
        for _ in range(substeps):
            k0, k1, k2, k3 = 0.0, 0.0, 0.0, 0.0
            s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
            for stage in range(4):
                a, b = h * NODES[stage], h * SHARES[stage]
                k0, k1, k2, k3 = rate(x0 + a * k0, x1 + a * k1, x2 + a * k2, x3 + a * k3, u[k, 0], u[k, 1], d[k], c)
                s0, s1, s2, s3 = s0 + b * k0, s1 + b * k1, s2 + b * k2, s3 + b * k3
            x0, x1, x2, x3 = x0 + s0, x1 + s1, x2 + s2, x3 + s3
        x[k + 1, 0], x[k + 1, 1], x[k + 1, 2], x[k + 1, 3] = x0, x1, x2, x3


@inlined_flat
def linear_model(i: Inputs, known: Known, start: Array, u: Array, d: Array, path: Path) -> None:
    """Fill in the motion, its Jacobians A, B, sample by sample: see `mpc.tracking.compiled.module`; and the outputs."""
    x, c, h, substeps = path.x, i.c, known.h, known.substeps
    for row in range(4):
        x[0, row] = start[row]
    for k in range(u.shape[0]):
        y = begun(x[k])
        for _ in range(substeps):
            slope, total = y, y  # times 0, to begin with
            for stage in range(4):
                slope = variational(*advanced(y, h * NODES[stage], slope), u[k, 0], u[k, 1], d[k], c)
                total = advanced(total, h * SHARES[stage], slope)
            y = total
        ended(y, x[k + 1], path.A[k], path.B[k])
    read_outputs(c, path)


@inlined_flat
def read_outputs(c: Array, path: Path) -> None:
    """Fill in outputs and their gradients along the motion."""
    for k in range(path.x.shape[0]):
        x = path.x[k]
        o = output_slopes(x[0], x[1], x[2], x[3], c)
        for i in range(3):
            path.y[k, i] = o[i]
            for j in range(4):
                path.slope[k, i, j] = o[3 + 3 * j + i]


@inlined_flat
def read(c: Array, x: Array, y: Array) -> None:
    """Fill in the outputs `y` (3,) of a state."""
    y[0], y[1], y[2] = outputs(x[0], x[1], x[2], x[3], c)
