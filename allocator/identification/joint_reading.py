"""Measured equilibria from a CSV file, or picked out of a raw time log.

Columns by name and unit as for `read_samples`, in any order, others are ignored:

    theta_deg | theta_rad       pressure1_bar, pressure2_bar (or _kpa, _mpa, _psi, _pa; gauge)
    torque_Nm                   of the weight, positive where it pulls θ down; 0 without this column
    direction                   +1 where θ was rising into the equilibrium, -1 falling, 0 not known
    sweep                       instead of it: a number whose direction the caller gives
    rest_length_mm | rest_length_m      of the muscles, where samples of several lengths are in one file
    time_s | time_ms            makes the file a raw log, of which the steady parts are used

Of a raw log a row is steady if over the second before it neither pressure moved by more than 0.05 bar nor the angle by
more than 0.3°. Every uninterrupted run of steady rows is one equilibrium, its values the means of the run's last
second; its direction is the sign of the way that θ came since the equilibrium before, 0 if less than 0.3°.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from allocator.errors import InvalidFile
from allocator.identification.reading import FilePath, Table, find_column, quantity_of, read_table
from allocator.units import BAR, DEG

_WINDOW = 1.0  # [s]
_STILL_PRESSURE = 0.05 * BAR
_STILL_ANGLE = 0.3 * DEG


class JointLog(NamedTuple):
    """Equilibria in SI units, arrays (n,), and what was left out of the file."""

    theta: Array
    P1: Array
    P2: Array
    torque: Array
    direction: Array
    rest_length: Array | None  # [m]
    rows: int  # of the file
    used: int  # rows that went into an equilibrium

    @property
    def dropped_share(self) -> float:
        """Share of the rows that was not steady."""
        return 1 - self.used / self.rows


def read_joint_log(path: FilePath, sweeps: Mapping[float, float] | None = None) -> JointLog:
    """Read equilibria; `sweeps` gives the direction (+1, -1) of each number in the column `sweep`.

    Raises `InvalidFile`, with line and column, at anything that cannot be read.
    """
    table = read_table(path)
    columns = {
        "theta": quantity_of(path, table, "theta"),
        "P1": quantity_of(path, table, "pressure1"),
        "P2": quantity_of(path, table, "pressure2"),
        "torque": _optional(path, table, "torque"),
    }
    rows = columns["theta"].size
    lengths = quantity_of(path, table, "rest_length") if _has(path, table, "rest_length") else None
    if _has(path, table, "time"):
        runs = steady_runs(quantity_of(path, table, "time"), columns["theta"], columns["P1"], columns["P2"])
        if not runs:
            raise InvalidFile(path, "never is steady for a second: hold the pressures until the angle rests")
        means = {name: np.array([a[run].mean() for run in runs]) for name, a in columns.items()}
        lengths = None if lengths is None else np.array([lengths[run[-1]] for run in runs])
        return JointLog(**means, direction=_ways(means["theta"]), rest_length=lengths, rows=rows, used=_rows(runs))
    return JointLog(
        **columns, direction=_directions(path, table, sweeps or {}), rest_length=lengths, rows=rows, used=rows
    )


def steady_runs(time: Array, theta: Array, P1: Array, P2: Array) -> list[NDArray[np.intp]]:
    """Row indices of the last second of every steady run."""
    step = float(np.median(np.diff(time))) if time.size > 1 else _WINDOW
    width = max(2, round(_WINDOW / step) + 1)
    if not step > 0 or time.size < width:
        return []
    still = np.ones(time.size - width + 1, bool)
    for quantity, limit in ((theta, _STILL_ANGLE), (P1, _STILL_PRESSURE), (P2, _STILL_PRESSURE)):
        still &= np.ptp(np.lib.stride_tricks.sliding_window_view(quantity, width), axis=1) <= limit
    ends = np.flatnonzero(np.diff(np.concatenate([still, [False]]).astype(int)) == -1)  # the last window of each run
    return [np.arange(end, end + width) for end in ends]


def _rows(runs: list[NDArray[np.intp]]) -> int:
    return int(np.unique(np.concatenate(runs)).size)


def _ways(theta: Array) -> Array:
    way = np.diff(theta, prepend=theta[:1])
    return np.where(np.abs(way) < _STILL_ANGLE, 0.0, np.sign(way))


def _directions(path: FilePath, table: Table, sweeps: Mapping[float, float]) -> Array:
    if _has(path, table, "direction"):
        way = quantity_of(path, table, "direction")
        if not np.isin(way, (-1, 0, 1)).all():
            raise InvalidFile(path, "has to be +1 (rising), -1 (falling) or 0 (not known)", column="direction")
        return way
    if not sweeps:
        return np.zeros(len(table.rows))
    numbers = quantity_of(path, table, "sweep")
    if unknown := sorted(set(numbers.tolist()) - set(sweeps)):
        raise InvalidFile(path, f"no direction is given for the sweep {unknown[0]:g}", column="sweep")
    return np.array([sweeps[number] for number in numbers.tolist()])


def _has(path: FilePath, table: Table, quantity: str) -> bool:
    return find_column(path, table, quantity) is not None


def _optional(path: FilePath, table: Table, quantity: str) -> Array:
    return quantity_of(path, table, quantity) if _has(path, table, quantity) else np.zeros(len(table.rows))


__all__ = ["JointLog", "read_joint_log", "steady_runs"]
