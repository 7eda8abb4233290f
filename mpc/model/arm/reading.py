"""Arms read from MuJoCo models: tendons are the muscles, and hinges move the bodies.

Straight tendons through sites, sums of angles, and bodies with only masses, armatures, springs and damping become
formulas. MuJoCo itself evaluates everything else (`mpc.model.arm.mechanics.mujoco_mechanics`).
"""

from collections.abc import Sequence
from copy import copy
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allocator.calculus import Array
from allocator.errors import InvalidFile
from allocator.mechanism import Mechanism
from allocator.mechanism.endpoint import Endpoint, hand_of_model
from allocator.mechanism.routes import Routes
from allocator.mechanism.routes.mjcf import Source, load, muscle_lengths, name_of, read_mjcf, said
from allocator.muscles import Muscle
from mpc.model.arm.mechanics.mujoco_mechanics import Mechanics, MujocoBodies, MujocoTendons
from mpc.model.arm.mechanics.tree import TreeBodies, check_hinges, tree_of, without_formulas

if TYPE_CHECKING:
    from mujoco import MjModel


class Read(NamedTuple):
    """Result of reading a model."""

    model: "MjModel"  # an `MjModel` for a `MujocoPlant`, whose actuators are switched off
    mechanism: Mechanism
    bodies: TreeBodies | MujocoBodies
    cable: Array  # (m,) [m] for a `MujocoPlant`
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
    check_hinges(model, source)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    lengths, cables = muscle_lengths(model, source, rest_length, cable, contraction)
    mechanics, unread = Mechanics(model), [without_formulas(model), _winding(model)]
    bodies = MujocoBodies(mechanics) if any(unread) else tree_of(model, source)
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
    return Read(model, mechanism, bodies, cables, ", ".join(filter(None, unread)), _left_out(model), dry, point, name)


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
    return ", ".join(what for what, there in found.items() if there)


def _no_contacts(model: "MjModel") -> bool:
    import mujoco

    return bool(model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CONTACT))
