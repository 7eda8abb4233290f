"""Record of a loop, sample by sample: in memory, and in a file that is always up to date.

The file is a CSV with a line per sample, written to the system at once and without buffering, so that the log of a
killed process is complete up to its last sample. If the disk is full, an incomplete line is removed. Units are SI, and
numbers are exact (`repr`), so that a log can be replayed; `NaN` is an unmeasured quantity.

An existing log is replaced only on request, and only by the first row: until then the head of the new log is in its own
file, which shows that the disk accepts it. A loop without a first row leaves no file behind.
"""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from allocator.calculus import Array
from allocator.errors import CannotWrite, InvalidInput
from allocator.files.atomic import check_writable
from mpc.bench.rows import INTEGERS, JOINT, Column, Row, Sheet

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
