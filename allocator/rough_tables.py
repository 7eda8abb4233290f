"""Doubt of a machine's stiffness by the table of its muscles' lengths.

A length rounded by δ between samples h apart bends the spline by about δ/h², so that muscle i adds F_i times that to a
stiffness. The table states the error of its bends (`TableError`); relative to the stiffness this is

    s = median over angles of √(Σ_i (F_i b_i)²)/K,    b_i the greatest error of the bend, at half of the supply
"""

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.geometry import FEWEST, Table
from allocator.mechanism.mechanism import Mechanism
from allocator.mechanism.routes import Tables
from allocator.units import PERCENT

ROUGH, TOO_ROUGH = 0.2, 0.3  # s of a table that deserves a warning, and of one that is refused
_ANGLES = 15


class RoughTable(UserWarning):
    """Warning that the table of a mechanism leaves its stiffness uncertain."""


def doubt(machine: AntagonistJoint | Mechanism) -> float:
    """Return s [-] of a joint or mechanism, the greatest of its joints; 0 without a table, or if it is too short."""
    if isinstance(machine, AntagonistJoint):
        table = machine.geometry
        if not isinstance(table, Table) or table.theta.size < FEWEST:
            return 0.0
        theta, P = np.linspace(*machine.angle_range, _ANGLES), np.full(_ANGLES, np.mean(machine.pressure_limits))
        forces = np.stack(machine.forces(theta, P, P), axis=-1)
        return _share(forces * table.error.bend, np.asarray(machine.stiffness(theta, P, P)))
    routes = machine.routes
    if not isinstance(routes, Tables) or min(map(len, routes.grid)) < FEWEST:
        return 0.0
    q = np.stack([np.linspace(row[0], row[-1], _ANGLES) for row in routes.grid], axis=-1)
    P = np.full((_ANGLES, machine.m), np.mean(machine.pressure_limits))
    errors, K = np.asarray(machine.forces(q, P)) * routes.error.bend, np.asarray(machine.stiffness(q, P))
    moved = np.abs(routes.at(q).arm) > 0  # (angles, m, n)
    return max(_share(errors * moved[..., j], K[:, j, j]) for j in range(machine.n))


def sentence(share: float) -> str:
    """Return what a doubt of the stiffness means, without a full stop."""
    return (
        f"the table leaves the stiffness uncertain by {share / PERCENT:.0f} %, for every second sample bends the arms "
        "otherwise: its lengths are rounded or noisy (smooth them, or take samples further apart), too few (take "
        "more), or those of a formula (give Pulley or Lever)"
    )


def check(machine: AntagonistJoint | Mechanism) -> str:
    """Return the `sentence` on a rough table, or "". Raises `InvalidInput` for one that is too rough."""
    share = doubt(machine)
    if share > TOO_ROUGH:
        raise InvalidInput(sentence(share))
    return sentence(share) if share > ROUGH else ""


def _share(errors: Array, K: Array) -> float:
    """Return s of errors (angles, m) [N·m/rad] at stiffnesses (angles,) [N·m/rad]; 0 if none of these is stable."""
    stable = np.isfinite(K) & (K > 0) & np.isfinite(errors).all(axis=-1)
    return float(np.median(np.linalg.norm(errors[stable], axis=-1) / K[stable])) if stable.any() else 0.0
