"""Arms read from MuJoCo models: tendons are the muscles, and hinges move the bodies.

Straight tendons through sites, sums of angles, and bodies with only masses, armatures, springs and damping become
formulas. MuJoCo itself evaluates everything else (`mpc.model.arm.mujoco_mechanics`).
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allocator.calculus import Array
from allocator.errors import InvalidFile
from allocator.mechanism import Mechanism
from allocator.mechanism.endpoint import Endpoint, hand_of_model
from allocator.mechanism.routes import Routes
from allocator.mechanism.routes.linkage import Link
from allocator.mechanism.routes.mjcf import Source, linkage_of, load, muscle_lengths, name_of, read_mjcf, rotation, said
from allocator.muscles import Muscle
from mpc.model.arm.mujoco_mechanics import Mechanics, MujocoBodies, MujocoTendons
from mpc.model.arm.tree import TreeBodies

if TYPE_CHECKING:
    from mujoco import MjModel

_ROUNDING = 1e-14  # [-] of the greatest entry


class Read(NamedTuple):
    """Result of reading a model."""

    model: "MjModel"  # an `MjModel` for a `MujocoPlant`, whose actuators are switched off
    mechanism: Mechanism
    bodies: TreeBodies | MujocoBodies
    asked_of_mujoco: str  # parts without formulas; "" if there are none
    left_out: str  # parts of the model missing in the prediction; "" if there are none
    dry: Array  # (n,) dry friction of the joints [N·m]
    hand: Endpoint | None  # the named site, or the last site on the last body with sites
    hand_name: str


def read_arm(
    source: Source,
    muscles: Muscle | Sequence[Muscle],
    rest_length: ArrayLike | None = None,
    cable: ArrayLike | None = None,
    contraction: ArrayLike | None = None,
    pressure_limits: tuple[float, float] = (0.0, 5e5),
    hand: str | None = None,
) -> Read:
    """Read an arm from a file, MJCF text or an `MjModel`.

    `rest_length` and `cable` [m] are numbers or rows (m,); the muscles' `contraction` [-] in the model's own posture
    may replace `cable`. `hand` is the name of a site or body, followed by ":xy" for example if only some of its
    coordinates count. Raises `InvalidFile`, `InvalidInput` and `MissingPackage`.
    """
    import mujoco

    model = copy(load(source))
    if not model.ntendon:
        raise InvalidFile(said(source), "has no tendons; the tendons of the model are the muscles")
    _check_hinges(model, source)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    lengths, cables = muscle_lengths(model, source, rest_length, cable, contraction)
    mechanics, unread = Mechanics(model), [_without_formulas(model), _winding(model)]
    bodies = MujocoBodies(mechanics) if any(unread) else _tree_of(model, source)
    limited = bool(np.all(model.jnt_limited))
    routes: Routes = (
        MujocoTendons.of(mechanics, lengths, cables) if unread[1] else read_mjcf(source, lengths, cables).routes
    )
    mechanism = Mechanism(
        routes,
        muscles,  # type: ignore[arg-type]  # one or a sequence, see its __post_init__
        pressure_limits,
        angle_limits=tuple(map(tuple, model.jnt_range.tolist())) if limited else None,
        muscle_names=tuple(name_of(model.tendon(j), j) for j in range(model.ntendon)),
        joint_names=tuple(name_of(model.joint(i), i) for i in range(model.njnt)),
    )
    named = hand or _last_site(model)
    point = hand_of_model(source, named, mechanism) if named else None
    name = "" if point is None else named.partition(":")[0]
    dry = np.array(model.dof_frictionloss[model.jnt_dofadr])
    return Read(model, mechanism, bodies, ", ".join(filter(None, unread)), _left_out(model), dry, point, name)


def _winding(model: "MjModel") -> str:
    """Return a list of tendons that are not straight lines, unless all are sums of angles; "" if there are none."""
    import mujoco

    kinds = np.asarray(model.wrap_type)
    if (kinds == int(mujoco.mjtWrap.mjWRAP_JOINT)).all() or (kinds == int(mujoco.mjtWrap.mjWRAP_SITE)).all():
        return ""
    odd = []
    for j in range(model.ntendon):
        first = int(model.tendon_adr[j])
        if (kinds[first : first + int(model.tendon_num[j])] != int(mujoco.mjtWrap.mjWRAP_SITE)).any():
            odd.append(name_of(model.tendon(j), j))
    return f"the way of {', '.join(odd)}"


def _last_site(model: "MjModel") -> str:
    """Return the name of the last named site, on the last body with such sites; "" without any."""
    named = [(int(model.site_bodyid[i]), i) for i in range(model.nsite) if model.site(i).name]
    return str(model.site(max(named)[1]).name) if named else ""


def _left_out(model: "MjModel") -> str:
    """Return a description of the parts of a model that are missing in the prediction of its motion."""
    found = {
        f"{model.nu} actuators (switched off)": bool(model.nu),
        "dry friction of tendons": bool(np.any(model.tendon_frictionloss)),
        "contacts": bool(np.any((model.geom_contype != 0) & (model.geom_bodyid != 0))) and not _no_contacts(model),
        "limits of tendons": bool(np.any(model.tendon_limited)),
    }
    return _those(found)


def _no_contacts(model: "MjModel") -> bool:
    import mujoco

    return bool(model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CONTACT))


def _those(found: dict[str, bool]) -> str:
    """Return the names of those that are there, with commas."""
    return ", ".join(what for what, there in found.items() if there)


# --- bodies as formulas -----------------------------------------------------------------------------------------------


def _check_hinges(model: "MjModel", source: Source) -> None:
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


def _without_formulas(model: "MjModel") -> str:
    """Return a description of the bodies' physics outside the formulas of `TreeBodies`; "" if there are none."""
    found = {
        "a fluid": bool(model.opt.density or model.opt.viscosity),
        "gravity compensation": bool(np.any(model.body_gravcomp)),
        "springs along tendons": bool(np.any(model.tendon_stiffness)),
        "damping along tendons": bool(np.any(model.tendon_damping)),
        "armature of tendons": bool(np.any(getattr(model, "tendon_armature", 0.0))),
    }
    return _those(found)


def _tree_of(model: "MjModel", source: Source) -> TreeBodies:
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
        model,
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
