"""Simulation of many closed loops, thousands of seeds, plants or gains, by `simulate` or on compiled plants.

`spread` distributes them over processes, in batches that stop soon after an interrupt.
"""

import pickle
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from multiprocessing.context import BaseContext
from typing import TYPE_CHECKING, Any, NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.presentation.progress import counted
from mpc.observer.base import Observer
from mpc.trials.many.runs import Outcome, Runs
from mpc.trials.motions.reference import Reference
from mpc.trials.simulation import ClosedLoop, Controller, Process, Run, simulate, state

if TYPE_CHECKING:
    from mpc.trials.many.driving import Driving


class Loop(NamedTuple):
    """Arguments of `simulate` for one run."""

    number: int  # among the runs
    plant: Process
    controller: Controller
    reference: Reference
    observer: Observer | None
    x0: Array | None  # (4,)
    seed: int

    def checked(self) -> Self:
        """Return the loop with a checked seed. Raises `InvalidInput` for invalid parts of a loop."""
        kinds: dict[str, type] = {"plant": Process, "controller": Controller, "reference": Reference}
        for name, kind in (kinds | ({} if self.observer is None else {"observer": Observer})).items():
            value = getattr(self, name)
            if isinstance(value, type) or not isinstance(value, kind):
                said = str(kind.__doc__).splitlines()[0]
                raise InvalidInput(f"{name}s[{self.number}] = {checks.brief(value)} is no {name}; expected: {said}")
        return self._replace(seed=checks.count(f"seeds[{self.number}]", self.seed, least=0))


def outcomes(loops: Sequence[Loop], keep: bool, made: "Compiled | None" = None) -> Iterator[tuple[int, Outcome]]:
    """Yield the number of each loop and its outcome; compiled parts are added to `made`."""
    for loop, (run, implementation) in zip(loops, runs(loops, made), strict=True):
        yield loop.number, Outcome.of(run, implementation, keep)


def runs(loops: Sequence[Loop], made: "Compiled | None" = None) -> Iterator[tuple[Run, str]]:
    """Yield the run of each loop, "compiled" or "readable"; compiled parts are added to `made`."""
    made = Compiled() if made is None else made
    for loop in loops:
        try:
            yield _run(loop, made)
        except Exception as error:
            error.add_note(f"in run {loop.number}, with the seed {loop.seed}")
            raise


Kept: TypeAlias = dict[tuple[float, ...], tuple[object, Any]]


class Compiled:
    """Compiled parts, reused for the same plants, controllers and observers."""

    def __init__(self, plants: Kept | None = None) -> None:
        self._plants: Kept = {} if plants is None else plants
        self._loops: Kept = {}

    def for_others(self) -> "Compiled":
        """Return the compiled plants alone, for other controllers and observers."""
        return Compiled(self._plants)

    def plant(self, plant: Process, dt: float) -> Process:
        """Return the compiled `plant`, or `plant` if that is impossible."""
        return self._found(self._plants, (id(plant), dt), plant, lambda: _compiled_plant(plant, dt)) or plant

    def driving(self, controller: Controller, observer: Observer | None) -> "Driving | None":
        """Return a compiled driver equal to controller and observer, or None if they cannot be compiled."""
        parts = controller, observer
        made: Driving | None = self._found(self._loops, tuple(map(id, parts)), parts, lambda: _driving(*parts))
        return made

    def _found(self, kept: Kept, key: tuple[float, ...], of: object, make: Callable[[], object]) -> Any:
        """Return the part made for a `key`, whose identities are those of the objects `of`, which are kept alive."""
        if key not in kept:
            try:
                made = make()
            except (ImportError, OSError, InvalidInput):  # no compiler, cache not writable, formula too long
                made = None
            kept[key] = of, made
        return kept[key][1]


def _compiled_plant(plant: Process, dt: float) -> Process:
    from mpc.trials.many.plant import compiled_plant

    return compiled_plant(plant, dt)


