"""Rows of a loop's log, and the columns that they make in its file.

A joint has one column for each field of `Row`, and P1, P2 for its pressures. Columns of an arm are numbered like its
joints, its muscles and the entries of the tracked stiffness: theta2_ref, P3_command, K12_estimate.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import count, takewhile
from math import nan
from typing import Any, NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array, Value
from mpc.model.machine import Machine
from mpc.model.plant import Plant
from mpc.tracking.plan import Plan

Pressures: TypeAlias = tuple[float, ...]  # (m,) [Pa]
Column: TypeAlias = NDArray[Any]  # of floats or of integers
Columns: TypeAlias = Mapping[str, Column]


class Row(NamedTuple):
    """One sample of a loop with m muscles; SI units.

    Quantities of a joint are numbers. Those of an arm with n joints are rows (n,), and its stiffness is a matrix
    (k, k); a number stands for all of them.
    """

    t: float  # beginning [s], since the first one
    theta: Value  # measured [rad]; NaN: no reading
    P: Pressures  # measured (m,) [Pa]
    P_command: Pressures  # (m,) [Pa]
    phase: int  # `Phase`
    missed: int  # missed samples before it
    late: float  # delay of its beginning after the deadline [s]
    took: float  # from then until its command was sent [s]
    read_at: float = nan  # time of the measurement by the device [s], since the first sample
    sent: int = 1  # whether the device took the command
    torque: Value = 0.0  # of a weight on the joint, if known [N·m]
    theta_ref: Value = nan  # [rad]
    K_ref: Value = nan  # [N·m/rad], of an endpoint [N/m]
    theta_estimate: Value = nan  # [rad]
    omega_estimate: Value = nan  # [rad/s]
    P_estimate: Value = nan  # (m,) [Pa]
    d_estimate: Value = nan  # disturbance torque [N·m]
    K_estimate: Value = nan  # stiffness when the command begins to act, by the model, like `K_ref`
    rung: int = -1  # `mpc.tracking.plan.Rung`; -1: no plan
    status: int = -2  # `PlanStatus`; -2: no plan
    slack: float = 0.0  # predicted excursion from the joint range [rad]
    slack_force: float = 0.0  # predicted lack of muscle force [N]
    moved_theta: float = nan  # distance by which the controller moved the reference [rad]
    moved_K: float = nan  # [N·m/rad], of an endpoint [N/m]
    moved_T: float = nan  # [N·m]


INTEGERS = frozenset(name for name, kind in Row.__annotations__.items() if kind is int)
_OF_JOINTS = "theta", "torque", "theta_ref", "theta_estimate", "omega_estimate", "d_estimate"
_OF_MUSCLES = "P", "P_command", "P_estimate"
_OF_STIFFNESS = "K_ref", "K_estimate"
_STIFFNESS = *_OF_STIFFNESS, "moved_K"
_UNITS = dict.fromkeys(_OF_MUSCLES, "Pa") | {
    "t": "s", "theta": "rad", "late": "s", "took": "s", "read_at": "s", "torque": "Nm", "theta_ref": "rad",
    "theta_estimate": "rad", "omega_estimate": "rad/s", "d_estimate": "Nm", "slack": "rad", "slack_force": "N",
    "moved_theta": "rad", "moved_T": "Nm",
}  # fmt: skip


@dataclass(frozen=True)
class Sheet:
    """Columns of a machine's log; by default those of a joint."""

    joints: tuple[str, ...] = ("",)  # (n,) numbers in the names of the columns
    muscles: tuple[str, ...] = ("1", "2")  # (m,) likewise
    stiffness: tuple[str, ...] = ("K",)  # names of the entries, the upper triangle of a matrix
    unit: str = "Nm/rad"  # of the stiffness

    @classmethod
    def of(cls, machine: Machine) -> Self:
        """Return the sheet of a joint or an arm."""
        if isinstance(machine, Plant):
            return cls()
        joints, muscles = (tuple(map(str, range(1, size + 1))) for size in (machine.n, machine.m))
        return cls(joints, muscles, machine.labels.stiffness, machine.stiffness_unit.replace("·", ""))

    @classmethod
    def found(cls, names: Sequence[str]) -> Self:
        """Return the sheet of a log whose columns have these names, some of which may be missing."""
        if "theta1" not in names:
            return cls()
        joints, muscles = (_numbers(stem, names) for stem in ("theta", "P"))
        entries = tuple(name.removesuffix("_ref") for name in names if re.fullmatch(r"Kx?\d+_ref", name))
        return cls(joints, muscles, entries or ("K11",))

    @cached_property
    def fields(self) -> dict[str, tuple[str, ...]]:
        """Names of the columns of each field of `Row`."""
        return {name: tuple(self._columns_of(name)) for name in Row._fields}

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all columns."""
        return tuple(name for names in self.fields.values() for name in names)

    @cached_property
    def kinds(self) -> tuple[type, ...]:
        """Type of the numbers of each column; a NumPy scalar has another `repr`."""
        return tuple(int if name in INTEGERS else float for name in self.names)

    @property
    def header(self) -> str:
        """Line of the names of all columns with their units."""
        units = _UNITS | dict.fromkeys(_STIFFNESS, self.unit)
        named = ((name, units.get(field)) for field, names in self.fields.items() for name in names)
        return ",".join(f"{name} [{unit}]" if unit else name for name, unit in named)

    def cells(self, row: Row) -> list[Any]:
        """Return the numbers of a row, one for each column."""
        cells: list[Any] = list(row)
        for i, width in self._several:
            cells[i : i + 1] = _spread(row[i], width)
        return cells

    def values(self, columns: Columns, field: str) -> Column:
        """Return a field of all N rows: numbers (N,), or rows (N, n) or (N, m), or matrices (N, k, k)."""
        names = self.fields[field]
        if names == (field,):
            return columns[field]
        entries = np.stack([columns[name] for name in names], axis=-1)
        return _matrices(entries) if field in _OF_STIFFNESS else entries

    def _columns_of(self, field: str) -> Iterator[str]:
        stem, _, kind = field.partition("_")
        ending = f"_{kind}" if kind else ""
        if field in _OF_STIFFNESS:
            yield from (f"{entry}{ending}" for entry in self.stiffness)
        elif field in (*_OF_JOINTS, *_OF_MUSCLES):
            numbers = self.muscles if field in _OF_MUSCLES else self.joints
            yield from (f"{stem}{number}{ending}" for number in numbers)
        else:
            yield field

    @cached_property
    def _several(self) -> tuple[tuple[int, int], ...]:
        """Place of each field that is a row or a matrix, and its number of columns, from the last field on."""
        places = [(i, len(names)) for i, (field, names) in enumerate(self.fields.items()) if names != (field,)]
        return tuple(reversed(places))


JOINT = Sheet()  # columns of the log of a joint


def head(dt: float, machine: Machine) -> list[str]:
    """Return the first comments of a log of samples of `dt` [s]."""
    text = f"antagonist log; dt = {dt!r} s; SI units; {{}}NaN: not measured"
    if isinstance(machine, Plant):
        return [text.format("muscle 1 is the agonist; ")]
    parts = ("joints", machine.labels.angles), ("muscles", machine.labels.pressures)
    return [text.format(""), *(f"{kind}: {_numbered(names)}" for kind, names in parts)]


def _numbered(names: tuple[str, ...]) -> str:
    """Return names on one line, each with its number in the names of the columns."""
    return ", ".join(f"{i} {' '.join(name.split())}" for i, name in enumerate(names, 1))


def _numbers(stem: str, names: Sequence[str]) -> tuple[str, ...]:
    """Return the numbers 1, 2, … after `stem` in the names of columns."""
    return tuple(map(str, takewhile(lambda i: f"{stem}{i}" in names, count(1))))


def of_plan(plan: Plan) -> dict[str, object]:
    """Return the fields of a controller's plan."""
    moved = {} if plan.moved is None else {f"moved_{name}": value for name, value in plan.moved._asdict().items()}
    K = plan.K[0]
    return {
        "K_estimate": K if K.ndim else float(K),
        "rung": int(plan.rung),
        "status": int(plan.status),
        "slack": plan.slack,
        "slack_force": plan.slack_force,
        **moved,
    }


def _spread(value: Any, width: int) -> Iterable[float]:
    """Return a row, the upper triangle of a matrix, or a number `width` times."""
    if isinstance(value, tuple):
        return value
    array = np.asarray(value, float)
    if not array.ndim:
        return (float(value),) * width
    flat: list[float] = (array[np.triu_indices(len(array))] if array.ndim > 1 else array).tolist()
    return flat


def _matrices(entries: Array) -> Array:
    """Return the symmetric matrices (N, k, k) with these upper triangles (N, k(k + 1)/2)."""
    k = int((2 * entries.shape[-1]) ** 0.5)
    K, (rows, columns) = np.empty((len(entries), k, k)), np.triu_indices(k)
    K[:, rows, columns] = K[:, columns, rows] = entries
    return K
