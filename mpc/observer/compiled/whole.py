"""The compiled estimate has what an observer remembers in a flat array, as long as nothing is out of the ordinary.

Either the flat array is up to date or the readable parts are. What is not ordinary these answer; the flat array is then
taken from them anew.
"""

import numpy as np

from allocator.calculus import Array
from mpc.model.plant import NU, NX
from mpc.observer.compiled.factory import Readable
from mpc.observer.compiled.layout import ASKED, Known, State, known_of, state_of
from mpc.observer.compiled.module import CompiledFilter

_CHANGED = 2  # what the compiled function answers where the health has to be looked at


class CompiledEstimate:
    """A compiled estimate works for one observer: its arrays must not be used by two threads at a time."""

    def __init__(self, made: CompiledFilter, known: Known, readable: Readable) -> None:
        self._made, self._fields = made, known
        self._known, self._flat = known_of(known), np.full(2 * int(known.places[-1]), np.nan)
        self.state = state_of(self._flat, known.places)
        self.module, self._estimate, self._readable = made.module, made.module.estimate, readable
        self._asked = np.full(ASKED, np.nan)
        self._y, self._u, self._x = self._asked[:NX], self._asked[NX:], self.state.belief[:NX]
        self.ahead = False  # whether the flat array is up to date
        self._estimate(self._known, self._flat, self._asked)  # compiles it: none of these numbers is one that can be

    def answer(self, y: Array, u: Array) -> tuple[Array, float] | None:
        """Return what `KalmanObserver.estimate` answers in an ordinary sample; None, and nothing has changed, in
        another one.
        """
        if y.shape != (NX,) or u.shape != (NU,) or not (self.ahead or self._take()):
            return None
        self._y[...], self._u[...] = y, u
        answer = self._estimate(self._known, self._flat, self._asked)
        if not answer:
            return None
        self.ahead, found = True, (self._x.copy(), float(self._flat[NX]))
        if answer == _CHANGED:
            self.give()
            self._readable.conclude()
        return found

    def of(self, readable: Readable) -> "CompiledEstimate":
        """Return the compiled estimate of a copy."""
        return CompiledEstimate(self._made, self._fields, readable)

    def taken(self) -> tuple[Array, Array] | None:
        """Return what is known and a copy of the state, both flat; None if what is remembered has no place there."""
        return (self._known, self._flat.copy()) if self.ahead or self._take() else None

    def _take(self) -> bool:
        """Take what the readable parts remember; return whether all of it has a place."""
        remembered = self._readable.remembered()
        if remembered is None:
            return False
        for name, array in zip(State._fields, self.state, strict=True):
            array[...] = remembered[name]
        return True

    def give(self) -> None:
        """Give to the readable parts what they do not know yet."""
        if self.ahead:
            self.ahead = False
            self._readable.go_on(self.state)
