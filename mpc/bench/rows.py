"""Rows of a loop's log, and the columns that they make in its file.

A joint has one column for each field of `Row`, and P1, P2 for its pressures. Columns of an arm are numbered like its
joints, its muscles and the entries of the tracked stiffness: theta2_ref, P3_command, K12_estimate.

Record of a loop, sample by sample: in memory, and in a file that is always up to date.

The file is a CSV with a line per sample, written to the system at once and without buffering, so that the log of a
killed process is complete up to its last sample. If the disk is full, an incomplete line is removed. Units are SI, and
numbers are exact (`repr`), so that a log can be replayed; `NaN` is an unmeasured quantity.

An existing log is replaced only on request, and only by the first row: until then the head of the new log is in its own
file, which shows that the disk accepts it. A loop without a first row leaves no file behind.
"""

import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import count, takewhile
from math import nan
from pathlib import Path
from typing import Any, NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array, Value
from allocator.errors import CannotWrite, InvalidInput
from allocator.files.atomic import check_writable
from mpc.model.machine import Machine
from mpc.model.plant import Plant
from mpc.tracking.plan import Plan

Pressures: TypeAlias = tuple[float, ...]  # (m,) [Pa]
Column: TypeAlias = NDArray[Any]  # of floats or of integers
Columns: TypeAlias = Mapping[str, Column]


class Row(NamedTuple):
    """One sample of a loop with m muscles; SI units.

    Quantities of a joint are numbers. Those of an arm with n joints are rows (n,), and its stiffness is a matrix
    (k, k); a number stands for all of them.
    """

    t: float  # beginning [s], since the first one
    theta: Value  # measured [rad]; NaN: no reading
    P: Pressures  # measured (m,) [Pa]
    P_command: Pressures  # (m,) [Pa]
    phase: int  # `Phase`
    missed: int  # missed samples before it
    late: float  # delay of its beginning after the deadline [s]
    took: float  # from then until its command was sent [s]
    read_at: float = nan  # time of the measurement by the device [s], since the first sample
    sent: int = 1  # whether the device took the command
    torque: Value = 0.0  # of a weight on the joint, if known [N·m]
    theta_ref: Value = nan  # [rad]
    K_ref: Value = nan  # [N·m/rad], of an endpoint [N/m]
    theta_estimate: Value = nan  # [rad]
    omega_estimate: Value = nan  # [rad/s]
    P_estimate: Value = nan  # (m,) [Pa]
    d_estimate: Value = nan  # disturbance torque [N·m]
    K_estimate: Value = nan  # stiffness when the command begins to act, by the model, like `K_ref`
    rung: int = -1  # `mpc.tracking.plan.Rung`; -1: no plan
    status: int = -2  # `PlanStatus`; -2: no plan
    slack: float = 0.0  # predicted excursion from the joint range [rad]
    slack_force: float = 0.0  # predicted lack of muscle force [N]
    moved_theta: float = nan  # distance by which the controller moved the reference [rad]
    moved_K: float = nan  # [N·m/rad], of an endpoint [N/m]
    moved_T: float = nan  # [N·m]


INTEGERS = frozenset(name for name, kind in Row.__annotations__.items() if kind is int)
_OF_JOINTS = "theta", "torque", "theta_ref", "theta_estimate", "omega_estimate", "d_estimate"
_OF_MUSCLES = "P", "P_command", "P_estimate"
_OF_STIFFNESS = "K_ref", "K_estimate"
_STIFFNESS = *_OF_STIFFNESS, "moved_K"
_UNITS = dict.fromkeys(_OF_MUSCLES, "Pa") | {
    "t": "s", "theta": "rad", "late": "s", "took": "s", "read_at": "s", "torque": "Nm", "theta_ref": "rad",
    "theta_estimate": "rad", "omega_estimate": "rad/s", "d_estimate": "Nm", "slack": "rad", "slack_force": "N",
    "moved_theta": "rad", "moved_T": "Nm",
}  # fmt: skip


