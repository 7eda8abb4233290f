"""Reading of a MuJoCo model: tendons as `Sites` or `Pulleys`, bodies and sites as points on links.

Spatial tendons through sites are `Sites`, fixed tendons (sums of joint angles) `Pulleys`. A model with the text `MARK`
has rest length and cable of every tendon in its user data; `mpc.arm.mjcf.to_mjcf` writes such models. Only reading
needs MuJoCo.
"""

from collections.abc import Callable
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, Union

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidFile, InvalidInput
from allocator.mechanism.routes.base import LONGEST, IdleMuscle, Routes, per_muscle, rest_lengths
from allocator.mechanism.routes.linkage import GROUND, Link, Linkage, Site
from allocator.mechanism.routes.pulleys import Pulleys
from allocator.mechanism.routes.sites import Sites

if TYPE_CHECKING:
    from mujoco import MjModel

Source: TypeAlias = Union[str, PathLike[str], "MjModel"]
"""A file, MJCF text (which begins with "<") or a model of MuJoCo."""

MARK = "antagonist"
"""Name of the custom text of models with (rest length, cable) [m] as user data of their tendons."""


@dataclass(frozen=True)
class Model:
    """Contents of an MJCF file: the routes, the names, the joints' ranges."""

    routes: Routes
    muscles: tuple[str, ...]  # names of the tendons (m,)
    joints: tuple[str, ...]  # (n,)
    ranges: tuple[tuple[float, float], ...] | None  # of the joints [rad or m]; None unless all are limited


def read_mjcf(
    source: Source,
    rest_length: ArrayLike | None = None,
    cable: ArrayLike | None = None,
    contraction: ArrayLike | None = None,
) -> Model:
    """Read the tendons of a `source` of `load`; `rest_length` and `cable` [m] are those of `Sites`, or of the model.

    The muscles' `contraction` [-] in the model's own posture may replace `cable`.

    Raises `MissingPackage` without MuJoCo; `InvalidFile` for a file that MuJoCo cannot read, without tendons, with
    joints other than hinges and slides, or with tendons that are neither all straight lines between sites nor all
    fixed; `InvalidInput` if the rest length is unknown.
    """
    import mujoco

    model, file, wrap = load(source), said(source), mujoco.mjtWrap
    if not model.ntendon:
        raise InvalidFile(file, "has no tendons; the tendons of the model are the muscles")
    links, frames = linkage_of(model, source)
    lengths = muscle_lengths(model, source, rest_length, cable, contraction)
    try:
        if (model.wrap_type == int(wrap.mjWRAP_JOINT)).all():
            routes: Routes = _pulleys(model, *lengths)
        else:
            paths = [_path(file, model, j, frames, int(wrap.mjWRAP_SITE)) for j in range(model.ntendon)]
            routes = Sites(lengths[0], links, paths, lengths[1])
    except IdleMuscle as idle:
        name = name_of(model.tendon(idle.muscle), idle.muscle)
        raise InvalidFile(file, f"tendon {name} has no arm at any joint; it moves nothing") from None
    except InvalidInput as error:
        raise error if isinstance(error, InvalidFile) else InvalidFile(file, str(error)) from None
    limited = bool(np.all(model.jnt_limited))
    return Model(
        routes,
        tuple(name_of(model.tendon(j), j) for j in range(model.ntendon)),
        tuple(name_of(model.joint(i), i) for i in range(model.njnt)),
        tuple((float(low), float(high)) for low, high in model.jnt_range) if limited else None,
    )


def read_point(file: Source, name: str) -> tuple[Linkage, Site]:
    """Return the linkage of an MJCF `file`, and the point of the site, or else of the body's origin, called `name`.

    Raises `MissingPackage` without MuJoCo; `InvalidFile` for a file that MuJoCo cannot read, without joints, with
    joints other than hinges and slides, or without such a site or body.
    """
    model = load(file)
    links, frames = linkage_of(model, file)
    sites, bodies = [model.site(i).name for i in range(model.nsite)], [model.body(i).name for i in range(model.nbody)]
    if name in sites:
        i = sites.index(name)
        link, R, p = frames[model.site_bodyid[i]]
        p = p + R @ model.site_pos[i]
    elif name in bodies:
        link, R, p = frames[bodies.index(name)]
    else:
        known = ", ".join(filter(None, [*sites, *bodies]))
        raise InvalidFile(said(file), f"has no site or body called {name!r}; it has {known}")
    return Linkage(links), Site(link, tuple(p.tolist()))


