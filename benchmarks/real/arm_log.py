"""Logs of arms: the sample that is shipped, folders of one's own, and the splits."""

import csv
import gzip
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from allocator.errors import InvalidFile
from allocator.identification.arm.episodes import Episode, Windows, read_arm_log

SAMPLE = Path(__file__).parent / "data" / "mpi_arm.csv.gz"
HORIZON = 40  # samples of a free run
LAGS = 3  # rows of the past that models of one step may use
_FIRST, _EVERY = 8, 10  # rows at which the free runs of an episode begin
_STEP = 0.0104  # [s]
_SPEED = 10.0  # [rad/s], unit of the sample's speeds
_LEAST_FILES = 10
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
    """Return the episodes of a folder of CSV files, one an episode, in the order of their names, see `read_arm_log`.

    Raises `InvalidFile` for a folder without enough files and for files that are no logs of an arm.
    """
    files = sorted(path.glob("*.csv"))
    if len(files) < _LEAST_FILES:
        what = f"{len(files)} *.csv in this folder, {_LEAST_FILES} or more are needed"
        raise InvalidFile(path, f"{what}: one an episode, columns time [s], q1 [deg] …, p1, p2 …")
    return [replace(part, name=file.stem) for file in files for part in read_arm_log(file).episodes]


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
