"""Measured equilibria of a CSV file, or of the steady parts of a raw log.

Columns by name and unit as for `read_samples` (`phi [deg]`, `P1_bar`, …), in any order; others are listed in the notes,
and refused if their unit is a torque:

    theta [deg, rad]            pressure1, pressure2 [bar, mbar, kPa, MPa, Pa, psi], gauge
    torque [Nm, lbf in, …]      of the weight, positive where it pulls θ down; 0 without this column
    direction                   +1 where θ was rising into the equilibrium, -1 falling, 0 not known; also up, down
    sweep                       instead of it: a number whose direction the caller gives
    slack                       of a sag test: 1 where the cable of the agonist just went slack, 2 of the antagonist,
                                3 both, 0 in rows that are equilibria
    rest_length [mm, m]         of the muscles, where samples of several lengths are in one file
    time [s, ms, us, ns, min]   makes the file a raw log, of which the steady parts are used; s without a unit; also
                                clock times (12:03:04.567, ISO 8601)

A row of a raw log is steady if over the second before it neither pressure moved by more than 0.05 bar nor the angle by
more than 0.3°. Every uninterrupted run of steady rows is one equilibrium, with the means of the run's last second; its
direction is the sign of the change of θ since the previous equilibrium, 0 if less than 0.3° or across a gap of more
than a second.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from allocator.errors import InvalidFile, InvalidInput
from allocator.files.text import FilePath
from allocator.identification.columns import Measured, read_columns
from allocator.identification.recording import in_time, stretches, without_spikes
from allocator.units import BAR, DEG

_WINDOW = 1.0  # [s]
_STILL_PRESSURE = 0.05 * BAR
_STILL_ANGLE = 0.3 * DEG
_MOST_STEP = 0.5  # [s] between samples
_WANTED = (("theta",), ("pressure1",), ("pressure2",))
_GIVEN = {"theta": "theta", "P1": "pressure1", "P2": "pressure2"}
_OPTIONAL = ("torque", "direction", "sweep", "slack", "rest_length", "time")


class JointLog(NamedTuple):
    """Equilibria in SI units, arrays (n,), and counts of rows left out of the file."""

    theta: Array
    P1: Array
    P2: Array
    torque: Array
    direction: Array
    rest_length: Array | None  # [m]
    rows: int  # of the file
    used: int  # rows used in equilibria
    slack: Array | None = None  # 1, 2 or 3: a row of a sag test, see `fit_joint`; None without such rows
    notes: tuple[str, ...] = ()  # sentences about data not read or left out
    files: tuple[str, ...] = ()  # name of the file of each equilibrium, if there are several

    @property
    def dropped_share(self) -> float:
        """Return the share of the rows that was not steady."""
        return 1 - self.used / self.rows


def read_joint_log(
    path: FilePath,
    sweeps: Mapping[float, float] | None = None,
    columns: Mapping[str, str] | None = None,
    *,
    skip_rows: int = 0,
    topics: str | None = None,
) -> JointLog:
    """Read equilibria; `sweeps` gives the direction (+1, -1) of each number in the column `sweep`.

    `columns` assigns columns with unclear names: ``{"theta": "phi:deg", "pressure1": "p1:bar"}``.

    `skip_rows` lines are skipped at the beginning of the file. Rows of a raw log with a missing reading, a spike, or a
    drop-out of a pressure are left out. `topics` assigns numbers of a ROS bag or an MCAP file, see `read_motion_log`.
    `JointLog.notes` lists the unused rows.

    Raises `InvalidFile`, with line and column, for unreadable contents.
    """
    measured = read_columns(path, _WANTED, _OPTIONAL, columns, skip_rows=skip_rows, topics=topics)
    if "time" in measured.values:
        measured = without_spikes(in_time(measured))
    values, rows = measured.values, measured.values["theta"].size
    given: dict[str, Array] = {name: values[quantity] for name, quantity in _GIVEN.items()}
    given["torque"] = values.get("torque", np.zeros(rows))
    if "time" in values:
        return _rests(measured, given)
    way, slack, lengths = _directions(measured, sweeps or {}), _slack(measured), values.get("rest_length")
    return JointLog(
        **given, direction=way, rest_length=lengths, rows=rows, used=rows, slack=slack, notes=measured.notes, files=()
    )


def joined_logs(logs: Mapping[str, JointLog]) -> JointLog:
    """Return the logs of one joint, by the names of their files, as one; each begins without memory.

    Raises `InvalidInput` if only some of them have rest lengths.
    """
    if len(logs) == 1:
        return next(iter(logs.values()))
    every = tuple(logs.values())
    lengths = [log.rest_length for log in every if log.rest_length is not None]
    if lengths and len(lengths) < len(every):
        raise InvalidInput("some of the files have a column of rest lengths, others not: give it in all, or in none")
    slack = [np.zeros(log.theta.size) if log.slack is None else log.slack for log in every]
    theta, P1, P2, torque, way = (
        np.concatenate([getattr(log, name) for log in every]) for name in ("theta", "P1", "P2", "torque", "direction")
    )
    return JointLog(
        theta, P1, P2, torque, way,
        np.concatenate(lengths) if lengths else None,
        sum(log.rows for log in every),
        sum(log.used for log in every),
        None if all(log.slack is None for log in every) else np.concatenate(slack),
        tuple(f"{name}: {note}" for name, log in logs.items() for note in log.notes),
        tuple(name for name, log in logs.items() for _ in range(log.theta.size)),
    )  # fmt: skip


def _rests(measured: Measured, given: Mapping[str, Array]) -> JointLog:
    """Return the means of the steady runs of a raw log; `given` are its rows (n,) by the names in `JointLog`."""
    t, lengths = measured.values["time"], measured.values.get("rest_length")
    if (marked := _slack(measured)) is not None and marked.any():
        raise measured.mistake(
            "slack", "a raw log holds no sag test: give its rows without a time", int(marked.argmax())
        )
    step = float(np.median(np.diff(t))) if t.size > 1 else _MOST_STEP
    if step > _MOST_STEP:
        raise measured.mistake("time", f"samples are {step:g} s apart, too far to see what rests")
    parts = [
        [part.start + run for run in steady_runs(t[part], *(given[name][part] for name in ("theta", "P1", "P2")))]
        for part in stretches(t)
    ]
    runs = [run for part in parts for run in part]
    if not runs:
        raise InvalidFile(measured.table.path, "never is steady for a second: hold the pressures until the angle rests")
    means = {name: np.array([a[run].mean() for run in runs]) for name, a in given.items()}
    ways = []
    for part in parts:
        rests = np.array([given["theta"][run].mean() for run in part])
        turned = np.diff(rests, prepend=rests[:1])
        ways.append(np.where(np.abs(turned) < _STILL_ANGLE, 0.0, np.sign(turned)))
    used = int(np.unique(np.concatenate(runs)).size)
    lengths = None if lengths is None else np.array([lengths[run[-1]] for run in runs])
    way = np.concatenate(ways)
    return JointLog(**means, direction=way, rest_length=lengths, rows=t.size, used=used, notes=measured.notes, files=())


def steady_runs(time: Array, theta: Array, P1: Array, P2: Array) -> list[NDArray[np.intp]]:
    """Return the row indices of the last second of every steady run."""
    step = float(np.median(np.diff(time))) if time.size > 1 else _WINDOW
    width = max(2, round(_WINDOW / step) + 1)
    if not step > 0 or time.size < width:
        return []
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    still = np.ones(time.size - width + 1, bool)
    for quantity, limit in ((theta, _STILL_ANGLE), (P1, _STILL_PRESSURE), (P2, _STILL_PRESSURE)):
        moved = maximum_filter1d(quantity, width) - minimum_filter1d(quantity, width)
        still &= moved[width // 2 :][: still.size] <= limit  # the filters are centred
    ends = np.flatnonzero(np.diff(np.concatenate([still, [False]]).astype(int)) == -1)  # the last window of each run
    return [np.arange(end, end + width) for end in ends]


def _codes(measured: Measured, quantity: str, known: tuple[int, ...], sentence: str) -> Array | None:
    """Return the column (n,) of these numbers, or None; refuse any other number."""
    codes = measured.values.get(quantity)
    if codes is not None and (wrong := ~np.isin(codes, known)).any():
        raise measured.mistake(quantity, f"has to be {sentence}", int(np.argmax(wrong)))
    return codes


def _slack(measured: Measured) -> Array | None:
    codes = "1 (the agonist goes slack), 2 (the antagonist), 3 (both) or 0 (an equilibrium)"
    return _codes(measured, "slack", (0, 1, 2, 3), codes)


def _directions(measured: Measured, sweeps: Mapping[float, float]) -> Array:
    values = measured.values
    way = _codes(measured, "direction", (-1, 0, 1), "+1 (rising), -1 (falling) or 0 (not known)")
    if way is not None:
        return way
    if not sweeps:
        return np.zeros(values["theta"].size)
    if "sweep" not in values:
        raise InvalidFile(measured.table.path, "has no column 'sweep', whose directions were given")
    if unknown := sorted(set(values["sweep"].tolist()) - set(sweeps)):
        raise measured.mistake("sweep", f"no direction is given for the sweep {unknown[0]:g}")
    return np.array([sweeps[number] for number in values["sweep"].tolist()])
