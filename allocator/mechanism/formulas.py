"""Formulas of a mechanism in CasADi symbols: muscle lengths, targets over pressures, the position of a hand.

Their values equal those of `allocator.mechanism.routes`, and CasADi differentiates them to any order.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from allocator.errors import InvalidInput
from allocator.lazy import SX, Function
from allocator.mechanism.endpoint.endpoint import Endpoint
from allocator.mechanism.endpoint.points import LinkagePoint
from allocator.mechanism.mechanism import Mechanism
from allocator.mechanism.routes import FunctionRoutes, JointRoutes, Pulleys, Routes, Sites
from allocator.mechanism.routes.linkage import GROUND, Link


def symbolic_lengths(routes: Routes, q: "SX") -> "SX":
    """Return the lengths l(q) (m, 1) [m] as a formula of the CasADi column `q` (n, 1).

    Raises `InvalidInput` for routes without a formula, such as tables.
    """
    import casadi as ca

    for kind, formula in _FORMULAS.items():
        if isinstance(routes, kind):
            return ca.SX(ca.vertcat(*formula(routes, q)))
    known = ", ".join(kind.__name__ for kind in _FORMULAS)
    raise InvalidInput(f"{type(routes).__name__}: an arm's model needs lengths that are formulas, of {known}")


def has_formulas(routes: Routes) -> bool:
    """Return whether `symbolic_lengths` has formulas of these routes."""
    return isinstance(routes, tuple(_FORMULAS))


def map_function(mechanism: Mechanism) -> "Function":
    """Return the CasADi function q ↦ (ε (m), A (m), B (m), y0 (d), M (d m), row by row), with forces F = A P + B.

    Raises `InvalidInput` for muscles that are not affine and for routes without formulas.
    """
    import casadi as ca

    mechanism.check_affine("formulas of the allocation")
    q, P = ca.SX.sym("q", mechanism.n), ca.SX.sym("P", mechanism.m)
    length, rest = symbolic_lengths(mechanism.routes, q), mechanism.routes.rest_length
    eps = [(L - length[j]) / L for j, L in enumerate(rest)]
    muscles = list(zip(mechanism.muscles, eps, strict=True))
    A = ca.vertcat(*(muscle.gain(0.0, e) for muscle, e in muscles))
    B = ca.vertcat(*(muscle.law(0.0, e) for muscle, e in muscles))
    torque = -ca.jacobian(length, q).T @ (A * P + B)  # (M1)
    stiffness = -ca.jacobian(torque, q)  # (M2)
    rows, columns = mechanism.upper_triangle
    entries = [stiffness[i, j] for i, j in zip(rows.tolist(), columns.tolist(), strict=True)]
    y = ca.vertcat(torque, *entries)
    y0, M = ca.substitute(y, P, 0), ca.jacobian(y, P)
    if ca.depends_on(M, P):
        raise InvalidInput("the targets of this mechanism are not affine in the pressures")
    made = ca.cse([ca.vertcat(*eps), A, B, y0, ca.vec(M.T)])
    return ca.Function(
        "mechanism", [q], list(map(ca.densify, made)), ["q"], ["contraction", "gain", "force", "y0", "M"]
    )


def symbolic_position(endpoint: Endpoint, q: "SX") -> "SX":
    """Return the position x (dim, 1) of an endpoint as a formula of the CasADi column `q` (n, 1)."""
    import casadi as ca

    point: Any = endpoint.kinematics
    if not isinstance(point, LinkagePoint):
        return ca.SX(point.column(q))
    R, origin = _frames(point.linkage.links, q)[point.site.link]
    x = ca.SX(origin + R @ ca.DM(point.site.position))
    return ca.vertcat(*(x["xyz".index(axis)] for axis in point.axes))


def symbolic_jacobian(endpoint: Endpoint, q: "SX") -> "SX":
    """Return J = ∂x/∂q (dim, n) of an endpoint as a formula of the CasADi column `q` (n, 1)."""
    import casadi as ca

    return ca.densify(ca.jacobian(symbolic_position(endpoint, q), q))


def _pulleys(routes: Pulleys, q: "SX") -> list["SX | float"]:
    """Return L (1 - ε0) - r·q."""
    rows = zip(routes.rest_length, routes.initial_contraction, routes.arms, strict=True)
    return [L * (1 - eps) - sum(r * q[i] for i, r in enumerate(arms) if r) for L, eps, arms in rows]


def _joint(routes: JointRoutes, q: "SX") -> list["SX | float"]:
    """Return L (1 - ε(θ)) of both muscles of an antagonistic joint."""
    contractions = routes.geometry.agonist(q[0])[0], routes.geometry.antagonist(q[0])[0]
    return [L * (1 - eps) for L, eps in zip(routes.rest_length, contractions, strict=True)]


def _function(routes: FunctionRoutes, q: "SX") -> list["SX"]:
    import casadi as ca

    value = routes.function(q)
    return list(value) if isinstance(value, list | tuple) else ca.vertsplit(ca.SX(value))


def _sites(routes: Sites, q: "SX") -> list["SX | float"]:
    """Return the lengths of the straight segments between the sites of each path, less the cable."""
    import casadi as ca

    frames = _frames(routes.links, q)
    found = []
    for path, cable in zip(routes.paths, routes.cable, strict=True):
        points = [frames[site.link][1] + frames[site.link][0] @ ca.DM(site.position) for site in path]
        found.append(sum(ca.norm_2(end - start) for start, end in pairwise(points)) - cable)
    return found


def _frames(links: Sequence[Link], q: "SX") -> list[tuple["SX", "SX"]]:
    """Return (rotation (3, 3), origin (3, 1)) of every link, and of the ground last, at the index GROUND = -1."""
    import casadi as ca

    ground = ca.SX.eye(3), ca.SX.zeros(3)
    frames: list[tuple[SX, SX]] = []
    for i, link in enumerate(links):
        R, o = ground if link.parent == GROUND else frames[link.parent]
        origin, R = o + R @ ca.DM(link.origin), R @ ca.DM(np.array(link.orientation))
        moved = q[i] - link.zero
        if link.kind == "hinge":
            W = ca.skew(ca.DM(link.axis))
            frames.append((R @ (ca.DM.eye(3) + ca.sin(moved) * W + (1 - ca.cos(moved)) * (W @ W)), origin))
        else:
            frames.append((R, origin + moved * (R @ ca.DM(link.axis))))
    return [*frames, ground]


_FORMULAS: dict[type[Routes], Callable[..., Sequence["SX | float"]]] = {
    Pulleys: _pulleys,
    JointRoutes: _joint,
    FunctionRoutes: _function,
    Sites: _sites,
}
