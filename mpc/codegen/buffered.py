"""Calls of CasADi functions through buffers, which take microseconds instead of a tenth of a millisecond."""

from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.lazy import Function


class Buffered:
    """A CasADi function with dense inputs and outputs that is called with arrays.

    CasADi stores columns first. An output of c columns and r rows is therefore returned as its transpose (c, r): one
    row per column, so that time, which runs along CasADi's columns, runs along the first axis; inputs likewise.
    The buffers belong to the object, so one object must not be called by two threads at a time.
    """

    def __init__(self, function: "Function") -> None:
        sparse = [i for i in range(function.n_in()) if not function.sparsity_in(i).is_dense()]
        sparse += [i for i in range(function.n_out()) if not function.sparsity_out(i).is_dense()]
        if sparse:
            raise ValueError(f"{function.name()} has sparse inputs or outputs: densify them")
        self._inputs: list[Any] = [np.zeros(function.size_in(i)[::-1]) for i in range(function.n_in())]
        self._outputs: list[Any] = [np.zeros(function.size_out(i)[::-1]) for i in range(function.n_out())]
        buffered: Any = function.buffer()
        self._function, (self._buffer, self._evaluate) = function, buffered
        for i, array in enumerate(self._inputs):
            self._buffer.set_arg(i, memoryview(array))
        for i, array in enumerate(self._outputs):
            self._buffer.set_res(i, memoryview(array))

    def __call__(self, *values: Array | float) -> list[Array]:
        """Evaluate; the results are copies."""
        for array, value in zip(self._inputs, values, strict=True):
            array[...] = value
        self._evaluate()
        return [array.copy() for array in self._outputs]

    def stats(self) -> dict[str, object]:
        """Return CasADi's statistics of the last call, such as a solver's return status."""
        said: dict[str, object] = self._buffer.stats()
        return said

    def __reduce__(self) -> tuple[type["Buffered"], tuple["Function"]]:
        """Pickle the CasADi function alone, because buffers are memory addresses."""
        return Buffered, (self._function,)

    def __deepcopy__(self, memo: dict[int, object]) -> "Buffered":
        """Return itself, because it keeps no state between calls."""
        return self
