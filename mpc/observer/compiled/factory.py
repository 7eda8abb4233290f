"""The factory makes the compiled estimate of an observer, where that can be had."""

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from allocator.compilation import beside
from mpc.observer.diagnosis import Diagnosis
from mpc.observer.filter import Filter

if TYPE_CHECKING:
    from mpc.observer.compiled.whole import CompiledEstimate, Readable  # which import numba


def compiled_estimate(
    own: Filter, diagnosis: Diagnosis, readable: "Readable", wait: bool, again: tuple[Any, ...]
) -> "CompiledEstimate | None":
    """Return the compiled estimate of the `readable` observer, ready; None where compiling fails.

    Who does not `wait` gets None, too, where nothing is compiled yet and another process can do it, by a call of
    again[0] with the other elements. Nobody is warned: the readable observer is quick enough for any loop, and what
    keeps it from being compiled keeps the controller's step from it, which tells.
    """
    try:
        from mpc.observer.compiled.module import compiled_filter, known_of
        from mpc.observer.compiled.whole import CompiledEstimate

        made = compiled_filter(own)
        with nullcontext() if wait else beside.only_kept():
            return CompiledEstimate(made, known_of(made, own, diagnosis), readable)
    except beside.NotKept:
        module = made.module
        if beside.begin(module.__name__, Path(str(module.__file__)).parent, *again):
            return None
        return compiled_estimate(own, diagnosis, readable, True, again)
    except (
        Exception
    ):  # no compiler, no place for its work, a formula too long or not symbolic, or a fault of the compiler's own
        return None


__all__ = ["compiled_estimate"]
