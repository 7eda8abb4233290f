"""An arm in the plane is drawn with its muscles, coloured by their pressures, and the stiffness ellipse of its hand."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.mechanism.endpoint import Endpoint
from allocator.mechanism.endpoint.points import LinkagePoint
from allocator.mechanism.mechanism import Mechanism
from allocator.mechanism.pictures.workspace import ellipse
from allocator.mechanism.routes import Link, Pulleys, Sites
from allocator.mechanism.routes.linkage import Linkage
from allocator.presentation.plotting import GREY, name_axes, new_axes
from allocator.units import BAR

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable

_BONE, _ELLIPSE = "#c9c9c9", "#1f4e79"
_BEFORE, _BEHIND = 0.65, 0.25  # of a link: how far from the joint a muscle round pulleys is fixed
_APART = 0.8  # of its arms: how much farther out a muscle lies for every further joint that it crosses
_SMALLEST = 1e-6  # [m] an arm below it is none


def plot_arm(
    mechanism: Mechanism,
    endpoint: Endpoint,
    q: ArrayLike,
    P: ArrayLike,
    *,
    force: ArrayLike = 0.0,
    scale: float | None = None,
    axes: "Axes | None" = None,
    colorbar: bool = True,
) -> "Axes":
    """Draw an arm in the plane at the posture `q` (n,) [rad] with pressures `P` (m,) [Pa], and its hand's stiffness.

    Muscles are lines, the darker the lower their pressure: those between sites where they run; those round pulleys
    beside the links, on the side of their arms, and farther out the more joints they cross. The ellipse is K_x u of
    unit displacements u, at `scale` [m per N/m], by default a third of the arm long. `endpoint` has to
    be `Endpoint.planar`, or another point on links in the plane. Returns the Matplotlib axes. Raises `InvalidInput`.
    """
    linkage, posture, pressures = _checked(mechanism, endpoint, q, P)
    axes = new_axes(5.6, 4.8) if axes is None else axes
    axes.set_aspect("equal")
    name_axes(axes, "x [m]", "y [m]")
    hand = endpoint.position(posture)
    joints = np.array([frame.origin[:2] for frame in linkage.frames(posture)[:-1]])
    bones = np.vstack([joints, hand])
    axes.plot(*bones.T, color=_BONE, linewidth=9, solid_capstyle="round", zorder=1)
    axes.plot(*joints.T, "o", color="white", markeredgecolor=GREY, markersize=9, zorder=2)
    colours = _colours(mechanism)
    for line, pressure in zip(_lines(mechanism, bones, posture), pressures, strict=True):
        axes.plot(*line.T, color=colours.to_rgba(pressure / BAR), linewidth=2.4, zorder=3)
    K_x = endpoint.stiffness(posture, mechanism.stiffness(posture, pressures), force)
    if np.isfinite(K_x).all():
        curve = ellipse(K_x)
        reach = np.hypot(*np.diff(bones, axis=0).T).sum()
        size = reach / (3 * np.hypot(*curve).max()) if scale is None else scale
        axes.plot(*(hand[:, None] + size * curve), color=_ELLIPSE, linewidth=1.8, zorder=4)
    if colorbar:
        axes.figure.colorbar(colours, ax=axes, label="gauge pressure [bar]", shrink=0.7)
    return axes


def _checked(mechanism: Mechanism, endpoint: Endpoint, q: object, P: object) -> tuple[Linkage, Array, Array]:
    """Return the links, the posture and the pressures. Raises `InvalidInput`."""
    if not isinstance(endpoint, Endpoint) or not isinstance(endpoint.kinematics, LinkagePoint):
        raise InvalidInput("an arm is drawn by its links; give an endpoint on links, such as Endpoint.planar")
    links: tuple[Link, ...] = endpoint.kinematics.linkage.links
    chain = all(link.parent == i - 1 and link.kind == "hinge" for i, link in enumerate(links))
    if endpoint.kinematics.axes != "xy" or not chain or any(abs(link.axis[2]) < 1 for link in links):
        raise InvalidInput("only an arm in the plane xy is drawn: hinges about z, each on the link before")
    if endpoint.n != mechanism.n:
        raise InvalidInput(f"the endpoint has n = {endpoint.n} joints, the mechanism n = {mechanism.n}")
    posture, pressures = mechanism.posture(q), mechanism.pressures("P", P)
    for name, array in (("q", posture), ("P", pressures)):
        if array.ndim > 1:
            raise InvalidInput(f"{name} = {checks.brief(array)}: one posture is drawn at a time, with one set of P")
    return endpoint.kinematics.linkage, posture, pressures


def _lines(mechanism: Mechanism, bones: Array, q: Array) -> list[Array]:
    """Return the lines (k, 2) of the muscles."""
    if isinstance(mechanism.routes, Sites):
        return [line[:, :2] for line in mechanism.routes.positions(q)]
    if not isinstance(mechanism.routes, Pulleys):
        raise InvalidInput("muscles are drawn on Pulleys and Sites; other routes do not tell where they are")
    shoulder, first = bones[0], bones[1] - bones[0]
    ground = shoulder - [np.hypot(*first), 0.0]  # the trunk: a link along x, behind the first joint
    return [_round_pulleys(np.vstack([ground, bones]), np.array(arms)) for arms in mechanism.routes.arms]


def _round_pulleys(points: Array, arms: Array) -> Array:
    """Return the line of a muscle beside the links between `points` (n + 2, 2), with arms (n,) at the inner points."""
    arms = arms * (1 + _APART * (np.count_nonzero(np.abs(arms) > _SMALLEST) - 1))
    along = np.diff(points, axis=0)
    along /= np.hypot(*along.T)[:, None]
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)  # to the left, where a pull raises the angle
    crossed = np.flatnonzero(np.abs(arms) > _SMALLEST)
    first, last = crossed[0], crossed[-1]
    line = [points[first + 1] + _BEFORE * (points[first] - points[first + 1]) + arms[first] * normal[first]]
    for joint in range(first, last + 1):
        both = (normal[joint] + normal[joint + 1]) / np.hypot(*(normal[joint] + normal[joint + 1]))
        line.append(points[joint + 1] + arms[joint] * both)
    beyond = points[last + 2] - points[last + 1]
    line.append(points[last + 1] + _BEHIND * beyond + arms[last] * normal[last + 1])
    return np.array(line)


def _colours(mechanism: Mechanism) -> "ScalarMappable":
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    low, high = mechanism.pressure_limits
    return ScalarMappable(Normalize(low / BAR, high / BAR), "viridis")
