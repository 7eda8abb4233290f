"""Trajectories and runs are kept as CSV: degrees, bar and N·m/rad here, SI in the program."""

from importlib import resources
from pathlib import Path

import numpy as np

from allocator.calculus import Array, Mask
from allocator.errors import InvalidFile
from allocator.files.atomic import replacing
from allocator.files.csv_table import Table, read_table
from allocator.units import DEG
from mpc.trials.reference import Reference
from mpc.trials.simulation import Run

COLUMNS = ("t", "theta_deg", "stiffness")  # [s], [°], [N·m/rad]


def load(path: str | Path) -> Reference:
    """Load the trajectory in a CSV file with the columns t [s], theta_deg [°] and stiffness [N·m/rad], in any order.

    Raises `InvalidFile`, naming line and column, for whatever is not a trajectory.
    """
    table = read_table(path)
    t, theta, K = (table.numbers(_place(table, column)) for column in COLUMNS)
    if t.size < 2:
        raise InvalidFile(path, f"a trajectory needs at least 2 samples, this file has {t.size}")
    _refuse(table, "t", np.diff(t, prepend=-np.inf) <= 0, t, "{:g} s does not come after the sample before")
    _refuse(table, "theta_deg", np.abs(theta) > 360, theta, "{:g}° is over a turn")
    _refuse(table, "stiffness", K <= 0, K, "{:g} N·m/rad has to be positive")
    return Reference(t, theta * DEG, K)


def default_trajectory() -> Reference:
    """Return the trajectory that ships with the package: ±40° at 0.5 Hz with K = 7.6 ± 0.3 N·m/rad at 0.25 Hz."""
    with resources.as_file(resources.files("mpc") / "data" / "default_trajectory.csv") as path:
        return load(path)


def save_reference(reference: Reference, path: str | Path) -> None:
    """Write a trajectory that `load` reads."""
    table = np.stack([reference.t, reference.theta / DEG, reference.K], axis=1)
    _write(path, COLUMNS, table, "%.10g")


def save_run(run: Run, path: str | Path) -> None:
    """Write a run, one line a sample; the commands of a line hold until the next (the last line repeats them)."""
    table = run.to_dict()
    _write(path, tuple(table), np.stack(list(table.values()), axis=1), "%.9g")


def _write(path: str | Path, names: tuple[str, ...], table: Array, form: str) -> None:
    with replacing(path) as draft:
        np.savetxt(draft, table, fmt=form, delimiter=",", header=",".join(names), comments="")


def _place(table: Table, column: str) -> int:
    """Return which column has this name."""
    if column not in table.names:
        found = ",".join(table.names)
        raise InvalidFile(table.path, f"this column is missing; found: {found}", line=1, column=column)
    if table.names.count(column) > 1:
        raise InvalidFile(table.path, "there are two columns of this name", line=1, column=column)
    return table.names.index(column)


def _refuse(table: Table, column: str, wrong: Mask, values: Array, sentence: str) -> None:
    """Raise `InvalidFile` at the first of the `values` that is marked `wrong`."""
    if wrong.any():
        i = int(np.argmax(wrong))
        raise InvalidFile(table.path, sentence.format(values[i]), line=table.lines[i], column=column)