def held_torque(source: Source) -> Callable[[Array], Array]:
    """Return the torques (…, n) [N·m] that balance gravity and springs of a model, as a function of postures (…, n).

    Raises as `load`.
    """
    import mujoco

    model = load(source)
    data, places, speeds = mujoco.MjData(model), model.jnt_qposadr, model.jnt_dofadr

    def at(q: Array) -> Array:
        data.qpos[places] = q
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        return np.asarray((data.qfrc_bias - data.qfrc_passive)[speeds])

    return lambda q: np.apply_along_axis(at, -1, q)


def load(source: Source) -> "MjModel":
    """Return an `MjModel`.

    Raises `InvalidFile` if MuJoCo cannot read it, `InvalidInput` if it is not a model, and `MissingPackage`.
    """
    import mujoco

    if isinstance(source, mujoco.MjModel):
        return source
    if not isinstance(source, str | PathLike):
        raise InvalidInput(f"model: a {type(source).__name__} is neither a file, nor MJCF text, nor a mujoco.MjModel")
    text = isinstance(source, str) and source.lstrip().startswith("<")
    if not text and not Path(source).is_file():
        raise InvalidFile(source, "does not exist")
    try:
        model = mujoco.MjModel.from_xml_string(source) if text else mujoco.MjModel.from_xml_path(str(source))
        for names in (model.names, model.text_data):  # MuJoCo does not check these bytes, also of included files
            names.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InvalidFile(
            said(source), f"is not in UTF-8 ({error.reason}); save it and the files it includes as UTF-8"
        ) from None
    except (ValueError, mujoco.FatalError) as error:
        raise InvalidFile(said(source), f"is not read by MuJoCo ({' '.join(str(error).split())})") from None
    _refuse_swapped_ranges(model, source)
    return model


def _refuse_swapped_ranges(model: "MjModel", source: Source) -> None:
    """Raise `InvalidFile` for a range whose first number is the greater one; MuJoCo ignores such a range silently."""
    for i in range(model.njnt):
        low, high = model.jnt_range[i].tolist()
        if low > high:
            name, ends = name_of(model.joint(i), i), f"{low:.4g} to {high:.4g} rad (or m)"
            raise InvalidFile(said(source), f"joint {name} has the range {ends}; the lower end comes first")


def said(source: Source) -> str:
    """Return the name of a model's source for messages."""
    if isinstance(source, str | PathLike) and not str(source).lstrip().startswith("<"):
        return str(source)
    return "the MuJoCo model"


def tendon_lengths(
    model: "MjModel", source: Source, rest_length: ArrayLike | None, cable: ArrayLike | None
) -> tuple[ArrayLike, ArrayLike]:
    """Return rest length and cable [m] as given, or those of the model if `rest_length` is None.

    Raises `InvalidInput` if neither has them.
    """
    if rest_length is not None:
        return rest_length, 0.0 if cable is None else cable
    if cable is not None:
        raise InvalidInput("cable [m] is given without rest_length [m]; give both, or neither of a model that tells")
    if not tells(model):
        raise InvalidInput(f"rest_length [m] of the muscles has to be given: {said(source)} does not tell")
    return model.tendon_user[:, 0], model.tendon_user[:, 1]


def tells(model: "MjModel") -> bool:
    """Return whether a model has rest length and cable of its tendons."""
    import mujoco

    return bool(model.nuser_tendon == 2 and mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, MARK) >= 0)