@dataclass(frozen=True)
class Sheet:
    """Columns of a machine's log; by default those of a joint."""

    joints: tuple[str, ...] = ("",)  # (n,) numbers in the names of the columns
    muscles: tuple[str, ...] = ("1", "2")  # (m,) likewise
    stiffness: tuple[str, ...] = ("K",)  # names of the entries, the upper triangle of a matrix
    unit: str = "Nm/rad"  # of the stiffness

    @classmethod
    def of(cls, machine: Machine) -> Self:
        """Return the sheet of a joint or an arm."""
        if isinstance(machine, Plant):
            return cls()
        joints, muscles = (tuple(map(str, range(1, size + 1))) for size in (machine.n, machine.m))
        return cls(joints, muscles, machine.labels.stiffness, machine.stiffness_unit.replace("·", ""))

    @classmethod
    def found(cls, names: Sequence[str]) -> Self:
        """Return the sheet of a log whose columns have these names, some of which may be missing."""
        if "theta1" not in names:
            return cls()
        joints, muscles = (_numbers(stem, names) for stem in ("theta", "P"))
        entries = tuple(name.removesuffix("_ref") for name in names if re.fullmatch(r"Kx?\d+_ref", name))
        return cls(joints, muscles, entries or ("K11",))

    @cached_property
    def fields(self) -> dict[str, tuple[str, ...]]:
        """Names of the columns of each field of `Row`."""
        return {name: tuple(self._columns_of(name)) for name in Row._fields}

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all columns."""
        return tuple(name for names in self.fields.values() for name in names)

    @cached_property
    def kinds(self) -> tuple[type, ...]:
        """Type of the numbers of each column; a NumPy scalar has another `repr`."""
        return tuple(int if name in INTEGERS else float for name in self.names)

    @property
    def header(self) -> str:
        """Line of the names of all columns with their units."""
        units = _UNITS | dict.fromkeys(_STIFFNESS, self.unit)
        named = ((name, units.get(field)) for field, names in self.fields.items() for name in names)
        return ",".join(f"{name} [{unit}]" if unit else name for name, unit in named)

    def cells(self, row: Row) -> list[Any]:
        """Return the numbers of a row, one for each column."""
        cells: list[Any] = list(row)
        for i, width in self._several:
            cells[i : i + 1] = _spread(row[i], width)
        return cells

    def values(self, columns: Columns, field: str) -> Column:
        """Return a field of all N rows: numbers (N,), or rows (N, n) or (N, m), or matrices (N, k, k)."""
        names = self.fields[field]
        if names == (field,):
            return columns[field]
        entries = np.stack([columns[name] for name in names], axis=-1)
        return _matrices(entries) if field in _OF_STIFFNESS else entries

    def _columns_of(self, field: str) -> Iterator[str]:
        stem, _, kind = field.partition("_")
        ending = f"_{kind}" if kind else ""
        if field in _OF_STIFFNESS:
            yield from (f"{entry}{ending}" for entry in self.stiffness)
        elif field in (*_OF_JOINTS, *_OF_MUSCLES):
            numbers = self.muscles if field in _OF_MUSCLES else self.joints
            yield from (f"{stem}{number}{ending}" for number in numbers)
        else:
            yield field

    @cached_property
    def _several(self) -> tuple[tuple[int, int], ...]:
        """Place of each field that is a row or a matrix, and its number of columns, from the last field on."""
        places = [(i, len(names)) for i, (field, names) in enumerate(self.fields.items()) if names != (field,)]
        return tuple(reversed(places))


JOINT = Sheet()  # columns of the log of a joint


def _numbers(stem: str, names: Sequence[str]) -> tuple[str, ...]:
    """Return the numbers 1, 2, … after `stem` in the names of columns."""
    return tuple(map(str, takewhile(lambda i: f"{stem}{i}" in names, count(1))))


def of_plan(plan: Plan) -> dict[str, object]:
    """Return the fields of a controller's plan."""
    moved = {} if plan.moved is None else {f"moved_{name}": value for name, value in plan.moved._asdict().items()}
    K = plan.K[0]
    return {
        "K_estimate": K if K.ndim else float(K),
        "rung": int(plan.rung),
        "status": int(plan.status),
        "slack": plan.slack,
        "slack_force": plan.slack_force,
        **moved,
    }


def _spread(value: Any, width: int) -> Iterable[float]:
    """Return a row, the upper triangle of a matrix, or a number `width` times."""
    if isinstance(value, tuple):
        return value
    array = np.asarray(value, float)
    if not array.ndim:
        return (float(value),) * width
    flat: list[float] = (array[np.triu_indices(len(array))] if array.ndim > 1 else array).tolist()
    return flat


def _matrices(entries: Array) -> Array:
    """Return the symmetric matrices (N, k, k) with these upper triangles (N, k(k + 1)/2)."""
    k = int((2 * entries.shape[-1]) ** 0.5)
    K, (rows, columns) = np.empty((len(entries), k, k)), np.triu_indices(k)
    K[:, rows, columns] = K[:, columns, rows] = entries
    return K


_CHUNK = 4096  # rows


