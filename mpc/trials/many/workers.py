"""Distribution of runs over processes, in batches that stop soon after an interrupt."""

import pickle
import signal
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from multiprocessing.context import BaseContext
from typing import Any

from allocator.errors import InvalidInput
from mpc.trials.many.loop import Compiled, Loop, outcomes
from mpc.trials.many.runs import Outcome

_BATCHES = 8  # per process, because some take longer than others

_given: Any = None  # in worker processes: loops, whether to keep runs, an event for the stop, and parts
# compiled in earlier batches


def spread(
    loops: Sequence[Loop], keep: bool, workers: int, context: BaseContext | None = None
) -> Iterator[tuple[int, Outcome]]:
    """Yield the number of each loop and its outcome as they arrive from so many processes.

    This process runs the first loop, which compiles the code for the others. Raises `InvalidInput` for loops that
    cannot be sent to processes that do not begin as copies of this one.
    """
    yield from outcomes(loops[:1], keep)
    context = get_context() if context is None else context
    if context.get_start_method() != "fork":
        _check_sendable(loops)
    size = -(-len(loops[1:]) // (_BATCHES * workers)) or 1
    batches = [(i, min(i + size, len(loops))) for i in range(1, len(loops), size)]
    stop = context.Event()
    with ProcessPoolExecutor(workers, context, _begin, (loops, keep, stop)) as pool:
        try:
            for future in as_completed([pool.submit(_batch, *batch) for batch in batches]):
                yield from future.result()
        except BaseException:
            stop.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _check_sendable(loops: Sequence[Loop]) -> None:
    try:
        pickle.dumps(loops)
    except Exception as failure:  # the message gives the reason
        raise InvalidInput(f"these loops cannot be sent to other processes, say workers=1: {failure}") from None


def _begin(*given: object) -> None:
    """Prepare a process: it ignores interrupts, which its parent handles."""
    global _given
    _given = (*given, Compiled())
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _batch(begin: int, end: int) -> list[tuple[int, Outcome]]:
    """Return the outcomes of a batch, up to the stop."""
    loops, keep, stop, made = _given
    found = []
    for one in outcomes(loops[begin:end], keep, made):
        found.append(one)
        if stop.is_set():
            break
    return found
