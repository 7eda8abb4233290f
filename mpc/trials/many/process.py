"""Template of functions that advance a plant under test by one sample and read its sensors.

`mpc.trials.many.plant` replaces the lines below that begin with `FORMULAS` by the sizes and the formula of a plant with
n joints and m muscles: `stepped(full, u, dh, c, out)` fills in the state after a fine step of h = dh[n] [s] under the
commands u (m,) [Pa] and the torques dh[:n] [N·m]. `full` is the state (2n + m,) with the frictions' memories, c the
formula's numbers. Operations are not contracted, so that the results of a joint are those of CasADi's interpreter, bit
by bit.
"""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from mpc.codegen.jit import exactly

Counts: TypeAlias = NDArray[np.int64]

FORMULAS: Any = None
stepped = n = m = FORMULAS


@exactly
def advance(c: Array, durations: Array, steps: Counts, full: Array, waiting: Array, angles: Array, d: Array) -> None:
    """Advance `full` by a sample, with the oldest of the commands `waiting` (w, m) [Pa] first, and shift these and the
    `angles` (a, n) [rad] that are still to be read.

    `durations` [s] are the pieces of a sample, `steps` the numbers of their steps; `d` (n,) [N·m] are external torques.
    """
    dh, later = np.empty(n + 1), np.empty(full.size)
    for i in range(n):
        dh[i] = d[i]
    for piece in range(durations.size):
        dh[n] = durations[piece] / steps[piece]
        for _ in range(steps[piece]):
            stepped(full, waiting[piece], dh, c, later)
            for i in range(full.size):
                full[i] = later[i]
    for i in range(waiting.shape[0] - 1):
        for j in range(m):
            waiting[i, j] = waiting[i + 1, j]
    last = angles.shape[0] - 1
    for j in range(n):
        for i in range(last):
            angles[i, j] = angles[i + 1, j]
        angles[last, j] = full[j]


@exactly
def read(sensors: Array, full: Array, angles: Array, noise: Array, y: Array) -> None:
    """Fill in the sensor readings (2n + m,) of the state `full` with `noise` (n + m,): of the angles [rad], of the
    pressures in standard deviations.

    `angles` (a, n) [rad] are those of the last samples. `sensors` has the encoders' step [rad], the standard deviation
    [Pa], 0 if the velocities are measured, else NaN, the age of the angles' readings in samples, and the offsets (m,)
    of the pressure sensors [Pa].
    """
    step, age = sensors[0], sensors[3]
    last, whole = angles.shape[0] - 1, int(age)
    for i in range(n):
        now, before = angles[last - whole, i], angles[last - whole - 1, i]
        theta = now + (age - whole) * (before - now) if age > 0 else full[i]
        y[i] = (step * np.round(theta / step) if step > 0 else theta) + noise[i]
        y[n + i] = full[n + i] + sensors[2]
    for j in range(m):
        y[2 * n + j] = full[2 * n + j] + sensors[4 + j] + sensors[1] * noise[n + j]
