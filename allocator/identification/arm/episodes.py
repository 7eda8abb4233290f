"""Episodes of a moving arm, and windows cut from them for free runs.

An episode is a stretch of rows at even times. A window is a free run: it begins at a measured state, after which a
model receives only the measured pressures.

`read_arm_log` reads logs of m joints. It finds columns by name and unit, numbered from 1, in any order; others are not
read:

    time [s, ms, us, ns, min]         s without a unit; also clock times
    q1, theta1, angle1 … [deg, rad]   angles of the m joints
    p1, pressure1 … [bar, kPa, …]     2 m pressures, measured; without a unit in any one unit
    v1, speed1 … [rad/s, deg/s]       speeds of the joints, optional

A gap of more than five rows ends an episode; times are evened within one.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidFile, InvalidInput
from allocator.files.csv_table import Table
from allocator.files.text import FilePath, short
from allocator.identification.columns import IGNORE, Column, Measured, complete, read_columns
from allocator.identification.headers import UNITS, unit_of
from allocator.identification.recording import even_times, evenly, in_time, without_spikes
from allocator.units import DEG

_BROKEN = 0.06  # [rad] between the step of an angle and that of its speed; more is a jump of the clock
LEAST_ROWS = 10
_SAME_STEP = 0.05


@dataclass(frozen=True)
class Episode:
    """Measured rows of an arm with m joints and k muscles at even times; `name` tells episodes apart."""

    q: Array  # angles (n, m) [rad]
    v: Array  # speeds (n, m) [rad/s]
    p: Array  # measured pressures (n, k), in any unit
    step: float  # between rows [s]
    name: str = ""

    @classmethod
    def checked(
        cls, q: ArrayLike, p: ArrayLike, step: float, *, v: ArrayLike | None = None, name: str = ""
    ) -> tuple[Self, ...]:
        """Return the stretches of these rows in which the angles follow the speeds.

        Parameters
        ----------
        q, p
            Angles (n, m) [rad] and measured pressures (n, k), any unit.
        step
            Time between rows [s].
        v
            Speeds (n, m) [rad/s]; by default differences of the angles, without cuts at jumps of the clock.
        name
            Name of the episode in errors and splits.

        Raises
        ------
        InvalidInput
            For arrays of other shapes, for numbers that are not finite, and for k other than 2 m.
        """
        q, p = np.atleast_2d(checks.real("q", q, "rad")), np.atleast_2d(checks.real("p", p, "any unit"))
        if q.ndim != 2 or p.ndim != 2 or len(q) != len(p) or p.shape[1] != 2 * q.shape[1] or not step > 0:
            raise InvalidInput(
                f"{name or 'episode'}: angles (n, m) and pressures (n, 2 m) at a positive step expected, not "
                f"{q.shape}, {p.shape} and {step:g} s"
            )
        if v is None:
            return (cls(q, np.diff(q, axis=0, prepend=q[:1]) / step, p, step, name),)
        v = np.atleast_2d(checks.real("v", v, "rad/s"))
        if v.shape != q.shape:
            raise InvalidInput(f"{name or 'episode'}: speeds {v.shape} for angles {q.shape}")
        whole = cls(q, v, p, step, name)
        return tuple(whole._part(i, j) for i, j in whole._stretches() if j - i >= LEAST_ROWS)

    def _stretches(self) -> list[tuple[int, int]]:
        error = np.diff(self.q, axis=0) - self.step * (self.v[1:] + self.v[:-1]) / 2
        cuts = np.flatnonzero(np.abs(error).max(axis=1) > _BROKEN) + 1
        return list(zip([0, *cuts.tolist()], [*cuts.tolist(), len(self.q)], strict=True))

    def _part(self, i: int, j: int) -> Self:
        return type(self)(self.q[i:j], self.v[i:j], self.p[i:j], self.step, self.name)


class Windows(NamedTuple):
    """Free runs of h steps: rows 0 and 1 are the past, row 1 is the measured state from which a run begins."""

    q: Array  # (w, h + 2, m) [rad]
    v: Array  # (w, h + 2, m) [rad/s]
    p: Array  # (w, h + 2, k)
    step: float  # [s]
    episode: NDArray[np.str_]  # names (w,)

    @classmethod
    def cut(cls, episodes: Sequence[Episode], steps: int, every: int, *, first: int = 8) -> Self:
        """Return the windows of `steps` steps that begin at row `first` of every stretch and `every` rows later.

        Raises `InvalidInput` if no episode is long enough, and for episodes of different arms or steps.
        """
        for e in episodes:
            if e.q.shape[1] != episodes[0].q.shape[1] or abs(e.step / episodes[0].step - 1) > _SAME_STEP:
                raise InvalidInput(
                    f"{e.name} has {e.q.shape[1]} joints and rows {e.step:g} s apart, {episodes[0].name} has "
                    f"{episodes[0].q.shape[1]} and {episodes[0].step:g} s: episodes of one arm at one rate expected"
                )
        found = [(e, i) for e in episodes for i in range(first, len(e.q) - steps, every)]
        if not found:
            raise InvalidInput(f"no episode has the {first + steps + 1} rows that a free run of {steps} steps needs")
        rows = [np.stack([getattr(e, part)[i - 1 : i + steps + 1] for e, i in found]) for part in ("q", "v", "p")]
        return cls(rows[0], rows[1], rows[2], found[0][0].step, np.array([e.name for e, _ in found]))

    def only(self, keep: NDArray[np.bool_]) -> Self:
        """Return the windows (w,) to keep."""
        return self._replace(q=self.q[keep], v=self.v[keep], p=self.p[keep], episode=self.episode[keep])

    @property
    def future(self) -> Array:
        """Measured angles (w, h, m) [rad] after the beginning of the run."""
        return self.q[:, 2:]

    @property
    def horizon(self) -> int:
        """Number of steps of a run."""
        return int(self.q.shape[1]) - 2


_NAME = re.compile(r"([^\W\d_]+)[\s_]*(\d+)[\s_(\[/]*(.*?)[\s)\]]*")
_WORDS = {"theta": "q theta θ phi φ angle winkel", "pressure": "p pressure druck", "speed": "v omega ω speed velocity"}
_KINDS = {word: kind for kind, words in _WORDS.items() for word in words.split()}
_UNITS = {
    "theta": UNITS["theta"],
    "pressure": UNITS["pressure"] | {"": 1.0},
    "speed": {"rad/s": 1.0, "deg/s": DEG},
}
_GAP = 5.5  # usual steps


class ArmLog(NamedTuple):
    """Episodes of one arm, and sentences about data not read or left out."""

    episodes: tuple[Episode, ...]
    notes: tuple[str, ...]


def read_arm_log(
    path: FilePath | Sequence[FilePath],
    columns: Mapping[str, str] | None = None,
    *,
    skip_rows: int = 0,
    topics: str | None = None,
) -> ArmLog:
    """Read the log of a moving arm from one file or several; an episode is a file, or a stretch between gaps in it.

    `columns` assigns columns with other names: ``{"theta1": "elbow:deg", "pressure1": "biceps:bar"}``. `skip_rows`
    lines are skipped at the beginning of a file. Rows with a missing reading, a spike, or a drop-out of a pressure are
    replaced by interpolation. `topics` maps quantities to numbers of a ROS bag or an MCAP file:
    ``"theta1=/joint_states.position[0] pressure1=/valves.data[0]:bar …"``.

    Raises `InvalidFile`, with line and column if applicable.
    """
    paths = short(path)
    logs = {name: _read(one, dict(columns or {}), skip_rows, topics) for name, one in paths.items()}
    notes = tuple(f"{name}: {note}" if len(logs) > 1 else note for name, log in logs.items() for note in log.notes)
    return ArmLog(tuple(episode for log in logs.values() for episode in log.episodes), notes)


def _read(path: FilePath, columns: dict[str, str], skip_rows: int, topics: str | None) -> ArmLog:
    ignored = columns.get(IGNORE, "")
    own = {name: columns.pop(name) for name in list(columns) if _NAME.fullmatch(name)}
    timed = read_columns(path, (("time",),), columns=columns, skip_rows=skip_rows, topics=topics)
    found = _columns(timed.table, own, [name.strip() for name in ignored.split(";")])
    numbers = {name: timed.table.numbers(c.place, gaps=True) * c.scale for name, c in found.items()}
    notes = tuple(note for note in timed.notes if not note.startswith("columns not used"))
    measured = Measured(timed.table, {**timed.columns, **found}, {**timed.values, **numbers}, notes)
    measured = without_spikes(in_time(complete(measured)))
    episodes = _episodes(measured, Path(path).stem)
    if not episodes:
        raise InvalidFile(path, f"has no stretch of {LEAST_ROWS} rows without a gap")
    return ArmLog(episodes, measured.notes)


def _columns(table: Table, own: Mapping[str, str], ignored: Sequence[str]) -> dict[str, Column]:
    """Return the columns of all angles, pressures and speeds by quantity and number, in this order.

    Those of the caller (`own`) replace others of the same quantity. Names with further words (`q1_ref`) are others.
    """
    told: dict[int, str] = {}
    for quantity, text in own.items():
        name, _, unit = text.rpartition(":") if ":" in text else (text, "", "")
        if name not in table.names:
            raise InvalidInput(f"columns: there is no column {name!r} in {table.path}, only {', '.join(table.names)}")
        told[table.names.index(name)] = f"{quantity} [{unit}]"
    others = {i: name for i, name in enumerate(table.names) if name not in ignored and i not in told}
    found: dict[str, Column] = {}
    strange: list[InvalidFile] = []
    for place, name in (told | others).items():
        if (match := _NAME.fullmatch(name.strip())) is None or (kind := _KINDS.get(match[1].casefold())) is None:
            continue
        quantity, unit, column = f"{kind}{int(match[2])}", _unit(kind, match[3]), table.names[place]
        if unit not in _UNITS[kind]:
            said = f"an unknown unit {match[3]!r}" if match[3] else "no unit"
            known = ", ".join(word for word in _UNITS[kind] if word)
            strange.append(InvalidFile(table.path, f"has {said}; known are {known}", column=column))
        elif quantity not in found:
            found[quantity] = Column(place, column, quantity, unit, _UNITS[kind][unit], 0.0, True)
        elif found[quantity].place not in told:
            sentence = f'gives {quantity} again: leave one out by --columns "{IGNORE}={column}"'
            raise InvalidFile(table.path, sentence, column=column)
    return _counted(table, found, strange)


def _unit(kind: str, text: str) -> str:
    text = text.replace("_", "/")
    return f"{unit_of(text.removesuffix('/s'))[0]}/s" if kind == "speed" else unit_of(text)[0] if text else ""


def _counted(table: Table, found: Mapping[str, Column], strange: Sequence[InvalidFile]) -> dict[str, Column]:
    """Return the columns in the order of their numbers. Raises `InvalidFile` if one is missing, first of `strange`."""
    m = sum(name.startswith("theta") for name in found)
    wanted = [f"theta{i + 1}" for i in range(max(m, 1))] + [f"pressure{i + 1}" for i in range(2 * max(m, 1))]
    missing = [name for name in wanted if name not in found]
    extra = [name for name in found if name.startswith("pressure") and name not in wanted]
    if (missing or extra) and strange:
        raise strange[0]
    if missing:
        have = ", ".join(name for name in table.names if name)
        what = f"has no column for {', '.join(missing)} among {have}: two pressures are needed for every angle"
        raise InvalidFile(table.path, f"{what}; name them such as q1 [deg], p1 [bar], p2 [bar], or use --columns")
    speeds = [f"speed{i + 1}" for i in range(m)]
    order = [*wanted, *speeds] if all(name in found for name in speeds) else wanted
    if extra:
        raise InvalidFile(table.path, f"has {2 * m + len(extra)} pressures for {m} joints, two each are needed")
    if len({found[name].unit == "" for name in wanted[m:]}) > 1:
        raise InvalidFile(table.path, "gives some pressures with a unit and others without")
    return {name: found[name] for name in order}


def _episodes(measured: Measured, name: str) -> tuple[Episode, ...]:
    t = measured.values["time"]
    if t.size < LEAST_ROWS:
        return ()
    step = float(np.median(np.diff(t)))
    parts = np.split(np.arange(t.size), np.flatnonzero(np.diff(t) > _GAP * step) + 1)
    episodes = [_even(measured, part, step, f"{name}, stretch {k}" if len(parts) > 1 else name)
                for k, part in enumerate(parts, 1) if part.size >= LEAST_ROWS]  # fmt: skip
    return tuple(one for episode in episodes for one in episode)


def _even(measured: Measured, rows: NDArray[np.intp], step: float, name: str) -> tuple[Episode, ...]:
    t = measured.values["time"][rows]
    times = t if evenly(t) else even_times(t, step)
    m = sum(quantity.startswith("theta") for quantity in measured.values)

    def of(kind: str, count: int) -> Array:
        return np.stack([np.interp(times, t, measured.values[f"{kind}{i + 1}"][rows]) for i in range(count)], axis=1)

    v = of("speed", m) if "speed1" in measured.values else None
    return Episode.checked(of("theta", m), of("pressure", 2 * m), step, v=v, name=name)
