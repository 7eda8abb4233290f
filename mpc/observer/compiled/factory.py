"""The factory makes the compiled estimate of an observer, where that can be had."""

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from allocator.compilation import beside
from mpc.observer.compiled.layout import State, Tail
from mpc.observer.diagnosis import Diagnosis
from mpc.observer.filter import Filter

if TYPE_CHECKING:
    from mpc.observer.compiled.whole import CompiledEstimate  # which imports numba


class Readable(NamedTuple):
    """What is readable says what it remembers, and goes on from what it is told."""

    remembered: Callable[
        [], dict[str, object] | None
    ]  # the fields of `State` and `Tail`, None where some have no place
    go_on: Callable[[State, Tail], None]  # from copies of what is in these
    conclude: Callable[[], None]  # anew what is wrong with the joint


def compiled_estimate(
    own: Filter, diagnosis: Diagnosis, readable: Readable, wait: bool, again: tuple[Any, ...]
) -> "CompiledEstimate | None":
    """Return the compiled estimate of what is `readable`, ready; None where compiling fails.

    Who does not `wait` gets None, too, where nothing is compiled yet and another process can do it, by a call of
    again[0] with the other elements. Nobody is warned: the readable observer is quick enough for any loop, and what
    keeps it from being compiled keeps the controller's step from it, which tells.
    """
    try:
        from mpc.observer.compiled.module import compiled_filter, made_of
        from mpc.observer.compiled.whole import CompiledEstimate

        compiled = compiled_filter(own)
        with nullcontext() if wait else beside.only_kept():
            return CompiledEstimate(compiled.module, lambda: made_of(compiled, own, diagnosis), readable)
    except beside.NotKept:
        module = compiled.module
        if beside.begin(module.__name__, Path(str(module.__file__)).parent, *again):
            return None
        return compiled_estimate(own, diagnosis, readable, True, again)
    except (
        Exception
    ):  # no compiler, no place for its work, a formula too long or not symbolic, or a fault of the compiler's own
        return None
