"""Single run of many, by `simulate` or on a compiled plant."""

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Self, TypeAlias

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from mpc.observer.base import Observer
from mpc.trials.many.runs import Outcome
from mpc.trials.motions.reference import Reference
from mpc.trials.simulation import ClosedLoop, Controller, Process, Run, simulate

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
