"""Logs of a bench: reading, conversion to runs, storage as NPZ.

A log is the CSV of `mpc.bench.rows`, in SI units. `read_log` accepts one that ends in the middle of a line. The
samples of a log under control make a `Run`, for the same metrics, pictures and recordings as those of simulations: its
states are measured, or estimated if they are not measured.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from allocator.calculus import Array, Value
from allocator.errors import InvalidFile, InvalidInput
from allocator.units import DEG
from mpc.bench.cycle import Phase
from mpc.bench.record import Lateness
from mpc.bench.rows import INTEGERS, Column, Columns, Sheet
from mpc.bench.safety import Ending
from mpc.model.machine import Machine
from mpc.observer.health import WELL, Health
from mpc.trials.files import save_recording
from mpc.trials.metrics import Errors, errors_of
from mpc.trials.simulation import Run


@dataclass(frozen=True, eq=False)
class Record:
    """Record of a loop: its N rows as columns (N,), see `mpc.bench.rows`, its ending, and the last health of the
    machine.
    """

    plant: Machine  # the controller's
    dt: float  # [s]
    columns: Columns
    ending: Ending
    health: Health = WELL

    @property
    def lateness(self) -> Lateness:
        """Distribution of lateness, without that of the safe stop."""
        late, missed = self.where("late", "missed", phases=_MOVING)
        return Lateness.of(late, missed, self.dt)

    @property
    def controlled(self) -> bool:
        """Whether there are enough samples under control for a `Run`."""
        return int(np.isin(self.columns["phase"], _CONTROLLED).sum()) >= _LEAST

    @property
    def tracked(self) -> bool:
        """Whether it has followed the reference."""
        return bool((self.columns["phase"] == Phase.RUN).any())

    @property
    def theta_rms(self) -> Value:
        """Root mean square [rad] of the measured angle minus its reference, (n,) of an arm, without settling;
        NaN if never measured.
        """
        return np.multiply(self.errors.theta_rms, DEG)

    @property
    def errors(self) -> Errors:
        """Errors of the measured angle and of the stiffness, without settling; NaN if never measured.

        The stiffness is that of the model at the measured or else estimated state. Raises `InvalidInput` if the loop
        ended before it followed its reference.
        """
        if not (self.tracked and self.controlled):
            raise InvalidInput(f"the loop ended before it followed its reference ({self.ending}): it has no errors")
        run, begin = self.run(), len(self.values("phase", (Phase.SETTLE,)))
        theta, K = map(np.ma.masked_invalid, (self.values("theta", (Phase.RUN,)), run.K[begin:]))
        return errors_of(theta, run.theta_ref[begin:], K, run.K_ref[begin:])

    def values(self, field: str, phases: tuple[Phase, ...]) -> Column:
        """Return a field of `Row` in these phases: numbers (N,), or a row or a matrix per sample."""
        return Sheet.of(self.plant).values(self.columns, field)[np.isin(self.columns["phase"], phases)]

    def where(self, *names: str, phases: tuple[Phase, ...]) -> list[Column]:
        """Return the columns `names` in these phases."""
        here = np.isin(self.columns["phase"], phases)
        return [self.columns[name][here] for name in names]

    def run(self) -> Run:
        """Return the samples under control as a `Run`. Raises `InvalidInput` if there are fewer than two."""
        return run_of(self.columns, self.plant, self.dt)

    def save(self, path: str | Path) -> None:
        """Write an NPZ that `load_recording` reads as a run, with every column of the log beside it (`log_…`).

        Raises `CannotWrite`, and `InvalidInput` if there is no run.
        """
        save_recording(self.run(), path, {f"log_{name}": column for name, column in self.columns.items()})


_MOST = 2.0**53  # floats represent all whole numbers up to this one
_MOVING = (Phase.RAMP, Phase.SETTLE, Phase.RUN)
_LEAST = 2  # samples of a run
_CONTROLLED = (Phase.SETTLE, Phase.RUN)


def run_of(columns: Columns, plant: Machine, dt: float) -> Run:
    """Return the samples of a log that were under control as a `Run` of the nominal `plant` with samples of `dt` [s].

    The run ends at the last of them. Raises `InvalidInput` if there are fewer than two.
    """
    here = np.isin(columns["phase"], _CONTROLLED)
    if here.sum() < _LEAST:
        raise InvalidInput(f"the log has {here.sum()} samples under control; a run has two or more")
    c, sheet, size = {name: column[here] for name, column in columns.items()}, Sheet.of(plant), int(here.sum())

    def rows(*fields: str) -> Array:
        return np.concatenate([sheet.values(c, field).reshape(size, -1) for field in fields], axis=1)

    estimate = rows(*(f"{name}_estimate" for name in ("theta", "omega", "P", "d")))
    measured = np.concatenate([rows("theta"), np.full((size, plant.n), np.nan), rows("P")], axis=1)
    x = np.where(np.isfinite(measured), measured, estimate[:, : plant.size])
    last = slice(None, -1)
    moved = rows("moved_theta", "moved_K", "moved_T")
    return Run(
        plant, dt, c["t"] - c["t"][0], x, estimate[last], rows("P_command")[last],
        sheet.values(c, "theta_ref"), sheet.values(c, "K_ref"), *plant.along(x),
        c["took"][last], c["rung"][last], c["status"][last], c["slack"][last], c["slack_force"][last], moved[last], "",
    )  # fmt: skip


def read_log(path: str | Path) -> dict[str, Column]:
    """Read the columns (N,) of a loop's log by their names, see `mpc.bench.rows`, without an unfinished last line.

    Raises `InvalidFile`.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise InvalidFile(path, f"cannot be read ({error.strerror or error})") from None
    except UnicodeDecodeError:
        raise InvalidFile(path, "is no text") from None
    ended = text[: text.rfind("\n") + 1].splitlines()
    lines = [(number, line) for number, line in enumerate(ended, 1) if not line.startswith("#")]
    if not lines:
        raise InvalidFile(path, "has no line of column names")
    names = [re.sub(r" \[.*\]$", "", name) for name in lines[0][1].split(",")]
    if missing := set(Sheet.found(names).names) - set(names):
        raise InvalidFile(path, f"is no log of a loop: {', '.join(sorted(missing))} missing", line=lines[0][0])
    whole = [i for i, name in enumerate(names) if name in INTEGERS]
    rows = np.array([_numbers(path, number, line, len(names), whole) for number, line in lines[1:]])
    rows = rows.reshape(-1, len(names))
    return {name: rows[:, i].astype(int) if name in INTEGERS else rows[:, i] for i, name in enumerate(names)}


def _numbers(path: str | Path, number: int, line: str, n: int, whole: list[int]) -> list[float]:
    """Return the n values of a line, with whole numbers at the places `whole`."""
    try:
        values = [float(cell) for cell in line.split(",")]
    except ValueError:
        raise InvalidFile(path, "has a cell that is no number", line=number) from None
    if len(values) != n:
        raise InvalidFile(path, f"has {len(values)} cells, not {n}", line=number)
    if any(not abs(values[i]) < _MOST or values[i] % 1 for i in whole):
        raise InvalidFile(path, "has a phase, count or status that is no whole number", line=number)
    return values
