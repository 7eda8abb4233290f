"""Everything that happens in a loop is recorded, sample by sample: in memory, and in a file that is never behind.

The file is a CSV with a line a sample, written to the system at once and without a buffer of ours: what a killed
process has done can be read up to its last sample. Where the disk is full the line that did not fit is taken back. SI
units, numbers exact (`repr`), so that a log can be replayed; `NaN` is what was not measured.
"""

import os
from collections.abc import Sequence
from math import nan
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

import numpy as np

from allocator.calculus import Array
from allocator.errors import CannotWrite
from allocator.files.atomic import check_writable
from mpc.tracking.plan import Plan

_CHUNK = 4096  # rows


class Row(NamedTuple):
    """A row is a sample of a loop; SI units."""

    t: float  # [s] when it began, since the first one
    theta: float  # measured [rad]; NaN: no reading
    P1: float  # measured [Pa]
    P2: float  # measured [Pa]
    P1_command: float  # [Pa]
    P2_command: float  # [Pa]
    phase: int  # `Phase`
    missed: int  # samples that were left out before it
    late: float  # how long after its deadline it began [s]
    took: float  # from then until its command was sent [s]
    read_at: float = nan  # when the device says that it measured [s], since the first sample
    sent: int = 1  # whether the device took the command
    torque: float = 0.0  # of a weight that hangs on the joint, as far as is known [N·m]
    theta_ref: float = nan  # [rad]
    K_ref: float = nan  # [N·m/rad]
    theta_estimate: float = nan  # [rad]
    omega_estimate: float = nan  # [rad/s]
    P1_estimate: float = nan  # [Pa]
    P2_estimate: float = nan  # [Pa]
    d_estimate: float = nan  # disturbance torque [N·m]
    K_estimate: float = nan  # stiffness when the command begins to act, by the model [N·m/rad]
    rung: int = -1  # `mpc.tracking.plan.Rung`; -1: no plan
    status: int = -2  # `PlanStatus`; -2: no plan
    slack: float = 0.0  # predicted excursion from the joint range [rad]
    slack_force: float = 0.0  # predicted lack of muscle force [N]
    moved_theta: float = nan  # how far the controller moved what was asked [rad]
    moved_K: float = nan  # [N·m/rad]
    moved_T: float = nan  # [N·m]


UNITS = {
    "t": "s", "theta": "rad", "P1": "Pa", "P2": "Pa", "P1_command": "Pa", "P2_command": "Pa", "late": "s", "took": "s",
    "read_at": "s", "torque": "Nm", "theta_ref": "rad", "K_ref": "Nm/rad", "theta_estimate": "rad",
    "omega_estimate": "rad/s", "P1_estimate": "Pa", "P2_estimate": "Pa", "d_estimate": "Nm", "K_estimate": "Nm/rad",
    "slack": "rad", "slack_force": "N", "moved_theta": "rad", "moved_K": "Nm/rad", "moved_T": "Nm",
}  # fmt: skip
_KINDS = tuple(Row.__annotations__.values())  # a NumPy scalar has another `repr`
INTEGERS = frozenset(name for name, kind in Row.__annotations__.items() if kind is int)


def of_plan(plan: Plan) -> dict[str, Any]:
    """Return what a row says of a controller's plan."""
    moved = {} if plan.moved is None else {f"moved_{name}": value for name, value in plan.moved._asdict().items()}
    return {
        "K_estimate": float(plan.K[0]),
        "rung": int(plan.rung),
        "status": int(plan.status),
        "slack": plan.slack,
        "slack_force": plan.slack_force,
        **moved,
    }


def header(names: Sequence[str] = Row._fields) -> str:
    """Return the line of column names."""
    return ",".join(f"{name} [{UNITS[name]}]" if name in UNITS else name for name in names)


class Recorder:
    """A recorder keeps the rows of a loop, and writes them to the file `path` if one is given.

    Entered as a context, it opens the file. Raises `CannotWrite`.
    """

    def __init__(self, path: str | Path | None, about: Sequence[str] = ()) -> None:
        self._path, self._about = path, about
        self._file: int | None = None
        self._chunks: list[Array] = []
        self._used = _CHUNK  # rows of the last chunk

    def __enter__(self) -> Self:
        """Open the file and write its head."""
        if self._path is not None:
            check_writable(self._path)
            try:
                Path(self._path).absolute().parent.mkdir(parents=True, exist_ok=True)
                flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND | getattr(os, "O_BINARY", 0)
                self._file = os.open(self._path, flags, 0o644)
            except OSError as error:
                raise CannotWrite(self._path, error) from None
            self._write("".join(f"# {line}\n" for line in self._about) + header() + "\n")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Close the file."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def add(self, row: Row) -> None:
        """Keep a row. Raises `CannotWrite`; the file then ends with the row before, and nothing more goes into it."""
        if self._used == _CHUNK:
            self._chunks.append(np.empty((_CHUNK, len(Row._fields))))
            self._used = 0
        self._chunks[-1][self._used] = row
        self._used += 1
        if self._file is not None:
            self._write(",".join([repr(kind(value)) for kind, value in zip(_KINDS, row, strict=True)]) + "\n")

    def remark(self, line: str) -> None:
        """Write a line of comment, if there is a file that takes it."""
        if self._file is not None:
            self._write(f"# {line}\n")

    @property
    def columns(self) -> dict[str, Array]:
        """Return the rows so far as columns (n,) by name."""
        rows = np.concatenate([*self._chunks[:-1], self._chunks[-1][: self._used]]) if self._chunks else _NONE
        return {name: column.astype(int) if name in INTEGERS else column for name, column in _named(rows)}

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
        """Take back the beginning of a line that did not fit, and close the file."""
        if written:
            os.ftruncate(file, os.fstat(file).st_size - written)
        os.close(file)


_NONE = np.empty((0, len(Row._fields)))


def _named(rows: Array) -> list[tuple[str, Array]]:
    return list(zip(Row._fields, rows.T.copy(), strict=True))


__all__ = ["INTEGERS", "UNITS", "Recorder", "Row", "header", "of_plan"]
