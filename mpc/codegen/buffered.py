"""CasADi functions are called through buffers here: microseconds instead of a tenth of a millisecond per call."""

from typing import TYPE_CHECKING, Any

import numpy as np

from allocator.calculus import Array

if TYPE_CHECKING:
    from casadi import Function


class Buffered:
    """A buffered function is a CasADi function with dense inputs and outputs, called with arrays.

    CasADi stores columns first. An output of c columns and r rows is therefore handed back as its transpose (c, r): one
    row per column, so that time, which runs along CasADi's columns, runs along the first axis here; inputs likewise.
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
        """Return what CasADi says of the last call, as a solver's return status."""
        said: dict[str, object] = self._buffer.stats()
        return said

    def __reduce__(self) -> tuple[type["Buffered"], tuple["Function"]]:
        """Pickle by the function, which CasADi writes out and reads: buffers are places in memory."""
        return Buffered, (self._function,)

    def __deepcopy__(self, memo: dict[int, object]) -> "Buffered":
        """Return itself: it remembers nothing from call to call."""
        return self
