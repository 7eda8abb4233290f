"""The spatial tendons of a MuJoCo model are read as `Sites`, its bodies and sites as points on links.

MuJoCo is not needed afterwards.
"""

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidFile, InvalidInput
from allocator.mechanism.routes.linkage import GROUND, Link, Linkage, Site
from allocator.mechanism.routes.sites import Sites


@dataclass(frozen=True)
class Model:
    """A `Model` is what is taken from an MJCF file: the routes, the names, the joints' ranges."""

    routes: Sites
    muscles: tuple[str, ...]  # names of the tendons (m,)
    joints: tuple[str, ...]  # (n,)
    ranges: tuple[tuple[float, float], ...] | None  # of the joints [rad or m]; None unless all are limited


def read_mjcf(file: str | PathLike[str], rest_length: Any, cable: Any = 0.0) -> Model:
    """Read the tendons of an MJCF (or MuJoCo's URDF) `file`; `rest_length` and `cable` [m] as of `Sites`.

    Raises `MissingPackage` without MuJoCo, `InvalidFile` for a file that MuJoCo does not read, without tendons, with
    joints other than hinges and slides, or with tendons that are no straight lines between sites.
    """
    mujoco, model = _read(file)
    if not model.ntendon:
        raise InvalidFile(file, "has no tendons; the tendons of the model are the muscles")
    links, frames = _linkage(file, mujoco, model)
    paths = [_path(file, model, j, frames, int(mujoco.mjtWrap.mjWRAP_SITE)) for j in range(model.ntendon)]
    try:
        routes = Sites(rest_length, links, paths, cable)
    except InvalidInput as error:
        raise InvalidFile(file, str(error)) from None
    limited = bool(np.all(model.jnt_limited))
    return Model(
        routes,
        tuple(_name(model.tendon(j), j) for j in range(model.ntendon)),
        tuple(_name(model.joint(i), i) for i in range(model.njnt)),
        tuple((float(low), float(high)) for low, high in model.jnt_range) if limited else None,
    )


def read_point(file: str | PathLike[str], name: str) -> tuple[Linkage, Site]:
    """Return the linkage of an MJCF `file`, and the point of the site, or else of the body's origin, of this `name`.

    Raises `MissingPackage` without MuJoCo, `InvalidFile` for a file that MuJoCo does not read, without joints, with
    joints other than hinges and slides, or without such a site or body.
    """
    mujoco, model = _read(file)
    links, frames = _linkage(file, mujoco, model)
    sites, bodies = [model.site(i).name for i in range(model.nsite)], [model.body(i).name for i in range(model.nbody)]
    if name in sites:
        i = sites.index(name)
        link, R, p = frames[model.site_bodyid[i]]
        p = p + R @ model.site_pos[i]
    elif name in bodies:
        link, R, p = frames[bodies.index(name)]
    else:
        known = ", ".join(filter(None, [*sites, *bodies]))
        raise InvalidFile(file, f"has no site or body called {name!r}; it has {known}")
    return Linkage(links), Site(link, tuple(p.tolist()))


def _read(file: str | PathLike[str]) -> tuple[Any, Any]:
    """Return the module mujoco and its model of the `file`."""
    import mujoco

    if not Path(file).is_file():
        raise InvalidFile(file, "does not exist")
    try:
        model = mujoco.MjModel.from_xml_path(str(file))
    except (ValueError, mujoco.FatalError) as error:
        raise InvalidFile(file, f"is not read by MuJoCo ({error})") from None
    return mujoco, model


def _linkage(file: Any, mujoco: Any, model: Any) -> tuple[list[Link], list[tuple[int, Array, Array]]]:
    """Return the links and the places of the bodies, see `_links`."""
    if not model.njnt:
        raise InvalidFile(file, "has no joints")
    moving, still = (int(mujoco.mjtJoint.mjJNT_HINGE), "hinge"), (int(mujoco.mjtJoint.mjJNT_SLIDE), "slide")
    for i in range(model.njnt):
        if model.jnt_type[i] not in (moving[0], still[0]):
            raise InvalidFile(file, f"joint {_name(model.joint(i), i)} is neither a hinge nor a slide")
    return _links(model, dict((moving, still)))


def _name(element: Any, index: int) -> str:
    return str(element.name) or str(index + 1)


def _links(model: Any, kinds: dict[int, str]) -> tuple[list[Link], list[tuple[int, Array, Array]]]:
    """Return the links, one a joint, and of every body (link, rotation, position in the link's frame)."""
    links: list[Link] = []
    frames: list[tuple[int, Array, Array]] = [(GROUND, np.eye(3), np.zeros(3))]  # of the world
    for body in range(1, model.nbody):
        link, R, p = frames[model.body_parentid[body]]
        R, p = R @ _matrix(model.body_quat[body]), p + R @ model.body_pos[body]
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


def _path(file: Any, model: Any, tendon: int, frames: list[tuple[int, Array, Array]], site: int) -> list[Site]:
    first = int(model.tendon_adr[tendon])
    wraps = range(first, first + int(model.tendon_num[tendon]))
    if any(int(model.wrap_type[w]) != site for w in wraps):
        what = "runs round a geom or a pulley, or is fixed (a sum of angles)"
        name = _name(model.tendon(tendon), tendon)
        raise InvalidFile(
            file, f"tendon {name} {what}; only straight lines between sites are read: use Pulleys or Tables"
        )
    sites = []
    for w in wraps:
        s = int(model.wrap_objid[w])
        link, R, p = frames[model.site_bodyid[s]]
        sites.append(Site(link, tuple((p + R @ model.site_pos[s]).tolist())))
    return sites


def _matrix(quaternion: Array) -> Array:
    """Return the rotation matrix of a unit quaternion (w, x, y, z)."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


__all__ = ["Model", "read_mjcf", "read_point"]
