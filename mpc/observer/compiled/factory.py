"""Factory of an observer's compiled estimate."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from allocator.compilation import beside
from allocator.presentation.progress import waiting
from mpc.observer.compiled.layout import State, Tail
from mpc.observer.diagnosis import Diagnosis
from mpc.observer.filter import Filter

if TYPE_CHECKING:
    from mpc.observer.compiled.whole import CompiledEstimate  # which imports numba


class Readable(NamedTuple):
    """Access to the memory of the readable observer."""

    remembered: Callable[
        [], dict[str, object] | None
    ]  # return the fields of `State` and `Tail`, None if some have no place
    go_on: Callable[[State, Tail], None]  # continue from copies of their values
    conclude: Callable[[], None]  # update the findings


def compiled_estimate(
    own: Filter, diagnosis: Diagnosis, readable: Readable, wait: bool, again: tuple[Any, ...]
) -> "CompiledEstimate | None":
    """Return the compiled estimate for the `readable` observer; None if compilation fails.

    If `wait` is false and nothing is compiled yet, return None and compile in another process, by a call of again[0]
    with the other elements. There is no warning: the readable observer is fast enough for any loop, and the
    controller's step, which warns, fails to compile for the same reasons.
    """
    try:
        from mpc.observer.compiled.module import compiled_filter, made_of
        from mpc.observer.compiled.whole import CompiledEstimate

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
