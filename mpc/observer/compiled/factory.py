"""Compiled estimate of an observer and its factory. It keeps the memory of an observer in a record during ordinary
samples.

Either the record is up to date or the readable parts are. The readable parts estimate samples that are not ordinary;
then the record is copied from them.
"""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from allocator.calculus import Array, Value
from allocator.compilation import beside
from allocator.presentation.progress import waiting
from mpc.model.machine import Machine
from mpc.observer.compiled.layout import Made, State, Tail
from mpc.observer.diagnosis import Diagnosis
from mpc.observer.filter import Filter


class Readable(NamedTuple):
    """Access to the memory of the readable observer."""

    remembered: Callable[
        [], dict[str, object] | None
    ]  # return the fields of `State` and `Tail`, None if some have no place
    go_on: Callable[[State, Tail], None]  # continue from copies of their values
    conclude: Callable[[], None]  # update the findings


_CHANGED = 2  # result of the compiled function if the health has to be updated
_KINDS = "(int64, float64[:], float64[:])"


class CompiledEstimate:
    """Compiled estimate of one observer; two threads must not use its record at the same time."""

    def __init__(self, plant: Machine, module: ModuleType, new: Callable[[], Made], readable: Readable) -> None:
        from mpc.codegen.addresses import entry_of  # which imports numba

        self.module, self._new, self._readable, self._made = module, new, readable, new()
        self._plant, self._size, self._shapes = plant, plant.size, ((plant.size,), (plant.m,))
        self._single = plant.angle_shape == ()
        self._state, self.address = self._made.records[0].now, self._made.records.ctypes.data
        self._xi = self._made.records[0].work.ahead.xi
        self._estimate = entry_of(module.estimate, _KINDS)
        self.ahead = False  # whether the record is up to date

    def answer(self, y: Array, u: Array) -> tuple[Array, Value] | None:
        """Return the result of `KalmanObserver.estimate`; None, without any change, if the sample is not ordinary."""
        if (y.shape, u.shape) != self._shapes or not (self.ahead or self._take()):
            return None
        answer = self._estimate(self.address, y, u)
        if not answer:
            return None
        size, xi = self._size, self._xi
        self.ahead, found = True, (xi[:size].copy(), float(xi[size]) if self._single else xi[size:].copy())
        if answer == _CHANGED:
            self.give()
            self._readable.conclude()
        return found

    def of(self, readable: Readable) -> "CompiledEstimate":
        """Return the compiled estimate of a copy."""
        return CompiledEstimate(self._plant, self.module, self._new, readable)

    def copied(self) -> "CompiledEstimate | None":
        """Return a copy with its own state; None if the record cannot hold the memory."""
        if not (self.ahead or self._take()):
            return None
        other = self.of(self._readable)
        other._made.take(self._made)
        return other

    def _take(self) -> bool:
        """Copy the memory of the readable parts; return whether all of it has a place."""
        remembered = self._readable.remembered()
        if remembered is None:
            return False
        kept, tail = self._made.tail, Tail(*(remembered.pop(name) for name in Tail._fields))  # type: ignore[arg-type]
        pairs = (*zip(kept.memories, tail.memories, strict=True), *zip(kept.parts, tail.parts, strict=True))
        for array, values in (*pairs, (kept.commands, tail.commands), (kept.held, tail.held)):
            array[...] = values
        for name, value in remembered.items():
            self._state[name] = value
        return True

    def give(self) -> None:
        """Give the newest state to the readable parts."""
        if self.ahead:
            self.ahead = False
            self._readable.go_on(self._state, self._made.tail)


def compiled_estimate(
    own: Filter, diagnosis: Diagnosis, readable: Readable, wait: bool, again: tuple[Any, ...]
) -> CompiledEstimate | None:
    """Return the compiled estimate for the `readable` observer; None if compilation fails.

    If `wait` is false and nothing is compiled yet, return None and compile in another process, by a call of again[0]
    with the other elements. There is no warning: the readable observer is fast enough for any loop, and the
    controller's step, which warns, fails to compile for the same reasons.
    """
    try:
        from mpc.observer.compiled.module import compiled_filter, made_of

        compiled = compiled_filter(own)
        with waiting("compiling the observer") if wait else beside.only_kept():
            return CompiledEstimate(own.plant, compiled.module, lambda: made_of(compiled, own, diagnosis), readable)
    except beside.NotKept:
        module = compiled.module
        if beside.begin(module.__name__, Path(str(module.__file__)).parent, *again):
            return None
        return compiled_estimate(own, diagnosis, readable, True, again)
    except Exception:  # no compiler, cache not writable, formula too long or not symbolic, or a fault of the compiler
        return None
