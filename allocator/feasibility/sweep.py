"""`design_sweep` runs many designs, here, on an executor or on a cluster; interrupted sweeps go on."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidFile, InvalidInput
from allocator.feasibility.design import Design, Performance, checked, performance
from allocator.files.atomic import write_text
from allocator.muscles import Muscle
from allocator.muscles.catalogue import TONDU_DMSP_20_400N

_BATCH = 16  # designs a task: some 50 ms, against a few for sending it
_AHEAD = 64  # tasks that are submitted before the first is back
_COLUMNS = (*Design._fields, *Performance._fields)

Answer: TypeAlias = tuple[Design, Performance]
Progress: TypeAlias = Callable[..., Iterable[Answer]]


@dataclass(frozen=True)
class Sweep:
    """A `Sweep` is designs and what each of them can do, in the order in which they were asked for."""

    designs: tuple[Design, ...]
    performances: tuple[Performance, ...]

    def column(self, name: str) -> Array:
        """Return a column (n,) in SI units: a field of `Design` or `Performance`, or their "range" or "band"."""
        for rows, names in (
            (self.designs, Design._fields),
            (self.performances, (*Performance._fields, "range", "band")),
        ):
            if name in names:
                return np.array([getattr(row, name) for row in rows])
        raise InvalidInput(f"a sweep has no column {name!r}; it has {', '.join(_COLUMNS)}, range and band")


def design_sweep(
    designs: Iterable[Design],
    *,
    muscle: Muscle = TONDU_DMSP_20_400N,
    stops: tuple[float, float] | None = None,
    min_force: float = 0.0,
    executor: Executor | None = None,
    out: str | PathLike[str] | None = None,
    progress: Progress | None = None,
) -> Sweep:
    """Return the joint range, constant-stiffness band and torque reserve of every design (see `design_grid`).

    Parameters
    ----------
    designs
        The designs to try.
    muscle, stops, min_force
        Of all designs: both muscles, the mechanical end stops [rad] and the force [N] that keeps the cables taut.
    executor
        Any `concurrent.futures.Executor` to run on, e.g. a `ProcessPoolExecutor`, or `distributed.Client(...)
        .get_executor()` for a Dask cluster (extra `antagonist[dask]`). None: in this thread.
    out
        CSV file to which every design is appended as soon as it is done. Designs that stand in it are not computed
        again, so that an interrupted sweep goes on. A file of another muscle or other limits is refused.
    progress
        What to wrap the iteration over finished designs in, called with `total=`: `tqdm.tqdm`, `rich.progress.track`.
    """
    designs = checked(designs)
    rules = f"# muscle = {muscle!r}, stops = {stops!r} rad, min_force = {float(min_force)!r} N"
    done = {} if out is None else _read(Path(out), rules)
    left = [design for design in dict.fromkeys(designs) if design not in done]
    batches = [left[i : i + _BATCH] for i in range(0, len(left), _BATCH)]
    answers = _run(batches, (muscle, stops, min_force), executor)
    for design, found in answers if progress is None else progress(answers, total=len(left)):
        done[design] = found
        if out is not None:
            _append(Path(out), (*design, *found))
    return Sweep(designs, tuple(done[design] for design in designs))


def _run(batches: Sequence[list[Design]], rules: tuple[Any, ...], executor: Executor | None) -> Iterator[Answer]:
    """Run the batches and yield answers as they come."""
    if executor is None:
        for batch in batches:
            for design in batch:
                yield design, performance(design, *rules)
        return
    waiting = list(batches)
    running: set[Future[list[Answer]]] = set()
    while True:
        while waiting and len(running) < _AHEAD:
            running.add(executor.submit(_batch, waiting.pop(), rules))
        if not running:
            return
        finished, running = wait(running, return_when=FIRST_COMPLETED)
        for future in finished:
            yield from future.result()


def _batch(designs: list[Design], rules: tuple[Any, ...]) -> list[Answer]:
    return [(design, performance(design, *rules)) for design in designs]


# --- the file -------------------------------------------------------------------------------------------------------


def _read(path: Path, rules: str) -> dict[Design, Performance]:
    """Return what the file holds; begin it if it does not exist. A last line without its end is dropped."""
    head = f"{rules}\n{','.join(_COLUMNS)}\n"
    if not path.exists() or not path.stat().st_size:
        write_text(path, head)
        return {}
    text = path.read_text(encoding="utf-8")
    if not text.startswith(head):
        raise InvalidFile(
            path, f"is not a sweep of this muscle and these limits; it should begin with {rules!r}", line=1
        )
    whole = text[: text.rindex("\n") + 1]
    if whole != text:
        write_text(path, whole)
    return dict(_answer(path, i, line) for i, line in enumerate(whole[len(head) :].splitlines(), 3))


def _answer(path: Path, number: int, line: str) -> Answer:
    try:
        values = [float(value) for value in line.split(",")]
        return Design(*values[: len(Design._fields)]), Performance(*values[len(Design._fields) :])
    except (TypeError, ValueError):
        raise InvalidFile(path, f"{line!r} is not a row of {len(_COLUMNS)} numbers", line=number) from None


def _append(path: Path, values: tuple[float, ...]) -> None:
    with path.open("a", encoding="utf-8") as file:
        file.write(",".join(map(repr, map(float, values))) + "\n")
