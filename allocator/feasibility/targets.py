"""Feasible targets of affine muscles at a posture: a zonotope {y0 + M P} over the box of the pressures.

y holds torques and stiffness. The zonotope is known by its support function

    h(d) = max d·y = d·y0 + Σ_j max(d·M_j lo_j, d·M_j hi_j),

which proves that targets are out of reach: d·y* > h(d).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.allocation.box.arguments import problem_from
from allocator.allocation.box.problem import BoxProblem
from allocator.allocation.box.result import limit_names
from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.feasibility.polygon import Coordinate, Edge, Hand, Polygon, Programme, coordinate, outline
from allocator.joint.gas import ISOBARIC, Stiffness
from allocator.joint.limits import TAUT, Limits
from allocator.lazy import Axes
from allocator.mechanism.endpoint import Endpoint
from allocator.mechanism.endpoint.endpoint import Place
from allocator.mechanism.mechanism import Mechanism, TargetsMap


def feasible_targets(
    mechanism: Mechanism,
    q: ArrayLike,
    *,
    limits: Limits = TAUT,
    stiffness: Stiffness = ISOBARIC,
) -> "FeasibleTargets":
    """Return the feasible torques and stiffnesses of a mechanism with affine muscles at a posture `q` (n,) [rad].

    The `stiffness` of an `Endpoint` with as many coordinates as joints is a target as well. Limits are those of
    `allocate`. Raises `InvalidInput`, also for a posture beyond the range of the joints.
    """
    if not isinstance(mechanism, Mechanism):
        raise InvalidInput(f"mechanism is a {type(mechanism).__name__}; expected a Mechanism")
    mechanism.check_affine("feasibility")
    problem, shape = problem_from(mechanism, q, 1.0, 0.0, limits=limits, stiffness=stiffness)
    if shape:
        raise InvalidInput(f"q has the shape {np.shape(q)}; expected one posture ({mechanism.n},)")
    if problem.outside.any():
        raise InvalidInput(f"q = {np.array(q)} rad is beyond the range of {_outside(problem)}")
    endpoint = stiffness.endpoint
    if endpoint is not None and endpoint.n > endpoint.dim:
        raise InvalidInput(f"{endpoint.text}: its stiffness is no affine function of the pressures; give none here")
    return FeasibleTargets(problem)


def _outside(problem: BoxProblem) -> str:
    return ", ".join(np.array(problem.mechanism.joint_names)[problem.outside[0]])


@dataclass(frozen=True, eq=False)
class FeasibleTargets:
    """Feasible torques and stiffnesses of a mechanism at one posture."""

    _problem: BoxProblem = field(repr=False)

    @property
    def mechanism(self) -> Mechanism:
        """Mechanism."""
        return self._problem.mechanism

    @property
    def q(self) -> Array:
        """Posture (n,) [rad]."""
        return np.asarray(self._problem.q[0])

    @cached_property
    def map(self) -> TargetsMap:
        """y0 (d,) and M (d, m) of torques and joint stiffness."""
        y0, M = self._problem.joint_map
        return TargetsMap(y0[0], M[0])

    @property
    def box(self) -> tuple[Array, Array]:
        """Least and greatest pressures (m,) [Pa]."""
        lo, hi = self._problem.bounds
        return lo[0], hi[0]

    @cached_property
    def exists(self) -> bool:
        """Whether the limits leave every muscle a pressure that keeps it taut."""
        return not any((side.empty | side.unreachable | side.slack).any() for side in self._problem.box)

    def interval(self, target: object, held: Mapping[str, float] | None = None) -> tuple[float, float]:
        """Return the least and the greatest value of a target, such as "K12", with others held; NaN if none exist.

        Names are those of `polygon`. Raises `InvalidInput`.
        """
        axis, (y0, M) = self.coordinate(target), self.map
        ends = (self.attaining(target, sign, held) for sign in (-1.0, 1.0))
        low, high = (np.nan if P is None else float(axis.direction @ (y0 + M @ P) + axis.constant) for P in ends)
        return low, high

    def attaining(self, target: object, sign: float, held: Mapping[str, float] | None = None) -> Array | None:
        """Return pressures (m,) [Pa] that attain the end of `interval` on this side, or None if none exist."""
        found = self._programme(held).farthest(sign * self.coordinate(target).direction @ self.map.M)
        return None if found is None else found.P

    def endpoint_stiffness(self, P: Array) -> Array:
        """Return K_x (dim, dim) [N/m] at pressures (m,) [Pa]. Raises `InvalidInput` without an endpoint."""
        if self._problem.endpoint is None:
            raise InvalidInput("no endpoint was given to `feasible_targets`; its stiffness is not known")
        return np.asarray(self._problem.endpoint.stiffness(self._problem.joint_stiffness(P[None]))[0])

    def polygon(self, x: object, y: object, held: Mapping[str, float] | None = None) -> Polygon:
        """Return all feasible values of two targets: a convex polygon, with the binding limits of each edge.

        Targets are "T1" …, "K11", "K12" … and of an endpoint "Kx11" …, or mappings of such names to weights (`{"Kx11":
        0.5, "Kx22": -0.5}`). `held` gives constant targets by name [N·m], [N·m/rad], [N/m]: `{"T1": 9.0, "T2": 4.0}`;
        the rest is free. Raises `InvalidInput`.
        """
        axes = self.coordinate(x), self.coordinate(y)
        rows = np.stack([axis.direction for axis in axes])
        if np.linalg.matrix_rank(rows) < 2:
            raise InvalidInput(f"{axes[0].name} and {axes[1].name} are the same but for a factor")
        offset = rows @ self.map.y0 + np.array([axis.constant for axis in axes])
        corners, sides = outline(self._programme(held), offset, rows @ self.map.M)
        edges = tuple(
            Edge(corners[i][0], corners[(i + 1) % len(corners)][0], self._binding(price))
            for i, price in enumerate(sides)
        )
        vertices, P = (np.array([corner[part] for corner in corners]) for part in (0, 1))
        return Polygon(axes, vertices.reshape(-1, 2), P.reshape(-1, self.mechanism.m), edges, self._held(held))

    def coordinate(self, target: object) -> Coordinate:
        """Return a target of `polygon` as a function of torques and stiffness. Raises `InvalidInput`."""
        at = self._problem.endpoint
        hand = None if at is None else Hand(at.endpoint, Place(*(part[0] for part in at.place)), at.force[0])
        return coordinate(target, self.mechanism.n, hand)

    def _held(self, held: Mapping[str, float] | None) -> str:
        kept = [(self.coordinate(name), value) for name, value in (held or {}).items()]
        return ", ".join(f"{axis.name} = {value:.4g} {axis.unit}" for axis, value in kept)

    def _programme(self, held: Mapping[str, float] | None) -> Programme:
        if held is not None and not isinstance(held, Mapping):
            raise InvalidInput(f"held = {checks.brief(held)} has to be a mapping, such as {{'T1': 0.0}}")
        y0, M = self.map
        kept = [(self.coordinate(name), checks.number(f"held[{name!r}]", v, "SI")) for name, v in (held or {}).items()]
        rows = np.array([axis.direction @ M for axis, _ in kept]).reshape(-1, self.mechanism.m)
        right = np.array([value - axis.constant - axis.direction @ y0 for axis, value in kept])
        return Programme(rows, right, *self.box, self.exists)

    def _binding(self, price: Array) -> tuple[str, ...]:
        """Return the names of the limits with a price (m,), positive at the greatest pressure."""
        pairs = zip(self.mechanism.muscle_names, self._problem.box, price, strict=True)
        return tuple(
            limit
            for name, side, p in pairs
            if p
            for limit in limit_names(name, int((side.hi_limit if p > 0 else side.lo_limit)[0]))
        )


_TRACE = {"Kx11": 1.0, "Kx22": 1.0}
_ACROSS = {"Kx11": 0.5, "Kx22": -0.5}


@dataclass(frozen=True, eq=False)
class EndpointEllipses:
    """Extreme stiffness ellipses of a hand in the plane at postures (…), NaN where the torques are infeasible."""

    q: Array  # (…, 2) [rad]
    x: Array  # position of the hand (…, 2) [m]
    softest: Array  # K_x of the least trace (…, 2, 2) [N/m]
    stiffest: Array  # and of the greatest
    tilt: Array  # of the long axis from x anticlockwise, least and greatest (…, 2) [rad]; π apart where all exist
    names: str = "xy"  # of the coordinates

    @property
    def exists(self) -> Mask:
        """Whether there are pressures that give the torques (…)."""
        return np.isfinite(self.softest[..., 0, 0])

    def plot(self, axes: "Axes | None" = None) -> Any:
        """Draw the ellipses at the hand's positions; return the Matplotlib axes."""
        from allocator.feasibility.pictures import plot_workspace

        return plot_workspace(self, axes)


