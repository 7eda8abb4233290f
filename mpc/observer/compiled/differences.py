"""Compiled estimate of a joint's `mpc.observer.base.Differentiator`, with the functions of
`mpc.observer.compiled.sample` that compiled loops call. Its memory is the last estimate (θ, θ', P1, P2, d = 0), and the
sample time.
"""

import sys
from typing import Self

import numpy as np

from allocator.calculus import Array
from mpc.codegen.addresses import floats_at
from mpc.codegen.jit import inlined
from mpc.model.plant import NX
from mpc.observer.base import Differentiator

SIZE = NX + 1


class CompiledDifferences:
    """Compiled estimate of one `Differentiator`."""

    module = sys.modules[__name__]

    def __init__(self, observer: Differentiator) -> None:
        angles = np.zeros(1) if observer.angles is None else observer.angles
        self._observer, self._memory = observer, np.array([*angles, *np.zeros(NX), observer.dt])
        self.address: int = self._memory.ctypes.data  # valid during the lifetime of this object

    def copied(self) -> Self:
        """Return a copy with its own memory, that of the observer now."""
        return type(self)(self._observer)


@inlined
def sample_at(address: int) -> Array:
    """Return the memory at this address."""
    return floats_at(address, SIZE + 1)


@inlined
def newest(memory: Array) -> Array:
    """Return the present estimate (5,), a view."""
    return memory


@inlined
def filtered(memory: Array, y: Array, u: Array) -> bool:
    """Estimate from the readings `y` (4,); return whether the sample was ordinary."""
    speed = (y[0] - memory[0]) / memory[SIZE]
    for i in range(NX):
        memory[i] = y[i]
    if np.isnan(y[1]):
        memory[1] = speed
    return True