def _driving(controller: Controller, observer: Observer | None) -> "Driving | None":
    from mpc.trials.many.driving import driving

    return driving(controller, observer)


def _run(loop: Loop, made: Compiled) -> tuple[Run, str]:
    """Return the run, and whether its loop was "compiled" or "readable"."""
    plant, driving = made.plant(loop.plant, loop.controller.dt), made.driving(loop.controller, loop.observer)
    given = plant, loop.controller, loop.reference
    if driving is not None and plant is not loop.plant:
        closed = ClosedLoop(*given, loop.x0, loop.observer, loop.seed)
        if driving.drive(closed):
            return closed.run(), "compiled"
    return simulate(*given, x0=loop.x0, observer=loop.observer, seed=loop.seed), "readable"


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


def simulate_many(
    plants: Process | Sequence[Process],
    controllers: Controller | Sequence[Controller],
    references: Reference | Sequence[Reference],
    *,
    x0: ArrayLike | None = None,
    observers: Observer | Sequence[Observer | None] | None = None,
    seeds: int | Iterable[int] = 0,
    keep: bool = False,
    workers: int = 1,
    progress: bool = False,
) -> Runs:
    """Run many simulations in a fraction of the time of `simulate`, with results equal to 1e-9.

    Plants are compiled unless they have faults, or formulas too long to be compiled; that takes some seconds for the
    first of a kind, once.

    Parameters
    ----------
    plants, controllers, references, observers
        Of `simulate`: one for all runs, or a list with one for each. An object may be listed more than once.
    x0
        Initial state (4,), or states (n, 4); by default each plant's rest at its reference's first point.
    seeds
        Of the sensors' noise: one, or one for each run, as `range(1000)`.
    keep
        Whether to keep whole runs, `runs[i]`, a `Run` each; otherwise only figures are kept.
    workers
        Number of processes. If they do not begin as copies of this one (Windows, macOS), the calling script has to be
        importable: `if __name__ == "__main__":`.
    progress
        Whether to show a bar.

    Raises
    ------
    InvalidInput
        For lists of different lengths, and for objects that are not plants, controllers or references.
    """
    parts = {"plants": plants, "controllers": controllers, "references": references, "observers": observers}
    loops = _loops(x0, seeds, **parts)
    workers = min(checks.count("workers", workers, least=1), len(loops))
    found: Iterator[tuple[int, Outcome]]
    found = outcomes(loops, keep) if workers == 1 else spread(loops, keep, workers)
    by_run = dict(counted(found, "simulating", len(loops)) if progress else found)
    return Runs.of([loop.seed for loop in loops], [by_run[i] for i in range(len(loops))])


def _loops(x0: ArrayLike | None, seeds: int | Iterable[int], **parts: object) -> list[Loop]:
    """Return the loops, one for each run. Raises `InvalidInput`."""
    given = {
        **{name: _listed(part) for name, part in parts.items()},
        "x0": None if x0 is None else _states(x0),
        "seeds": [*seeds] if isinstance(seeds, Iterable) else seeds,
    }
    lengths = {name: len(value) for name, value in given.items() if isinstance(value, list)}
    if 0 in lengths.values() or len({*lengths.values()}) > 1:
        raise InvalidInput(
            f"the lists have different lengths, or nothing in them: {', '.join(f'{n} {k}' for n, k in lengths.items())}"
        )
    n = max(lengths.values(), default=1)
    columns = (value if isinstance(value, list) else [value] * n for value in given.values())
    return [Loop(i, *row).checked() for i, row in enumerate(zip(*columns, strict=True))]


def _listed(given: object) -> object:
    """Return a sequence as a list, and any other value unchanged."""
    return [*given] if isinstance(given, Sequence) and not isinstance(given, str) else given


def _states(x0: ArrayLike) -> Array | list[Array]:
    """Return a state, or a list of states."""
    array = np.asarray(x0)
    return [state(row) for row in array] if array.ndim == 2 else state(x0)
