"""Conversion of a MuJoCo model's bodies to `TreeBodies`, as far as the formulas cover its physics."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidFile
from allocator.mechanism.routes.linkage import Link
from allocator.mechanism.routes.mjcf import Source, linkage_of, name_of, rotation, said
from mpc.model.arm.mechanics.tree import TreeBodies

if TYPE_CHECKING:
    from mujoco import MjModel

_ROUNDING = 1e-14  # [-] of the greatest entry


def check_hinges(model: "MjModel", source: Source) -> None:
    """Raise `InvalidFile` unless all joints of a model are free hinges.

    Active equality constraints are refused as well, because joints tied to each other have fewer degrees of freedom.
    """
    import mujoco

    file = said(source)
    for i in np.flatnonzero(model.jnt_type != int(mujoco.mjtJoint.mjJNT_HINGE)).tolist():
        raise InvalidFile(file, f"joint {name_of(model.joint(i), i)} is no hinge; an arm's joints are hinges")
    for i in np.flatnonzero(model.eq_active0).tolist():
        raise InvalidFile(
            file,
            f"the equality constraint {name_of(model.equality(i), i)} ties joints or bodies together; an arm's joints "
            "are free: leave it out, or fix the body instead",
        )


def without_formulas(model: "MjModel") -> str:
    """Return a description of the bodies' physics outside the formulas of `TreeBodies`; "" if there are none."""
    found = {
        "a fluid": bool(model.opt.density or model.opt.viscosity),
        "gravity compensation": bool(np.any(model.body_gravcomp)),
        "springs along tendons": bool(np.any(model.tendon_stiffness)),
        "damping along tendons": bool(np.any(model.tendon_damping)),
        "armature of tendons": bool(np.any(getattr(model, "tendon_armature", 0.0))),
    }
    return ", ".join(what for what, there in found.items() if there)


def tree_of(model: "MjModel", source: Source) -> TreeBodies:
    """Return the bodies of a model whose joints are hinges. Raises `InvalidFile`."""
    links, frames = linkage_of(model, source)
    n = len(links)
    mass, first, second = np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3, 3))  # moments about the links' origins
    for body in range(1, model.nbody):
        link, R, p = frames[body]
        if link < 0:
            continue  # fixed to the ground
        m, c = float(model.body_mass[body]), p + R @ model.body_ipos[body]
        turned = R @ rotation(model.body_iquat[body])
        mass[link] += m
        first[link] += m * c
        second[link] += turned @ np.diag(model.body_inertia[body]) @ turned.T + m * _about(c)
    centre = np.divide(first, mass[:, None], out=np.zeros((n, 3)), where=mass[:, None] > 0)
    inertia = second - mass[:, None, None] * np.array([_about(c) for c in centre])
    centre, inertia = _clean(centre), _clean((inertia + inertia.swapaxes(1, 2)) / 2)
    place = model.jnt_qposadr
    return TreeBodies(
        tuple(map(_tidy, links)), mass, centre, inertia, model.dof_damping[model.jnt_dofadr],
        model.dof_armature[model.jnt_dofadr], model.jnt_stiffness, model.qpos_spring[place], model.opt.gravity.copy(),
    )  # fmt: skip


def _clean(array: Array) -> Array:
    """Return `array` with zeros in place of rounding errors, which makes formulas shorter."""
    return np.where(np.abs(array) > _ROUNDING * np.abs(array).max(initial=0.0), array, 0.0)


def _tidy(link: Link) -> Link:
    """Return a link with zeros in place of rounding errors."""
    rows = tuple(map(tuple, _clean(np.array(link.orientation)).tolist()))
    place, axis = (tuple(_clean(np.array(row)).tolist()) for row in (link.origin, link.axis))
    return replace(link, origin=place, axis=axis, orientation=rows)


def _about(c: Array) -> Array:
    """Return the inertia (3, 3) of a unit mass at `c` (3,) [m] about the origin [m²]."""
    return np.asarray(c @ c * np.eye(3) - np.outer(c, c))
