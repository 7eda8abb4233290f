"""Runs are spread over processes here, in batches, and stop soon when they are interrupted."""

import pickle
import signal
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any

from allocator.errors import InvalidInput
from mpc.trials.many.loop import Loop, outcomes
from mpc.trials.many.runs import Outcome

_BATCHES = 8  # for each process: some take longer than others

_stop: Any = None  # an event, in processes that work for others


def spread(loops: Sequence[Loop], keep: bool, workers: int) -> Iterator[tuple[int, Outcome]]:
    """Yield the number of each loop and its outcome as they come from so many processes."""
    size = -(-len(loops) // (_BATCHES * workers))
    batches = [_pickled(loops[i : i + size]) for i in range(0, len(loops), size)]
    context = get_context()
    stop = context.Event()
    with ProcessPoolExecutor(workers, context, _begin, (stop,)) as pool:
        try:
            for future in as_completed([pool.submit(_batch, batch, keep) for batch in batches]):
                yield from future.result()
        except BaseException:
            stop.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _pickled(loops: Sequence[Loop]) -> bytes:
    try:
        return pickle.dumps(loops)
    except Exception as failure:  # whatever is in them says why
        raise InvalidInput(
            f"runs {loops[0].number} to {loops[-1].number} cannot be sent to another process, say workers=1: {failure}"
        ) from None


def _begin(stop: Any) -> None:
    """Prepare a process: an interrupt is for the one that it works for, which then says stop."""
    global _stop
    _stop = stop
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _batch(loops: bytes, keep: bool) -> list[tuple[int, Outcome]]:
    """Return the outcomes of a batch; of those before the stop."""
    found = []
    for one in outcomes(pickle.loads(loops), keep):
        found.append(one)
        if _stop.is_set():
            break
    return found


__all__ = ["spread"]
