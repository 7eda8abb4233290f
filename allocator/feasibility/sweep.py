"""Designs and their performance; `design_sweep` runs many, on an executor or a cluster, and can resume."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass
from itertools import product
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidFile, InvalidInput
from allocator.feasibility.setting import Setting, lowest, spans
from allocator.files.atomic import write_text
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.geometry import Pulley
from allocator.joint.limits import Limits
from allocator.joint.torque_levels import torque_interval
from allocator.muscles import Muscle
from allocator.muscles.catalogue import TONDU_DMSP_20_400N

_PIECES = 64  # of the joint range in the search for extremes


class Design(NamedTuple):
    """Joint design with two equal muscles on a pulley; the defaults are those of the report."""

    radius: float = 0.02  # R [m]
    rest_length: float = 0.40  # l0 [m]
    initial_contraction: float = 0.1375  # ε0 [-]
    supply_pressure: float = 5e5  # [Pa]

    def joint(self, muscle: Muscle = TONDU_DMSP_20_400N, stops: tuple[float, float] | None = None) -> AntagonistJoint:
        """Return the joint of this design, with mechanical end stops [rad] if there are any."""
        pulley = Pulley(self.rest_length, self.radius, self.initial_contraction)
        return AntagonistJoint(pulley, muscle, muscle, (0.0, self.supply_pressure), angle_limits=stops)


_REPORT = Design()


class Performance(NamedTuple):
    """Performance of a design without load, with isobaric stiffnesses; NaN if infeasible."""

    left: float  # joint range [rad]: the widest interval of feasible angles without load
    right: float
    K_low: float  # stiffnesses from K_low to K_high [N·m/rad] are feasible over the whole range …
    K_high: float  # … none if K_low > K_high
    torque_reserve: float  # least feasible torque [N·m] in both directions over the range

    @property
    def range(self) -> float:
        """Width of the joint range [rad]."""
        return self.right - self.left

    @property
    def band(self) -> float:
        """Width of the band of stiffnesses feasible over the whole range [N·m/rad]; 0 if there is none."""
        return max(self.K_high - self.K_low, 0.0)


_NOTHING = Performance(*[np.nan] * 5)


def design_grid(
    radius: ArrayLike = _REPORT.radius,
    rest_length: ArrayLike = _REPORT.rest_length,
    initial_contraction: ArrayLike = _REPORT.initial_contraction,
    supply_pressure: ArrayLike = _REPORT.supply_pressure,
) -> tuple[Design, ...]:
    """Return all combinations of these radii [m], rest lengths [m], contractions [-] and supply pressures [Pa]."""
    axes = (
        checks.real("radius", radius, "m"),
        checks.real("rest_length", rest_length, "m"),
        checks.real("initial_contraction", initial_contraction, "-"),
        checks.pressure("supply_pressure", supply_pressure),
    )
    return tuple(Design(*map(float, values)) for values in product(*map(np.ravel, axes)))


def performance(
    design: Design,
    muscle: Muscle = TONDU_DMSP_20_400N,
    stops: tuple[float, float] | None = None,
    min_force: float = 0.0,
) -> Performance:
    """Return joint range, stiffness band and torque reserve of a design; all NaN if no angle is feasible without load.

    Extremes over the range are found among 65 angles and refined. An initial contraction below the threshold leaves no
    angle and gives NaN; other invalid numbers raise InvalidInput.
    """
    if design.initial_contraction <= AntagonistJoint.min_contraction:
        return _NOTHING
    setting = Setting.of(design.joint(muscle, stops), Limits(min_force))

    left, right = spans(setting.torque_margin, *setting.joint.angle_range, np.zeros(1), pieces=_PIECES)
    if not len(left):
        return _NOTHING
    widest = int(np.argmax(right - left))
    ends = float(left[widest, 0]), float(right[widest, 0])
    return Performance(*ends, *_extremes(setting, *ends))


def _extremes(setting: Setting, left: float, right: float) -> Iterator[float]:
    """Return greatest K_min, least K_max and least torque reserve between the angles left and right."""

    def negative_K_min(theta: Array) -> Array:
        return -setting.columns(theta, 0.0).K_min.reshape(theta.shape)

    def K_max(theta: Array) -> Array:
        return setting.columns(theta, 0.0).K_max.reshape(theta.shape)

    def reserve(theta: Array) -> Array:
        problem, _ = setting.problem(theta)
        T_min, T_max = torque_interval(problem.sides, problem.box)
        return np.minimum(-T_min, T_max).reshape(theta.shape)

    for function, sign in ((negative_K_min, -1.0), (K_max, 1.0), (reserve, 1.0)):
        at = lowest(function, np.array([left]), np.array([right]), pieces=_PIECES)
        yield sign * float(function(at)[0])


def checked(designs: Iterable[Design]) -> tuple[Design, ...]:
    """Return the designs. Raises `InvalidInput` if there are none."""
    found = tuple(designs)
    if not found:
        raise InvalidInput("design_sweep got no designs")
    if wrong := [d for d in found if not isinstance(d, Design)]:
        raise InvalidInput(f"design_sweep takes Design objects, not {wrong[0]!r}; see design_grid")
    return found


_BATCH = 16  # designs per task: about 50 ms, against a few for sending it
_AHEAD = 64  # tasks submitted before the first returns
_COLUMNS = (*Design._fields, *Performance._fields)

Answer: TypeAlias = tuple[Design, Performance]
Progress: TypeAlias = Callable[..., Iterable[Answer]]


@dataclass(frozen=True)
class Sweep:
    """Designs and their performance, in the requested order."""

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
        The designs to evaluate.
    muscle, stops, min_force
        Of all designs: both muscles, the mechanical end stops [rad] and the force [N] that keeps the cables taut.
    executor
        Any `concurrent.futures.Executor` to run on, e.g. a `ProcessPoolExecutor`, or `distributed.Client(...)
        .get_executor()` for a Dask cluster (extra `antagonist[dask]`). None: in this thread.
    out
        CSV file to which every design is appended when done. Designs found in it are not computed again, so that an
        interrupted sweep resumes. A file of another muscle or other limits is refused.
    progress
        Wrapper of the iteration over finished designs, called with `total=`: `tqdm.tqdm`, `rich.progress.track`.
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
        yield from ((design, performance(design, *rules)) for batch in batches for design in batch)
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
    """Return the contents of the file; create it if it does not exist. An incomplete last line is dropped."""
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
