"""Compiled estimate, which keeps the memory of an observer in a record during ordinary samples.

Either the record is up to date or the readable parts are. The readable parts estimate samples that are not ordinary;
then the record is copied from them.
"""

from collections.abc import Callable
from types import ModuleType

from allocator.calculus import Array
from mpc.codegen.addresses import entry_of
from mpc.model.plant import NU, NX
from mpc.observer.compiled.factory import Readable
from mpc.observer.compiled.layout import Made

_CHANGED = 2  # result of the compiled function if the health has to be updated
_KINDS = "(int64, float64, float64, float64, float64, float64)"


class CompiledEstimate:
    """Compiled estimate of one observer; two threads must not use its record at the same time."""

    def __init__(self, module: ModuleType, new: Callable[[], Made], readable: Readable) -> None:
        self.module, self._new, self._readable, self._made = module, new, readable, new()
        self._state, self.address = self._made.records[0].now, self._made.records.ctypes.data
        self._xi = self._made.records[0].work.ahead.xi
        self._estimate = entry_of(module.estimate, _KINDS)
        self.ahead = False  # whether the record is up to date

    def answer(self, y: Array, u: Array) -> tuple[Array, float] | None:
        """Return the result of `KalmanObserver.estimate`; None, without any change, if the sample is not ordinary."""
        if y.shape != (NX,) or u.shape != (NU,) or not (self.ahead or self._take()):
            return None
        theta, _, P1, P2 = y.tolist()
        answer = self._estimate(self.address, theta, P1, P2, *u.tolist())
        if not answer:
            return None
        self.ahead, found = True, (self._xi[:NX].copy(), float(self._xi[NX]))
        if answer == _CHANGED:
            self.give()
            self._readable.conclude()
        return found

    def of(self, readable: Readable) -> "CompiledEstimate":
        """Return the compiled estimate of a copy."""
        return CompiledEstimate(self.module, self._new, readable)

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
        for name, array in self._made.tail._asdict().items():
            array[...] = remembered.pop(name)
        for name, value in remembered.items():
            self._state[name] = value
        return True

    def give(self) -> None:
        """Give the newest state to the readable parts."""
        if self.ahead:
            self.ahead = False
            self._readable.go_on(self._state, self._made.tail)