def muscle_lengths(
    model: "MjModel",
    source: Source,
    rest_length: ArrayLike | None,
    cable: ArrayLike | None,
    contraction: ArrayLike | None,
) -> tuple[Array, Array]:
    """Return rest lengths and cables (m,) [m], `cable` or the `contraction` in the model's own posture being given.

    Raises `InvalidInput`.
    """
    m, now = int(model.ntendon), _own_lengths(model)
    if (long := (now > LONGEST) & _drawn(model)).any():
        j = int(np.argmax(long))
        name = name_of(model.tendon(j), j)
        raise InvalidFile(said(source), f"tendon {name} is {now[j]:.4g} m long; lengths in a model are in metres")
    if rest_length is None and not tells(model):
        listed = ", ".join(f"{1e3 * length:.4g}" for length in now.tolist())
        raise InvalidInput(
            f"give the rest lengths of the muscles (rest_length [m], --rest-length [mm]): {said(source)} has none; its "
            f"tendons are {listed} mm long in its own posture"
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


def _own_lengths(model: "MjModel") -> Array:
    """Return the lengths (m,) [m] of the tendons in the model's own posture."""
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_fwdPosition(model, data)
    return np.array(data.ten_length)


def _pulleys(model: "MjModel", rest_length: ArrayLike, cable: ArrayLike) -> Pulleys:
    """Return the routes of fixed tendons, l = Σ coef·q - cable."""
    arms = np.zeros((model.ntendon, model.njnt))
    for j in range(model.ntendon):
        for w in range(int(model.tendon_adr[j]), int(model.tendon_adr[j] + model.tendon_num[j])):
            arms[j, int(model.wrap_objid[w])] -= model.wrap_prm[w]
    L = np.broadcast_to(np.asarray(rest_length, float), (model.ntendon,))
    return Pulleys(rest_length, arms, 1 + np.asarray(cable, float) / L)


def linkage_of(model: "MjModel", source: Source) -> tuple[list[Link], list[tuple[int, Array, Array]]]:
    """Return the links of a model, one per joint, and of every body (link, rotation, position in the link's frame).

    `source` is the model's name in messages. Raises `InvalidFile` without joints, and for joints other than hinges and
    slides.
    """
    import mujoco

    file = said(source)
    if not model.njnt:
        raise InvalidFile(file, "has no joints")
    moving, still = (int(mujoco.mjtJoint.mjJNT_HINGE), "hinge"), (int(mujoco.mjtJoint.mjJNT_SLIDE), "slide")
    for i in range(model.njnt):
        if model.jnt_type[i] not in (moving[0], still[0]):
            raise InvalidFile(file, f"joint {name_of(model.joint(i), i)} is neither a hinge nor a slide")
    return _links(model, dict((moving, still)))


def name_of(element: Any, index: int) -> str:
    """Return the name of an element of a model, or its number."""
    return str(element.name) or str(index + 1)


def _links(model: "MjModel", kinds: dict[int, str]) -> tuple[list[Link], list[tuple[int, Array, Array]]]:
    """Return the links, one per joint, and of every body (link, rotation, position in the link's frame)."""
    links: list[Link] = []
    frames: list[tuple[int, Array, Array]] = [(GROUND, np.eye(3), np.zeros(3))]  # of the world
    for body in range(1, model.nbody):
        link, R, p = frames[model.body_parentid[body]]
        R, p = R @ rotation(model.body_quat[body]), p + R @ model.body_pos[body]
        first = int(model.body_jntadr[body])
        for j in range(first, first + int(model.body_jntnum[body])):
            anchor = model.jnt_pos[j]
            links.append(
                Link(
                    parent=link,
                    origin=tuple((p + R @ anchor).tolist()),
                    axis=tuple(model.jnt_axis[j].tolist()),
                    kind=kinds[int(model.jnt_type[j])],  # type: ignore[arg-type]  # one of both
                    orientation=tuple(map(tuple, R.tolist())),
                    zero=float(model.qpos0[model.jnt_qposadr[j]]),
                )
            )
            link, R, p = len(links) - 1, np.eye(3), -anchor
        frames.append((link, R, p))
    return links, frames


def _path(file: Source, model: "MjModel", tendon: int, frames: list[tuple[int, Array, Array]], site: int) -> list[Site]:
    first = int(model.tendon_adr[tendon])
    wraps = range(first, first + int(model.tendon_num[tendon]))
    if any(int(model.wrap_type[w]) != site for w in wraps):
        what = "runs round a geom or a pulley, or is fixed (a sum of angles)"
        name = name_of(model.tendon(tendon), tendon)
        raise InvalidFile(
            file, f"tendon {name} {what}; only straight lines between sites are read: use Pulleys or Tables"
        )
    sites = []
    for w in wraps:
        s = int(model.wrap_objid[w])
        link, R, p = frames[model.site_bodyid[s]]
        sites.append(Site(link, tuple((p + R @ model.site_pos[s]).tolist())))
    return sites


def rotation(quaternion: Array) -> Array:
    """Return the rotation matrix (3, 3) of a quaternion (w, x, y, z)."""
    from scipy.spatial.transform import Rotation

    w, x, y, z = quaternion
    return np.asarray(Rotation.from_quat([x, y, z, w]).as_matrix())
