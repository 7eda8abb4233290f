"""Trajectories and runs as CSV: degrees, bar and N·m/rad here, SI in the program."""

from collections.abc import Iterator
from importlib import resources
from itertools import pairwise
from math import isfinite
from pathlib import Path

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidFile
from allocator.records import records
from allocator.units import BAR, DEG
from allocator.writing import replacing
from mpc.reference import Reference
from mpc.simulation import Run

COLUMNS = ("t", "theta_deg", "stiffness")  # [s], [°], [N·m/rad]


def load(path: str | Path) -> Reference:
    """The trajectory in a CSV file with the columns t [s], theta_deg [°] and stiffness [N·m/rad], in any order.

    Raises `InvalidFile`, naming line and column, for whatever is not a trajectory.
    """
    samples = [(line, _sample(path, line, cells)) for line, cells in _records(path)]
    if len(samples) < 2:
        raise InvalidFile(path, f"a trajectory needs at least 2 samples, this file has {len(samples)}")
    for (_, (before, *_)), (line, (t, *_)) in pairwise(samples):
        if t <= before:
            raise InvalidFile(path, f"{t:g} s does not come after {before:g} s", line=line, column="t")
    t, theta, K = np.array([values for _, values in samples]).T
    return Reference(t, theta * DEG, K)


def default_trajectory() -> Reference:
    """The trajectory that ships with the package: ±40° at 0.5 Hz with K = 7.6 ± 0.3 N·m/rad at 0.25 Hz."""
    with resources.as_file(resources.files("mpc") / "data" / "default_trajectory.csv") as path:
        return load(path)


def save_reference(reference: Reference, path: str | Path) -> None:
    """Write a trajectory that `load` reads."""
    table = np.stack([reference.t, reference.theta / DEG, reference.K], axis=1)
    _write(path, COLUMNS, table, "%.10g")


def save_run(run: Run, path: str | Path) -> None:
    """Write a run, one line a sample; the commands of a line hold until the next (the last line repeats them)."""
    commands = np.vstack([run.u, run.u[-1:]])
    rungs = np.append(run.rung, run.rung[-1:])
    table = {
        "t": run.t,
        "theta_deg": run.theta / DEG,
        "theta_ref_deg": run.theta_ref / DEG,
        "omega_deg_per_s": run.x[:, 1] / DEG,
        "stiffness": run.K,
        "stiffness_ref": run.K_ref,
        "P1_bar": run.P[:, 0] / BAR,
        "P2_bar": run.P[:, 1] / BAR,
        "P1_command_bar": commands[:, 0] / BAR,
        "P2_command_bar": commands[:, 1] / BAR,
        "F1": run.forces[:, 0],
        "F2": run.forces[:, 1],
        "rung": rungs,
    }
    _write(path, tuple(table), np.stack(list(table.values()), axis=1), "%.9g")


def _write(path: str | Path, names: tuple[str, ...], table: Array, form: str) -> None:
    with replacing(path) as draft:
        np.savetxt(draft, table, fmt=form, delimiter=",", header=",".join(names), comments="")


def _records(path: str | Path) -> Iterator[tuple[int, dict[str, str]]]:
    """Line number and named cells of every line that is not blank."""
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InvalidFile(path, f"cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise InvalidFile(path, "is not a text file (UTF-8)") from None
    rows = records(path, enumerate(text.splitlines(), 1))
    names = [name.strip() for name in next(rows, (1, []))[1]]
    if not any(names):
        raise InvalidFile(path, f"is empty; the columns {','.join(COLUMNS)} are expected", line=1)
    for column in COLUMNS:
        if column not in names:
            raise InvalidFile(path, f"this column is missing; found: {','.join(names)}", line=1, column=column)
        if names.count(column) > 1:
            raise InvalidFile(path, "there are two columns of this name", line=1, column=column)
    for number, cells in rows:
        if not any(cell.strip() for cell in cells):
            continue
        if len(cells) != len(names):
            raise InvalidFile(path, f"has {len(cells)} cells, the header has {len(names)}", line=number)
        yield number, dict(zip(names, cells, strict=True))


def _sample(path: str | Path, line: int, cells: dict[str, str]) -> tuple[float, ...]:
    """t, theta_deg, stiffness of one line."""
    values = []
    for column in COLUMNS:
        try:
            value = float(cells[column])
        except ValueError:
            raise InvalidFile(path, f"{cells[column]!r} is not a number", line=line, column=column) from None
        if not isfinite(value):
            raise InvalidFile(path, f"{value} is not finite", line=line, column=column)
        values.append(value)
    if abs(values[1]) > 360:
        raise InvalidFile(path, f"{values[1]:g}° is over a turn", line=line, column="theta_deg")
    if values[2] <= 0:
        raise InvalidFile(path, f"{values[2]:g} N·m/rad has to be positive", line=line, column="stiffness")
    return tuple(values)


__all__ = ["COLUMNS", "default_trajectory", "load", "save_reference", "save_run"]
