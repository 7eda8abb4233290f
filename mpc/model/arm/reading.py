"""Arms read from MuJoCo models: tendons are the muscles, and hinges move the bodies.

Straight tendons through sites, sums of angles, and bodies with only masses, armatures, springs and damping become
formulas. MuJoCo itself evaluates everything else (`mpc.model.arm.mechanics.mujoco_mechanics`).
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidFile, InvalidInput
from allocator.mechanism import Mechanism
from allocator.mechanism.endpoint import Endpoint
from allocator.mechanism.routes import Routes
from allocator.mechanism.routes.base import per_muscle, rest_lengths
from allocator.mechanism.routes.mjcf import Source, load, name_of, read_mjcf, said, tells, tendon_lengths
from allocator.muscles import Muscle
from mpc.model.arm.mechanics.mujoco_mechanics import Mechanics, MujocoBodies, MujocoTendons
from mpc.model.arm.mechanics.tree import TreeBodies, check_hinges, tree_of, without_formulas

if TYPE_CHECKING:
    from mujoco import MjModel

_STILL = 1e-9  # [m/rad] or of the greatest: a smaller motion of a point counts as none


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
    lengths, cables = _lengths(model, source, rest_length, cable, contraction)
    mechanics, unread = Mechanics(model), [without_formulas(model), _winding(model)]
    bodies = MujocoBodies(mechanics) if any(unread) else tree_of(model, source)
    limited = bool(np.all(model.jnt_limited))
    routes: Routes = (
        MujocoTendons.of(mechanics, lengths, cables) if unread[1] else read_mjcf(model, lengths, cables).routes
    )
    mechanism = Mechanism(
        routes,
        muscles,  # type: ignore[arg-type]  # one or a sequence, see its __post_init__
        pressure_limits,
        angle_limits=tuple(map(tuple, model.jnt_range.tolist())) if limited else None,
        muscle_names=tuple(name_of(model.tendon(j), j) for j in range(model.ntendon)),
        joint_names=tuple(name_of(model.joint(i), i) for i in range(model.njnt)),
    )
    name, _, axes = (hand or _last_site(model)).partition(":")
    point = Endpoint.from_mjcf(model, name, axes=axes or "xyz") if name else None
    if point is not None and not axes and not (point := _moved(point, mechanism)):
        name = ""
    dry = np.array(model.dof_frictionloss[model.jnt_dofadr])
    return Read(model, mechanism, bodies, cables, ", ".join(filter(None, unread)), _left_out(model), dry, point, name)


def _lengths(
    model: "MjModel",
    source: Source,
    rest_length: ArrayLike | None,
    cable: ArrayLike | None,
    contraction: ArrayLike | None,
) -> tuple[Array, Array]:
    """Return rest lengths and cables (m,) [m]. Raises `InvalidInput`."""
    m, now = int(model.ntendon), Mechanics(model).tendons(model.qpos0[model.jnt_qposadr][None])[0][0]
    if rest_length is None and not tells(model):
        listed = ", ".join(f"{1e3 * length:.4g}" for length in now.tolist())
        raise InvalidInput(
            f"the rest lengths of the muscles have to be given: {said(source)} does not tell; its tendons are {listed} "
            "mm long in its own posture"
        )
    if contraction is None or rest_length is None:
        if contraction is not None:
            raise InvalidInput("contraction is given without the rest lengths of the muscles")
        lengths, cables = tendon_lengths(model, source, rest_length, cable)
        return np.array(rest_lengths("muscles", lengths, m)), per_muscle("cable", cables, m, "m")
    if cable is not None:
        raise InvalidInput("cable and contraction are both given; each of them determines where the muscles begin")
    lengths, eps = np.array(rest_lengths("muscles", rest_length, m)), per_muscle("contraction", contraction, m, "-")
    if (wrong := ~((eps >= -0.1) & (eps <= 0.5))).any():
        raise InvalidInput(f"contraction{checks.at(eps, wrong)} has to be a ratio of -0.1 to 0.5, not per cent")
    cables = now - lengths * (1 - eps)
    if (short := (cables < 0) & _drawn(model)).any():
        j = int(np.argmax(short))
        raise InvalidInput(
            f"tendon {name_of(model.tendon(j), j)} of {said(source)} is {1e3 * now[j]:.4g} mm long in the model's own "
            f"posture, shorter than its muscle, {1e3 * (now - cables)[j]:.4g} mm"
        )
    return lengths, cables


def _drawn(model: "MjModel") -> Mask:
    """Return which tendons (m,) run through space; the others are sums of angles, which have no lengths."""
    import mujoco

    return np.asarray(model.wrap_type[model.tendon_adr] != int(mujoco.mjtWrap.mjWRAP_JOINT))


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


def _moved(point: Endpoint, mechanism: Mechanism) -> Endpoint | None:
    """Return the point with at most as many coordinates as joints, those that they move most; None without any."""
    low, high = (-1.0, 1.0) if mechanism.angle_limits is None else np.transpose(mechanism.angle_limits)
    shares = np.random.default_rng(0).random((32, mechanism.n))
    J = point.jacobian(low + shares * (np.asarray(high) - low))
    sizes = np.linalg.svd(J, compute_uv=False)
    rank = int((sizes.max(axis=0) > _STILL * max(sizes.max(), _STILL)).sum())
    most = np.sort(np.argsort(-(J**2).sum(axis=(0, 2)), kind="stable")[:rank])
    kinematics: Any = point.kinematics
    return replace(point, kinematics=replace(kinematics, axes="".join("xyz"[i] for i in most))) if rank else None


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
