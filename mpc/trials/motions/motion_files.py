"""Motions of several joints from CSV files: angles of the joints or the path of the hand, each with a stiffness matrix.

| columns | meaning |
|---|---|
| `t` | time [s] |
| `joint_1_deg`, … | the angles [°], named as the machine names its joints, blanks as `_`; or |
| `x_mm`, `y_mm`, … | the path of the hand [mm] |
| `K11`, `K12`, `K22`, … | stiffness of the joints [N·m/rad]; `Kx11`, … [N/m] if that of the hand is tracked |

Entries off the diagonal are 0 without a column. Without any stiffness, it is the usual one of the machine.

Names may have other units: `Zeit [ms]`, `x [m]`, `elbow (rad)`, `K11 [N·m/rad]`. A time without a unit is in seconds, a
stiffness without one in the unit of the motion; angles and positions need a unit.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidFile, InvalidInput, notice
from allocator.files.csv_table import Table, read_table
from allocator.identification.headers import UNITS, is_unit, quantity_named, unit_of
from allocator.mechanism.endpoint import Endpoint
from allocator.units import DEG, MM
from mpc.model.arm.model import Arm
from mpc.model.arm.ranges import OutOfReach, followed
from mpc.trials.motions.arm_trajectories import tracked_stiffness, usual_stiffness
from mpc.trials.motions.reference import Reference

JOINT_STIFFNESS, HAND_STIFFNESS = "N·m/rad", "N/m"
_FACTORS: Mapping[str, Mapping[str, float]] = {  # of the units that may stand in place of one
    "s": UNITS["time"],
    "deg": {unit: factor / DEG for unit, factor in UNITS["theta"].items()},
    "mm": {unit: factor / MM for unit, factor in UNITS["length"].items()},
    JOINT_STIFFNESS: {"": 1.0, "Nm/rad": 1.0, "Nm/deg": 1 / DEG, "Nm/°": 1 / DEG},
    HAND_STIFFNESS: {"": 1.0, "N/m": 1.0, "N/mm": 1e3},
}
_ALIASES = {"t": "time", "theta": "theta"}  # names with synonyms in several languages
_SYNONYMS = {"stiffness": ("k", "steifigkeit", "drehsteifigkeit", "raideur")}
_NAME = re.compile(r"(.+?)(?:\s*[\[(](.*)[\])]|_([^\W_]+))?\s*")


class UnusedColumns(UserWarning):
    """Warning that a motion's file has columns that are not read."""


@dataclass(frozen=True)
class MotionColumns:
    """Table of a motion, and the columns that were found in it."""

    table: Table
    found: Mapping[str, tuple[int, float]]  # place and factor of each column, by its usual name

    @classmethod
    def read(cls, path: str | Path, wanted: Mapping[str, str]) -> Self:
        """Read the table in `path`, and find the columns `wanted`, usual names with their units.

        Raises `InvalidFile` for a unit that is missing or unknown, and for a column that is there twice.
        """
        table, found = read_table(path, is_unit=is_unit), {}
        for place, header in enumerate(table.names):
            for name, unit in wanted.items():
                factor = _factor(table, header, name, unit)
                if factor is None:
                    continue
                if name in found:
                    raise InvalidFile(path, f"there are two columns of {name}", line=table.names_line, column=header)
                found[name] = place, factor
        return cls(table, found)

    def tell_unused(self) -> None:
        """Warn with `UnusedColumns` if there are other columns."""
        read = {place for place, _ in self.found.values()}
        if others := [name for i, name in enumerate(self.table.names) if name and i not in read]:
            notice(f"{self.table.path}: columns not used: {', '.join(others)}", UnusedColumns)

    def numbers(self, name: str) -> Array:
        """Return the numbers (M,) of a column in its usual unit. Raises `InvalidFile` if there is none."""
        if name not in self.found:
            there = ", ".join(self.table.names)
            raise InvalidFile(
                self.table.path, f"this column is missing; found: {there}", line=self.table.names_line, column=name
            )
        place, factor = self.found[name]
        return self.table.numbers(place) * factor

    def refuse(self, name: str, wrong: Mask, values: Array, sentence: str) -> None:
        """Raise `InvalidFile` at the first of the `values` of a column that are marked `wrong`."""
        if wrong.any():
            i = int(np.argmax(wrong))
            column = self.table.names[self.found[name][0]] if name in self.found else name
            raise InvalidFile(self.table.path, sentence.format(values[i]), line=self.table.lines[i], column=column)