class Recorder:
    """Rows of a loop in memory, and in the file `path` if one is given, with the columns of a `sheet`.

    Entered as a context, it begins the file. Raises `CannotWrite`, and `InvalidInput` for a file that exists unless
    `replace`.
    """

    def __init__(
        self, path: str | Path | None, about: Sequence[str] = (), *, sheet: Sheet = JOINT, replace: bool = False
    ) -> None:
        self._path, self._about, self._sheet, self._replace = path, about, sheet, replace
        self._file: int | None = None
        self._target: Path | None = None  # to which the first row renames the draft
        self._draft: Path | None = None  # removed if there is no row
        self._chunks: list[Array] = []
        self._used = _CHUNK  # rows of the last chunk

    def __enter__(self) -> Self:
        if self._path is not None:
            check_writable(self._path)
            target = Path(os.path.realpath(self._path))
            exists = target.is_file()
            if exists and not self._replace:
                raise InvalidInput(f"log = {os.fspath(self._path)!r} exists; give another name, or replace=True")
            self._target = target if exists else None
            self._draft = _beside(target) if exists else None if target.exists() else target
            try:
                target.parent.mkdir(parents=True, exist_ok=True)
                self._file = _opened(self._draft or target, os.O_EXCL if self._draft else 0)
            except OSError as error:
                raise CannotWrite(self._path, error) from None
            try:
                self._write("".join(f"# {line}\n" for line in self._about) + self._sheet.header + "\n")
            except CannotWrite:
                self.__exit__()
                raise
        return self

    def __exit__(self, *raised: object) -> None:
        file, self._file = self._file, None
        if file is not None:
            os.close(file)
        if self._draft is not None:
            self._draft.unlink(missing_ok=True)
            self._draft = None

    def add(self, row: Row) -> None:
        """Add a row. Raises `CannotWrite`; the file then ends with the row before, and is closed."""
        if self._used == _CHUNK:
            self._chunks.append(np.empty((_CHUNK, len(self._sheet.names))))
            self._used = 0
        cells = self._sheet.cells(row)
        self._chunks[-1][self._used] = cells
        self._used += 1
        if self._file is not None:
            self._settle()
            self._write(
                ",".join([repr(kind(value)) for kind, value in zip(self._sheet.kinds, cells, strict=True)]) + "\n"
            )

    def remark(self, line: str) -> None:
        """Write a line of comment, if there is a writable file."""
        if self._file is not None:
            self._write(f"# {line}\n")

    def _settle(self) -> None:
        """Replace the log by the draft, since there is a row."""
        draft, self._draft = self._draft, None
        if draft is None or self._target is None:
            return
        assert self._file is not None
        try:
            draft.chmod(self._target.stat().st_mode)
            os.close(self._file)  # Windows cannot rename an open file
            self._file = None
            os.replace(draft, self._target)
            self._file = _opened(self._target)
        except OSError as error:
            draft.unlink(missing_ok=True)
            raise CannotWrite(self._path, error) from None

    @property
    def columns(self) -> dict[str, Column]:
        """Rows so far, as columns (n,) by name."""
        names = self._sheet.names
        filled = [*self._chunks[:-1], *(chunk[: self._used] for chunk in self._chunks[-1:])]
        rows = np.concatenate([np.empty((0, len(names))), *filled])
        named = zip(names, rows.T.copy(), strict=True)
        return {name: column.astype(int) if name in INTEGERS else column for name, column in named}

    def _write(self, text: str) -> None:
        assert self._file is not None
        data, file = text.encode(), self._file
        try:
            while data:
                data = data[os.write(file, data) :]
        except OSError as error:
            self._file = None
            self._take_back(file, len(text.encode()) - len(data))
            raise CannotWrite(self._path, error) from None

    @staticmethod
    def _take_back(file: int, written: int) -> None:
        """Remove the beginning of a line that did not fit, and close the file."""
        if written:
            os.ftruncate(file, os.fstat(file).st_size - written)
        os.close(file)


def _beside(target: Path) -> Path:
    """Return a name for a draft in the folder of `target`."""
    return target.with_name(f".{target.stem[:64]}-{os.urandom(8).hex()}{target.suffix}")


def _opened(path: Path, more: int = 0) -> int:
    """Return the descriptor of a file; a pipe without a reader, or a full one, raises instead of blocking."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0) | getattr(os, "O_NONBLOCK", 0)
    return os.open(path, flags | more, 0o644)


class Lateness(NamedTuple):
    """Lateness of a loop's samples [s]."""

    median: float  # [s]
    p99: float  # 99 % of the samples began no later [s]
    worst: float  # [s]
    late: int  # samples that began later than a tenth of the sample time
    missed: int  # samples left out because they were over before they could begin
    samples: int

    @classmethod
    def of(cls, late: Array, missed: Array, dt: float) -> Self:
        """Return the statistics of samples of `dt` [s] with the lateness `late` (n,) [s] and counts `missed` (n,)."""
        if not late.size:
            return cls(0.0, 0.0, 0.0, 0, 0, 0)
        median, p99 = np.percentile(late, [50, 99]).tolist()
        return cls(median, p99, float(late.max()), int((late > dt / 10).sum()), int(missed.sum()), late.size)

    def __str__(self) -> str:
        return (
            f"lateness {1e3 * self.median:.3f} ms median, {1e3 * self.p99:.3f} ms for 99 %, {1e3 * self.worst:.2f} ms "
            f"at worst; {self.late} of {self.samples} samples late by over a tenth of one, {self.missed} missed"
        )
