"""Logs of arms: the sample that is shipped, folders of one's own, and the splits."""

import csv
import gzip
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from allocator.errors import InvalidFile
from allocator.identification.arm.episodes import Episode, Windows

SAMPLE = Path(__file__).parent / "data" / "mpi_arm.csv.gz"
HORIZON = 40  # samples of a free run
LAGS = 3  # rows of the past that models of one step may use
_FIRST, _EVERY = 8, 10  # rows at which the free runs of an episode begin
_STEP = 0.0104  # [s]
_SPEED = 10.0  # [rad/s], unit of the sample's speeds
_STALE = 1  # first rows, which are readings of before


def mpi_arm(path: Path = SAMPLE) -> list[Episode]:
    """Return the episodes of the arm of MPI-IS in the order of time, cut where its clock jumps."""
    with gzip.open(path, "rt", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    names, table = np.array([row[0] for row in rows[1:]]), np.array([row[2:] for row in rows[1:]], float)
    episodes: list[Episode] = []
    for name in dict.fromkeys(names.tolist()):
        one = table[names == name][_STALE:]
        episodes += Episode.checked(one[:, :4], one[:, 8:16], _STEP, v=one[:, 4:8] * _SPEED, name=name)
    return episodes


def folder(path: Path) -> list[Episode]:
    """Return the episodes of a folder of CSV files, one an episode, in the order of their names.

    Columns: `time_s`; `q1_rad` or `q1_deg` …; as many pairs of pressures `p1`, `p2` … in any unit; speeds `v1_rad_s` …
    are optional. Raises `InvalidFile` for a folder without files and for files without these columns.
    """
    files = sorted(path.glob("*.csv"))
    if not files:
        raise InvalidFile(path, "no *.csv in this folder: one file an episode, columns time_s, q1_rad …, p1, p2 …")
    return [part for file in files for part in _episode(file)]


def _episode(path: Path) -> tuple[Episode, ...]:
    with path.open(encoding="utf-8") as file:
        header, *rows = csv.reader(line for line in file if not line.startswith("#"))
    columns = dict(zip((name.strip() for name in header), np.array(rows, float).T, strict=True))
    joints = [i for i in range(1, len(header)) if f"q{i}_rad" in columns or f"q{i}_deg" in columns]
    wanted = [f"p{i}" for i in range(1, 2 * len(joints) + 1)]
    missing = [name for name in ("time_s", *wanted) if name not in columns]
    if missing or not joints:
        raise InvalidFile(path, f"columns {', '.join(missing or ['q1_rad'])} expected, found {', '.join(columns)}")
    q = [columns[f"q{i}_rad"] if f"q{i}_rad" in columns else np.radians(columns[f"q{i}_deg"]) for i in joints]
    speeds = [columns[f"v{i}_rad_s"] for i in joints if f"v{i}_rad_s" in columns]
    step = float(np.median(np.diff(columns["time_s"])))
    pressures = np.stack([columns[name] for name in wanted], axis=1)
    v = np.stack(speeds, axis=1) if len(speeds) == len(joints) else None
    return Episode.checked(np.stack(q, axis=1), pressures, step, v=v, name=path.stem)


def splits(episodes: Sequence[Episode]) -> dict[str, NDArray[np.bool_]]:
    """Return which stretches are held out: those of every fifth episode, and those of the last fifth in time."""
    names = list(dict.fromkeys(e.name for e in episodes))
    place = np.array([names.index(e.name) for e in episodes])
    return {"every fifth episode": place % 5 == 0, "last fifth in time": place >= 0.8 * len(names)}


def windows_of(episodes: Sequence[Episode]) -> tuple[Windows, Array, Array]:
    """Return the free runs of these episodes, and the angles (w, lags, m) and pressures (w, lags, k) before them."""
    starts = [(e, i) for e in episodes for i in range(_FIRST, len(e.q) - HORIZON, _EVERY)]
    q, p = (np.stack([getattr(e, part)[i - LAGS + 1 : i + 1] for e, i in starts]) for part in ("q", "p"))
    return Windows.cut(episodes, HORIZON, _EVERY, first=_FIRST), q, p