def endpoint_ellipses(
    mechanism: Mechanism,
    endpoint: Endpoint,
    q: ArrayLike,
    T: ArrayLike = 0.0,
    *,
    force: ArrayLike = 0.0,
    limits: Limits = TAUT,
) -> EndpointEllipses:
    """Return the softest and the stiffest ellipse of a hand in the plane at postures `q` (…, 2) [rad], and its tilts.

    The torques are constant: `T` (…, 2) [N·m] or a number, plus those of the `force` (2,) [N] that the hand exerts.
    Raises `InvalidInput`, also unless there are two joints and two coordinates, and if the Jacobian is singular.
    """
    if not isinstance(endpoint, Endpoint) or (endpoint.n, endpoint.dim) != (2, 2):
        what = endpoint.text if isinstance(endpoint, Endpoint) else f"a {type(endpoint).__name__}"
        raise InvalidInput(
            f"the ellipses are those of an endpoint with dim = 2 coordinates over n = 2 joints, not {what}"
        )
    postures = mechanism.posture(q)
    flat = postures.reshape(-1, 2)
    torques = np.broadcast_to(np.asarray(T, float), postures.shape).reshape(-1, 2) + endpoint.torque(flat, force)
    found = []
    for one, torque in zip(flat, torques, strict=True):
        at = feasible_targets(mechanism, one, stiffness=Stiffness(endpoint=endpoint, force=force), limits=limits)
        found.append(_at(at, torque))
    shape = postures.shape[:-1]
    softest, stiffest, tilt = (np.array([row[i] for row in found]) for i in range(3))
    return EndpointEllipses(
        postures,
        endpoint.position(postures),
        softest.reshape(*shape, 2, 2),
        stiffest.reshape(*shape, 2, 2),
        tilt.reshape(*shape, 2),
        getattr(endpoint.kinematics, "axes", "xy"),
    )


def _at(feasible: FeasibleTargets, torque: Array) -> tuple[Array, Array, Array]:
    """Return the softest and the stiffest K_x, and the tilts, at one posture."""
    held = {f"T{i + 1}": float(value) for i, value in enumerate(torque)}
    low, high = (feasible.attaining(_TRACE, sign, held) for sign in (-1.0, 1.0))
    if low is None or high is None:
        return np.full((2, 2), np.nan), np.full((2, 2), np.nan), np.full(2, np.nan)
    return (
        feasible.endpoint_stiffness(low),
        feasible.endpoint_stiffness(high),
        _tilts(feasible.polygon(_ACROSS, "Kx12", held)),
    )


def _tilts(polygon: Polygon) -> Array:
    """Return the least and the greatest half angle of a polygon's points."""
    if bool(polygon.contains(0.0, 0.0)):
        return np.array([-np.pi / 2, np.pi / 2])
    x, y = polygon.vertices.T
    middle = np.arctan2(y.mean(), x.mean())
    around = (np.arctan2(y, x) - middle + np.pi) % (2 * np.pi) - np.pi
    return np.asarray(0.5 * (middle + np.array([around.min(), around.max()])))