def _factor(table: Table, header: str, name: str, unit: str) -> float | None:
    """Return the factor from the unit in a `header` to the `unit` of the column `name`; None for another column."""
    if header == name:
        return 1.0
    match = _NAME.fullmatch(header)
    if match is None or not _is_called(match[1], name.removesuffix(f"_{unit}")):
        return None
    known, own = _FACTORS[unit], match[2] or match[3] or ""
    spelled = re.sub(r"[\s·⋅*.]", "", own) if "/" in unit else unit_of(own)[0] if own else ""
    if spelled not in known and match[3]:
        return None  # a further word, as in theta_ref
    if spelled not in known:
        fault = f"the unit {own!r} is unknown" if own else "has no unit"
        raise InvalidFile(
            table.path, f"{fault}; known are {', '.join(filter(None, known))}", line=table.names_line, column=header
        )
    return known[spelled]


def _is_called(said: str, base: str) -> bool:
    quantity = _ALIASES.get(base)
    return _plain(said) in (_plain(base), *_SYNONYMS.get(base, ())) or (
        quantity is not None and quantity_named(said) == quantity
    )


def _plain(name: str) -> str:
    return re.sub(r"\s+", "_", name.strip()).casefold()


_ROUNDING = 1e-6  # [°] of angles in a file


def load_motion(path: str | Path, arm: Arm, hand: Endpoint | None = None) -> Reference:
    """Load the motion in a CSV file for `arm`; `hand` moves along a path.

    Raises `InvalidFile` with line and column for a file that is not a motion of this arm, and `InvalidInput`.
    Warns with `UnusedColumns` of further columns.
    """
    checks.instance("arm", arm, Arm, "an Arm, such as Arm.machine('arm26')")
    checks.instance("hand", hand, Endpoint | None, "an Endpoint, such as Endpoint.from_mjcf(file, name)")
    stiffnesses = dict.fromkeys(arm.labels.stiffness, arm.stiffness_unit) | _others(arm)
    angles, axes = dict.fromkeys(_angle_names(arm), "deg"), dict.fromkeys(_axis_names(hand), "mm")
    columns = MotionColumns.read(path, {"t": "s"} | angles | axes | stiffnesses)
    t = columns.numbers("t")
    if t.size < 2:
        raise InvalidFile(path, f"a motion needs at least 2 samples, this file has {t.size}")
    columns.refuse("t", np.diff(t, prepend=-np.inf) <= 0, t, "{:g} s does not come after the sample before")
    q = _angles(columns, arm, hand)
    K = _stiffness(columns, arm, q)
    columns.tell_unused()
    return Reference(t, q, K, Path(path).stem)


def _angle_names(arm: Arm) -> list[str]:
    return [f"{name}_deg".replace(" ", "_") for name in arm.labels.angles]


def _axis_names(hand: Endpoint | None) -> list[str]:
    return [] if hand is None else [f"{axis}_mm" for axis in getattr(hand.kinematics, "axes", "xyz"[: hand.dim])]


def _others(arm: Arm) -> dict[str, str]:
    """Return names and units of the columns of the stiffness that is not tracked."""
    if arm.endpoint is None:
        return {name.replace("K", "Kx"): HAND_STIFFNESS for name in arm.labels.stiffness}
    return {name.replace("Kx", "K"): JOINT_STIFFNESS for name in arm.labels.stiffness}


