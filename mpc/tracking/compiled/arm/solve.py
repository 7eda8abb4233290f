"""Entry to the structured QP of an arm; `mpc.tracking.compiled.arm.module` appends it to the text of the QP.

The pressures of states count in bar, as commands do.
"""

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.codegen.jit import compiled, inlined
from mpc.tracking.compiled.records import Bounds, Cost, Indices, Path, Reference, Setting, Signs
from mpc.tracking.compiled.structured_qp.sizes import NU, NX, NXI, NY
from mpc.tracking.compiled.structured_qp.solve import decide
from mpc.tracking.compiled.structured_qp.stage_of_many import MOVING


@compiled
def settle_path(
    cost_x: Array, cost_y: Array, cost_e: Array, change: Array, end: Array, bounds: Array, ranges: Array, rest: Array,
    slack: Array, starts: Indices, kept: Array, x: Array, S: Array, y: Array, slope: Array, u: Array,
    x_ref: Array, y_ref: Array, u_ref: Array, last: Array, guess: Signs, z: Array,
) -> tuple[bool, int]:  # fmt: skip
    """Return whether `z` (n + 1,) is the QP's proved solution, and the number of exchanges; see `settle`.

    `bounds` (4,): least and greatest command, greatest change [bar], least force [N]; `ranges` (2, n) of the angles;
    `rest` (3,) the other fields of a `Setting`; `kept` (m,) the remaining share of a pressure's error after a sample.
    """
    cost = Cost(cost_x, cost_y, cost_e, change, end)
    limits = Bounds(bounds[0], bounds[1], bounds[2], ranges[0], ranges[1], bounds[3])
    setting = Setting(cost, limits, rest[0], rest[1], rest[2], slack, starts)
    path, reference = in_bar(x, S, y, slope, kept), Reference(states_in_bar(x_ref), y_ref, u_ref)
    return decide(path, u / BAR, setting, reference, last, guess, z)


@inlined
def states_in_bar(x: Array) -> Array:
    """Return states (N + 1, NX) with their pressures in bar."""
    made = x.copy()
    for k in range(x.shape[0]):
        for j in range(MOVING, NX):
            made[k, j] = x[k, j] / BAR
    return made


@inlined
def in_bar(x: Array, S: Array, y: Array, slope: Array, kept: Array) -> Path:
    """Return the path in bar; `slope` (N + 1, n + m, p) is of the outputs by (q, P)."""
    N, n = S.shape[0], MOVING // 2
    A, turned_over = np.empty((N, MOVING, NXI)), np.zeros((N + 1, NY, NX))
    for k in range(N):
        for i in range(MOVING):
            for j in range(NXI):
                A[k, i, j] = S[k, i, j] if j < MOVING else BAR * S[k, i, j]
    for k in range(N + 1):
        for row in range(NY):
            for i in range(n):
                turned_over[k, row, i] = slope[k, i, row]
            for j in range(NU):
                turned_over[k, row, MOVING + j] = BAR * slope[k, n + j, row]
    return Path(states_in_bar(x), y, A, kept, turned_over)
