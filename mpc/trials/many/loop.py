"""A loop is one run, and what does it: `simulate`, on a compiled plant where there is one."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, Self

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from mpc.observer.kalman import Observer
from mpc.trials.many.runs import Outcome
from mpc.trials.reference import Reference
from mpc.trials.simulation import Controller, Process, Run, simulate


class Loop(NamedTuple):
    """A loop is what `simulate` takes, for one run."""

    number: int  # among the runs
    plant: Process
    controller: Controller
    reference: Reference
    observer: Observer | None
    x0: Array | None  # (4,)
    seed: int

    def checked(self) -> Self:
        """Return itself, with a seed that is one. Raises `InvalidInput` for what can take no part in a loop."""
        kinds: dict[str, Any] = {"plant": Process, "controller": Controller, "reference": Reference}
        for name, kind in (kinds | ({} if self.observer is None else {"observer": Observer})).items():
            value = getattr(self, name)
            if isinstance(value, type) or not isinstance(value, kind):
                said = str(kind.__doc__).splitlines()[0]
                raise InvalidInput(f"{name}s[{self.number}] = {checks.brief(value)} is no {name}. {said}")
        return self._replace(seed=checks.count(f"seeds[{self.number}]", self.seed, least=0))


def outcomes(loops: Sequence[Loop], keep: bool) -> Iterator[tuple[int, Outcome]]:
    """Yield the number of each loop and its outcome."""
    plants = CompiledPlants()
    for loop in loops:
        try:
            run, implementation = _run(loop, plants)
        except Exception as error:
            error.add_note(f"in run {loop.number}, with the seed {loop.seed}")
            raise
        yield loop.number, Outcome.of(run, implementation, keep)


class CompiledPlants:
    """Compiled plants are found again as long as the same plants come."""

    def __init__(self) -> None:
        self._last: dict[tuple[int, float], tuple[Process, Process]] = {}

    def __call__(self, plant: Process, dt: float) -> Process:
        """Return `plant` compiled, or itself where that cannot be done."""
        key = id(plant), dt
        if key not in self._last:
            self._last[key] = plant, _compiled(plant, dt)
        return self._last[key][1]


def _compiled(plant: Process, dt: float) -> Process:
    try:
        from mpc.trials.many.plant import compiled_plant

        return compiled_plant(plant, dt)
    except (ImportError, OSError, InvalidInput):  # no compiler, no place for its work, a plant that is not compiled
        return plant


def _run(loop: Loop, plants: CompiledPlants) -> tuple[Run, str]:
    """Return the run, and "compiled" or "readable"."""
    plant = plants(loop.plant, loop.controller.dt)
    settings: dict[str, Any] = {"x0": loop.x0, "observer": loop.observer, "seed": loop.seed}
    return simulate(plant, loop.controller, loop.reference, **settings), "readable"


__all__ = ["Loop", "outcomes"]
