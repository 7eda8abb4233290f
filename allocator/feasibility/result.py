"""Result of `feasibility_map`."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from allocator.allocation import Status
from allocator.calculus import Array, Mask
from allocator.feasibility.edges import Edge, edges_at_angle, edges_at_stiffness, edges_at_torque
from allocator.feasibility.setting import Setting
from allocator.files.atomic import replacing
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.assumption import assumptions, extrapolates
from allocator.joint.gas import StiffnessKind
from allocator.joint.limits import names
from allocator.lazy import Axes
from allocator.units import BAR, DEG

_SHUT = "none", "antagonist", "agonist", "both"  # valves, by `FeasibilityMap.state`
_CELLS = "status", "limits", "P1", "P2", "state"  # arrays with a number for each cell
_HEADER = "theta_deg,stiffness_Nm_per_rad,torque_Nm,status,limits,P1_bar,P2_bar"


@dataclass(frozen=True, eq=False)
class FeasibilityMap:
    """Results of `allocate` over a grid of θ, K and T; each varied quantity is one axis of the arrays."""

    setting: Setting = field(repr=False)
    theta: Array = field(repr=False)  # joint angles [rad], (n,) if varied, else ()
    K: Array = field(repr=False)  # requested stiffnesses [N·m/rad], likewise
    T: Array = field(repr=False)  # requested torques [N·m], likewise
    status: NDArray[np.int8] = field(repr=False)  # Status of every cell
    limits: NDArray[np.int32] = field(repr=False)  # combination of Limit flags that bind at its answer
    P1: Array = field(repr=False)  # agonist pressure of its answer [Pa]; the nearest one if infeasible
    P2: Array = field(repr=False)  # antagonist pressure [Pa]
    state: NDArray[np.int8] | None = field(default=None, repr=False)  # of free valves: 1 antagonist shut, 2 agonist, 3

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for array in (self.theta, self.K, self.T, self.status, self.limits, self.P1, self.P2, self._state):
            array.setflags(write=False)

    def __repr__(self) -> str:
        axes = " × ".join(f"{getattr(self, name).size} {name}" for name in self.varied)
        return f"FeasibilityMap: {axes}, {self.share:.0%} feasible; {self.kind.text}"

    @property
    def _state(self) -> NDArray[np.int8]:
        """States of the valves, all open unless they are free."""
        return np.zeros(self.status.shape, np.int8) if self.state is None else self.state

    @property
    def kind(self) -> StiffnessKind:
        """Kind of the mapped stiffness: isobaric, shut, …"""
        return self.setting.kind

    @property
    def joint(self) -> AntagonistJoint:
        """Joint of the map."""
        return self.setting.joint

    @property
    def assumed(self) -> str:
        """Sentence listing the assumptions behind the feasible cells that the data could not confirm, or ""."""
        theta, P1, P2 = self._feasible_points
        return assumptions(self.joint, theta, P1, P2)

    @property
    def _feasible_points(self) -> tuple[Array, Array, Array]:
        """Angles [rad] and pressures [Pa] of all cells, with NaN pressures in infeasible ones."""
        theta = self.theta.reshape(-1, *[1] * (len(self.varied) - 1)) if self.theta.ndim else self.theta
        P1, P2 = (np.where(self.feasible, P, np.nan) for P in (self.P1, self.P2))
        return np.broadcast_to(theta, P1.shape), P1, P2

    @property
    def varied(self) -> tuple[str, ...]:
        """Names of the quantities along the axes of the arrays: two or three of "theta", "K", "T"."""
        return tuple(name for name in ("theta", "K", "T") if getattr(self, name).ndim)

    @property
    def feasible(self) -> Mask:
        """Whether angle, stiffness and torque of a cell are feasible together."""
        return np.asarray(self.status == Status.EXACT)

    @property
    def share(self) -> float:
        """Feasible part of the cells [-]."""
        return float(self.feasible.mean())

    @cached_property
    def edges(self) -> tuple[Edge, ...]:
        """Edges of the feasible set as curves, each labelled by the limit that binds along it.

        Computed from the closed forms, not from the cells. With three axes: those of all `slices`.
        """
        if len(self.varied) == 3:
            return tuple(edge for part in self.slices for edge in part.edges)
        if not self.theta.ndim:
            return edges_at_angle(self.setting, float(self.theta))
        range_left, range_right = self.joint.angle_range
        left, right = max(range_left, float(self.theta[0])), min(range_right, float(self.theta[-1]))
        if left >= right:
            return ()
        if not self.K.ndim:
            return edges_at_stiffness(self.setting, float(self.K), left, right)
        return edges_at_torque(self.setting, float(self.T), left, right)

    @property
    def slices(self) -> tuple["FeasibilityMap", ...]:
        """Maps with two axes: this one, or the one at every torque if there are three."""
        if len(self.varied) == 2:
            return (self,)
        cells = {name: array for name in _CELLS if (array := getattr(self, name)) is not None}
        return tuple(
            replace(self, T=np.array(T), **{name: array[..., i] for name, array in cells.items()})
            for i, T in enumerate(self.T)
        )

    # --- on disk ----------------------------------------------------------------------------------------------------

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write one row per cell: degrees, N·m/rad, N·m, the status and the limits by name, bar.

        Further columns mark assumed slack limits, and feasible cells extrapolated beyond a muscle's measured region.
        """
        outside = extrapolates(self.joint, *self._feasible_points)
        with replacing(path) as draft, draft.open("w", encoding="utf-8", newline="") as file:
            header, ends = self._header, np.full(self.status.size, "", object)
            if self.joint.slack_assumed:
                header, ends = header + ",slack_limits", ends + ",assumed"
            if outside is not None:
                header, ends = header + ",forces", ends + np.where(outside.ravel(), ",extrapolated", ",measured")
            file.write(header + "\n")
            file.writelines(row + end + "\n" for row, end in zip(self._rows(), ends, strict=True))

    @property
    def _header(self) -> str:
        """Names of the columns, with the kind of stiffness unless isobaric, and the state of free valves."""
        if self.kind.isobaric:
            return _HEADER
        name = self.kind.text.replace(" stiffness", "").replace(" at ", "_").replace(" ", "").replace("-", "_")
        return _HEADER.replace("stiffness", f"{name}_stiffness") + ("" if self.state is None else ",shut")

    def _rows(self) -> Iterator[str]:
        axes = (np.atleast_1d(self.theta) / DEG, np.atleast_1d(self.K), np.atleast_1d(self.T))
        shut = np.array([""] * len(_SHUT) if self.state is None else [f",{name}" for name in _SHUT])[self._state]
        pressures = (self.P1 / BAR).flat, (self.P2 / BAR).flat
        cells = zip(self.status.flat, self.limits.flat, *pressures, shut.flat, strict=True)
        text = {value: " + ".join(names(int(value))) for value in np.unique(self.limits)}
        state = {int(value): value.name for value in Status}
        for (theta, K, T), (status, limits, P1, P2, which) in zip(product(*axes), cells, strict=True):
            yield f"{theta:.10g},{K:.10g},{T:.10g},{state[int(status)]},{text[limits]},{P1:.9g},{P2:.9g}{which}"

    def to_npz(self, path: str | PathLike[str]) -> None:
        """Write all arrays in SI units, the names of the statuses and the limits, and the edges, compressed.

        Edges are one array of points (n, 5), columns as in `edge_columns`, and (m,) where each begins and its flags.
        """
        from allocator.joint.limits import Limit

        points = [np.stack([e.theta, e.K, e.T, e.P1, e.P2], axis=1) for e in self.edges]
        with replacing(path) as draft, draft.open("wb") as file:  # given a name, NumPy would add a suffix
            np.savez_compressed(
                file,
                **{name: getattr(self, name) for name in ("theta", "K", "T", *_CELLS[:-1])},
                valves=self._state,
                valve_names=np.array(_SHUT),
                stiffness=np.array(self.kind.text),
                status_names=np.array([status.name for status in Status]),
                limit_names=np.array([limit.text for limit in Limit]),
                edge_points=np.concatenate([np.empty((0, 5)), *points]),
                edge_columns=np.array(["theta", "K", "T", "P1", "P2"]),
                edge_starts=np.cumsum([0, *map(len, points)])[:-1],
                edge_limits=np.array([e.limits for e in self.edges], np.int32),
                assumed=np.array(self.assumed),
            )

    # --- pictures ---------------------------------------------------------------------------------------------------

    def plot(self, axes: "Axes | None" = None) -> Any:
        """Draw the feasible set with its edges, labelled by the binding limit; return the Matplotlib axes."""
        from allocator.feasibility.plotting import plot_map

        return plot_map(self, axes)