def _angles(columns: MotionColumns, arm: Arm, hand: Endpoint | None) -> Array:
    """Return the angles (M, n) [rad]."""
    table, names, axes = columns.table, _angle_names(arm), _axis_names(hand)
    of_joints, of_hand = (any(name in columns.found for name in some) for some in (names, axes))
    if of_joints == of_hand:
        what, joined = ("both", "and") if of_joints else ("neither", "nor")
        path = f"the path {', '.join(axes)} of the hand" if axes else "a path of the hand, which this machine lacks"
        found = ", ".join(table.names)
        raise InvalidFile(
            table.path, f"has {what} the angles {', '.join(names)} {joined} {path}; found: {found}", line=1
        )
    if hand is None or of_joints:
        angles = np.stack([columns.numbers(name) for name in names], axis=1)
        for name, column, low, high in zip(names, angles.T, *(ends / DEG for ends in arm.angle_limits), strict=True):
            columns.refuse(name, np.abs(column) > 360, column, "{:g}° is over a turn")
            out = (column < low - _ROUNDING) | (column > high + _ROUNDING)
            columns.refuse(name, out, column, f"{{:g}}° is beyond the range of the joint, {low:.4g} to {high:.4g}°")
        return angles * DEG
    return _followed(columns, arm, hand, np.stack([columns.numbers(axis) for axis in axes], axis=1) * MM)


def _followed(columns: MotionColumns, arm: Arm, hand: Endpoint, path: Array) -> Array:
    """Return postures (M, n) with the hand on the `path` (M, dim) [m]. Raises `InvalidFile` if there are none."""
    try:
        return followed(arm, hand, path)
    except OutOfReach as beyond:
        raise InvalidFile(columns.table.path, str(beyond), line=columns.table.lines[beyond.sample]) from None


def _stiffness(columns: MotionColumns, arm: Arm, q: Array) -> Array:
    """Return the tracked stiffness (M, k, k) at the postures `q` (M, n)."""
    names, k, path = arm.labels.stiffness, arm.tracked, columns.table.path
    if other := next((name for name in _others(arm) if name in columns.found), ""):
        whose = ("hand", "joints") if arm.endpoint is None else ("joints", "hand")
        raise InvalidFile(
            path, f"this is the stiffness of the {whose[0]}, and that of the {whose[1]} is tracked: use "
            f"--stiffness-of {whose[0]}, or give {', '.join(names)} [{arm.stiffness_unit}]", line=1, column=other,
        )  # fmt: skip
    if not any(name in columns.found for name in names):
        try:
            K = tracked_stiffness(arm, q, usual_stiffness(arm)(q))
        except InvalidInput as singular:
            raise InvalidFile(path, str(singular)) from None
        _check(columns, arm, K, f"without columns {', '.join(names)} the usual stiffness is tracked, which")
        return K
    K = np.zeros((len(q), k, k))
    for name, i, j in _entries(columns, arm):
        K[:, i, j] = K[:, j, i] = columns.numbers(name)
    _check(columns, arm, K, "the stiffness")
    return K


def _entries(columns: MotionColumns, arm: Arm) -> Iterator[tuple[str, int, int]]:
    """Yield name, row and column of every entry that the file needs or contains."""
    for name, i, j in zip(arm.labels.stiffness, *np.triu_indices(arm.tracked), strict=True):
        if i == j or name in columns.found:
            yield name, int(i), int(j)


def _check(columns: MotionColumns, arm: Arm, K: Array, whose: str) -> None:
    least = np.asarray(np.linalg.eigvalsh(K)[:, 0], float)
    columns.refuse(
        arm.labels.stiffness[0], ~(least > 0), least,
        f"{whose} has to be positive definite, and an eigenvalue is {{:.3g}} {arm.stiffness_unit}",
    )  # fmt: skip
