"""Entry to the structured QP of an arm; `mpc.tracking.compiled.arm.module` appends it to the text of the QP.

The pressures of states count in bar, as commands do.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.codegen.jit import compiled, inlined
from mpc.tracking.compiled.arm.records import ArmPath
from mpc.tracking.compiled.arm.views import given_in, path_in, setting_in
from mpc.tracking.compiled.records import Indices, Path, Reference, Signs
from mpc.tracking.compiled.structured_qp.sizes import JOINTS, MOVING, NU, NX, NXI, NY
from mpc.tracking.compiled.structured_qp.solve import decide


@compiled
def settle_path(
    numbers: Array, starts: Indices, given: Array, buffer: Array, guess: Signs, z: Array
) -> tuple[bool, int]:
    """Return the results of `mpc.tracking.compiled.structured_qp.solve.decide`."""
    (path, u), now = path_in(buffer), given_in(given)
    setting: Any = setting_in(numbers, starts)  # the bounds of angles are arrays
    x, y, u_star = now.reference
    reference = Reference(states_in_bar(x), y, u_star)
    return decide(in_bar(path), u, setting, reference, now.last, guess, z)


@inlined
def states_in_bar(x: Array) -> Array:
    """Return states (N + 1, NX) with their pressures in bar."""
    made = x.copy()
    for k in range(x.shape[0]):
        for j in range(2 * JOINTS, NX):
            made[k, j] = x[k, j] / BAR
    return made


@inlined
def in_bar(given: ArmPath) -> Path:
    """Return the path in bar, with the slopes of outputs by all states."""
    x, S, y, slope, kept = given
    N, n = S.shape[0], JOINTS
    A, turned_over = np.empty((N, MOVING, NXI)), np.zeros((N + 1, NY, NX))
    for k in range(N):
        for i in range(MOVING):
            unit = 1.0 if i < 2 * n else BAR
            for j in range(NXI):
                A[k, i, j] = S[k, i, j] * ((1.0 if j < 2 * n else BAR) / unit)
    for k in range(N + 1):
        for row in range(NY):
            for i in range(n):
                turned_over[k, row, i] = slope[k, i, row]
            for j in range(NU):
                turned_over[k, row, 2 * n + j] = BAR * slope[k, n + j, row]
    return Path(states_in_bar(x), y, A, kept, turned_over)
