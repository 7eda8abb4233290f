"""Template of functions that advance a plant under test by one sample and read its sensors.

`mpc.trials.many.plant` replaces the lines below that begin with `FORMULAS` by the formula of a plant:
`stepped(full, u, dh, c, out)` fills in the state after a fine step of h = dh[1] [s] under the commands u (2,) [Pa] and
the torque dh[0] [N·m]. `full` (n,) is the state (θ, ω, P1, P2) with the friction's memory, c the formula's numbers.
Operations are not contracted, so that the results are those of CasADi's interpreter, bit by bit.
"""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from mpc.codegen.jit import exactly

Counts: TypeAlias = NDArray[np.int64]

FORMULAS: Any = None
stepped = FORMULAS


@exactly
def advance(c: Array, durations: Array, steps: Counts, full: Array, waiting: Array, angles: Array, d: float) -> None:
    """Advance `full` (n,) by a sample, with the oldest of the commands `waiting` (w, 2) [Pa] first, and shift these and
    the `angles` (a,) [rad] that are still to be read.

    `durations` [s] are the pieces of a sample, `steps` the numbers of their steps; `d` [N·m] is the external torque.
    """
    dh, later = np.empty(2), np.empty(full.size)
    dh[0] = d
    for piece in range(durations.size):
        dh[1] = durations[piece] / steps[piece]
        for _ in range(steps[piece]):
            stepped(full, waiting[piece], dh, c, later)
            for i in range(full.size):
                full[i] = later[i]
    for i in range(waiting.shape[0] - 1):
        waiting[i, 0], waiting[i, 1] = waiting[i + 1, 0], waiting[i + 1, 1]
    for i in range(angles.size - 1):
        angles[i] = angles[i + 1]
    angles[angles.size - 1] = full[0]


@exactly
def read(sensors: Array, full: Array, angles: Array, noise: Array, y: Array) -> None:
    """Fill in the sensor readings (4,) of the state `full` with `noise` (3,): of the angle [rad], of the pressures in
    standard deviations.

    `angles` (a,) [rad] are those of the last samples. `sensors` has the encoder's step [rad], the standard deviation
    [Pa], 0 if the velocity is measured, else NaN, the offsets of the pressure sensors [Pa], and the age of the angle's
    readings in samples.
    """
    step, age = sensors[0], sensors[5]
    last, whole = angles.size - 1, int(age)
    now, before = angles[last - whole], angles[last - whole - 1]
    theta = now + (age - whole) * (before - now) if age > 0 else full[0]
    y[0] = (step * np.round(theta / step) if step > 0 else theta) + noise[0]
    y[1] = full[1] + sensors[2]
    for i in range(2):
        y[2 + i] = full[2 + i] + sensors[3 + i] + sensors[1] * noise[1 + i]
