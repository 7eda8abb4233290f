"""Inspection of a step's QP: its matrices, and the names of its decisions and rows."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from allocator.calculus import Array
from mpc.tracking.limits import Limits
from mpc.tracking.qp.condense import TrackingProblem
from mpc.tracking.qp.programme import QP

_SHOWN = 3  # of a kind, from each end


@dataclass(frozen=True, eq=False)
class NamedQP:
    """Unsolved problem of one step of a `TrackingMPC`; its arrays are read-only.

        minimise ½ zᵀ H z + fᵀ z   subject to   lower ≤ z ≤ upper,   rows_lower ≤ rows z ≤ rows_upper

    The decisions z are the changes of the commands, less those of `u`, and the slacks. The horizon begins when a
    command given now acts; [k] counts its samples.
    """

    H: Array  # (n, n)
    f: Array  # (n,)
    lower: Array  # (n,)
    upper: Array  # (n,)
    rows: Array  # (m, n)
    rows_lower: Array  # (m,)
    rows_upper: Array  # (m,)
    decisions: tuple[str, ...]  # n names; pressures count in bar, slacks in rad and N
    row_names: tuple[str, ...]  # m
    u: Array  # (N, m) commands for z = 0 [Pa], without those of a dead band's inverse
    _u_last: Array = field(repr=False)  # (m,) [Pa]
    _E: Array = field(repr=False)  # (N, m, n) [Pa]
    _limits: Limits = field(repr=False)

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for array in (self.H, self.f, self.lower, self.upper, self.rows, self.rows_lower, self.rows_upper, self.u):
            array.setflags(write=False)

    def __setstate__(self, state: dict[str, object]) -> None:
        """Make the arrays of a copy read-only."""
        self.__dict__.update(state)
        self.__post_init__()

    def commands(self, z: Array) -> Array:
        """Return the commands [Pa] of the decisions `z` (n,), within the hard limits as a plan's are."""
        return self._limits.limited(self._u_last, self.u + self._E @ z)

    def __repr__(self) -> str:
        """Return tables of decisions and rows, long ones shortened."""
        n, m = self.rows.shape[1], len(self.rows)
        head = f"QP of a step: {n} decisions, {m} rows; minimise ½ zᵀ H z + fᵀ z"
        decisions = [f"{'decision':<24}{'lower':>12}{'upper':>12}{'f':>12}{'H[i, i]':>12}"]
        of_decisions = self.lower, self.upper, self.f, np.diag(self.H)
        decisions += [_line(name, *numbers) for name, *numbers in zip(self.decisions, *of_decisions, strict=True)]
        rows = [f"{'row':<24}{'lower':>12}{'upper':>12}"]
        of_rows = self.rows_lower, self.rows_upper
        rows += [_line(name, *numbers) for name, *numbers in zip(self.row_names, *of_rows, strict=True)]
        return "\n".join([head, "", *_shortened(decisions), "", *_shortened(rows)])


def named(problem: TrackingProblem, qp: QP, u: Array, u_last: Array) -> NamedQP:
    """Return `qp` of `problem` about the commands `u` (N, m) after `u_last` (m,), with names."""
    arrays = qp.H, qp.f, qp.lower, qp.upper, qp.R, qp.rows_lower, qp.rows_upper
    names = tuple(decision_names(problem)), tuple(row_names(problem))
    return NamedQP(*arrays, *names, u, u_last, problem.E, problem.limits)


def decision_names(problem: TrackingProblem) -> Iterator[str]:
    """Yield the names of the decisions, in the order of `mpc.tracking.qp.condense`."""
    for k in problem.starts:
        yield from (f"ΔP{j}[{k}]" for j in range(1, problem.muscles + 1))
    yield from ("slack angle", "slack force")


def row_names(problem: TrackingProblem) -> Iterator[str]:
    """Yield the names of the rows, in the order of `mpc.tracking.qp.condense`."""
    N, n, m = sum(problem.blocks), problem.joints, problem.muscles
    angles = ["angle"] if n == 1 else [f"angle {i}" for i in range(1, n + 1)]
    muscles = ["agonist", "antagonist"] if (n, m) == (1, 2) else [f"muscle {j}" for j in range(1, m + 1)]
    for k in range(N):
        yield from (f"P{j}[{k}] supply" for j in range(1, m + 1))
    for side in ("upper", "lower"):
        for k in range(1, N + 1):
            yield from (f"{angle}[{k}] {side}" for angle in angles)
    for k in range(1, N + 1):
        yield from (f"{muscle} taut[{k}]" for muscle in muscles)


def _line(name: str, *numbers: float) -> str:
    return f"{name:<24}" + "".join(f"{number:12.4g}" for number in numbers)


def _shortened(lines: list[str]) -> list[str]:
    """Return the lines without those in the middle of runs of one kind: names that differ in their numbers only."""
    kinds = ["".join(c for c in line.split("  ")[0] if not c.isdigit()) for line in lines]
    kept: list[str] = []
    for i, line in enumerate(lines):
        same = [j for j in range(len(lines)) if kinds[j] == kinds[i]]
        at = same.index(i)
        if at < _SHOWN or at >= len(same) - _SHOWN:
            kept.append(line)
        elif kept[-1] != "…":
            kept.append("…")
    return kept
