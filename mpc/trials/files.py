"""Trajectories and runs as CSV: degrees, bar and N·m/rad here, SI in the program; and the trajectory of a command."""

from importlib import resources
from pathlib import Path

import numpy as np

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidFile, InvalidInput
from allocator.files.atomic import replacing
from allocator.files.csv_table import Table, read_table
from allocator.units import DEG
from mpc.model.plant import Plant
from mpc.trials.reference import Reference, sine
from mpc.trials.simulation import Run
from mpc.trials.trajectories import TRAJECTORIES, shrunk, usual_stiffness

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


def reference_called(name: str | None, K: float | None, plant: Plant) -> Reference:
    """Return the trajectory of this name or in this file, about the stiffness K [N·m/rad] if it is a standard one.

    Without a name it is the default trajectory where the plant has the report's joint, a sine elsewhere. Raises
    `InvalidInput`.
    """
    if name is None and K is None and plant.joint == Plant().joint:
        return default_trajectory()
    if name is None or name in TRAJECTORIES:
        middle = usual_stiffness(plant.joint) if K is None else float(checks.stiffness("stiffness", K))
        about = TRAJECTORIES[name].about if name else lambda K: sine(K=K)
        return shrunk(about, middle, plant.joint)
    if K is not None:
        raise InvalidInput("--stiffness goes with a standard trajectory; a file has its own")
    if Path(name).suffix or Path(name).exists():
        return load(name)
    raise InvalidInput(f"there is neither a standard trajectory nor a file {name}; there are {', '.join(TRAJECTORIES)}")
