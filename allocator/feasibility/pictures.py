"""Pictures of mechanisms: feasible targets, arms and muscles, and the stiffness of hands."""

from collections import Counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.lazy import Axes
from allocator.mechanism.endpoint import Endpoint
from allocator.mechanism.endpoint.endpoint import LinkagePoint
from allocator.mechanism.mechanism import Mechanism
from allocator.mechanism.routes import Link, Pulleys, Sites
from allocator.mechanism.routes.linkage import Linkage
from allocator.presentation.plotting import FILL, GREY, legend_outside, name_axes, new_axes
from allocator.units import BAR

if TYPE_CHECKING:
    from matplotlib.cm import ScalarMappable
    from matplotlib.text import Annotation

    from allocator.feasibility.polygon import Edge, Polygon
    from allocator.feasibility.targets import EndpointEllipses

_MARKS = {"upper": "↑", "slack": "↓", "lower": "↓"}  # of limits with a mark
_OUTSIDE = 11  # points between an edge and its text
_LETTER = 5.0  # points
_STEEP = 60.0  # [°] of an edge; the arrow of a text along it would point sideways
_MOST_NUMBERS = 60
_TURN = np.linspace(0, 2 * np.pi, 73)
_FAN, _STIFF, _SOFT = "#dbe7f1", "#1f4e79", "#d08770"
_BONE, _ELLIPSE = "#c9c9c9", "#1f4e79"
_BEFORE, _BEHIND = 0.65, 0.25  # of a link: distance from the joint to the ends of a muscle round pulleys
_APART = 0.8  # of its arms: added distance of a muscle per further joint that it crosses
_SMALLEST = 1e-6  # [m] a smaller arm counts as none

# --- a polygon of two targets -----------------------------------------------------------------------------------------


def plot_polygon(polygon: "Polygon", axes: Any = None) -> Any:
    """Draw a polygon; its edges name the binding muscles, ↑ at the greatest pressure, ↓ where they go slack.

    A legend explains the muscles' letters. Returns the Matplotlib axes.
    """
    axes = new_axes(7.8) if axes is None else axes
    x, y = polygon.axes
    name_axes(axes, x.label, y.label)
    exists = "feasible" if len(polygon.vertices) else "nothing exists"
    axes.set_title(f"{exists} at {polygon.held}" if polygon.held else exists, fontsize="medium", loc="left")
    if not len(polygon.vertices):
        return axes
    axes.fill(*polygon.vertices.T, facecolor=FILL, edgecolor="black", linewidth=1.5)
    axes.margins(0.35, 0.22)
    axes.autoscale_view()
    axes.figure.draw_without_rendering()  # texts are placed in the final layout of the axes
    letters = _letters({_split(limit)[0] for edge in polygon.edges for limit in edge.active})
    texts: list[Annotation] = []
    for edge in polygon.edges:
        _name(axes, edge, polygon.vertices.mean(axis=0), letters, texts)
    _explain(axes, letters)
    return axes


def _split(limit: str) -> tuple[str, str]:
    """Return the muscle and the mark of a binding limit: "muscle 1 upper" is ("muscle 1", "↑")."""
    for kind, mark in _MARKS.items():
        if limit.endswith(f" {kind}"):
            return limit.removesuffix(f" {kind}"), mark
    for kind in ("rate", "model validity", "force ceiling"):
        if limit.endswith(f" {kind}"):
            return limit.removesuffix(f" {kind}"), f" {kind}"
    return limit, ""


def _letters(names: set[str]) -> dict[str, str]:
    """Return the initials and numbers of every name, numbered if several are equal."""
    short = {name: "".join(w if w.isdigit() else w[0].upper() for w in name.split()) for name in sorted(names)}
    alike = Counter(short.values())
    count: Counter[str] = Counter()
    for name, letters in short.items():
        count[letters] += 1
        short[name] = f"{letters}{count[letters]}" if alike[letters] > 1 else letters
    return short


def _name(axes: Any, edge: "Edge", centre: Array, letters: dict[str, str], others: list["Annotation"]) -> None:
    """Write the binding limits outside the middle of an edge, clear of other texts; upright at short or steep edges."""
    to_points = 72 / axes.figure.dpi
    start, end, inside = (axes.transData.transform(point) * to_points for point in (edge.start, edge.end, centre))
    along, middle = end - start, (start + end) / 2
    normal = np.array([along[1], -along[0]]) / max(np.hypot(*along), 1e-9)
    normal *= np.sign(normal @ (middle - inside)) or 1.0
    text = " ".join(dict.fromkeys("".join((letters[name], mark)) for name, mark in map(_split, edge.active)))
    angle = (np.degrees(np.arctan2(along[1], along[0])) + 90) % 180 - 90
    fits = np.hypot(*along) > _LETTER * len(text)
    if fits and abs(angle) > _STEEP:
        text, fits = text.replace(" ", "\n"), False
    angle = angle if fits else 0.0
    sideways = "center" if fits or abs(normal[0]) < 0.3 else ("left" if normal[0] > 0 else "right")
    style = {"ha": sideways, "va": "center", "rotation": angle, "rotation_mode": "anchor", "fontsize": "small"}
    near = _OUTSIDE if fits else 0.6 * _OUTSIDE
    written = axes.annotate(
        text, (edge.start + edge.end) / 2, xytext=tuple(near * normal), textcoords="offset points", **style
    )
    taken = [other.get_window_extent() for other in others]
    for step in (0, 1, -1, 2, -2):  # lines of text up and down
        written.set_position(tuple(near * normal + [0.0, 1.1 * _OUTSIDE * step]))
        if not any(written.get_window_extent().overlaps(other) for other in taken):
            break
    others.append(written)


def _explain(axes: "Axes", letters: dict[str, str]) -> None:
    lines = [f"{short}  {name}" for name, short in sorted(letters.items(), key=lambda pair: pair[1])]
    lines += ["", "↑  at the greatest pressure", "↓  where it goes slack"]
    axes.annotate(
        "\n".join(lines), (1.02, 1.0), xycoords="axes fraction", va="top", fontsize="small", annotation_clip=False
    )


# --- the workspace of a hand ------------------------------------------------------------------------------------------


def ellipse(K: Array) -> Array:
    """Return the curve (2, 73) of the forces K·u [N/m] against unit displacements u, long in stiff directions."""
    return np.asarray(K @ np.stack([np.cos(_TURN), np.sin(_TURN)]))


def plot_workspace(found: "EndpointEllipses", axes: "Axes | None" = None) -> "Axes":
    """Draw the softest and the stiffest ellipse at every place, over the sector of feasible tilts of the long axis.

    Every place has its own scale; the number beside it is the longest half axis [N/m], unless it would cover another
    number. Returns the Matplotlib axes.
    """
    axes = new_axes(8.2, 5.6) if axes is None else axes
    axes.margins(0.12)
    axes.set_aspect("equal")
    name_axes(axes, *(f"{name} of the hand [m]" for name in found.names))
    numbers = "; beside it the longest half axis [N/m]" if np.count_nonzero(found.exists) <= _MOST_NUMBERS else ""
    axes.set_title(f"stiffness of the hand{numbers}", fontsize="medium", loc="left")
    x, softest, stiffest, tilt = (part[found.exists] for part in (found.x, found.softest, found.stiffest, found.tilt))
    missing = found.x[~found.exists]
    if len(missing):
        axes.plot(*missing.T, "x", color=GREY, markersize=5, label="torques do not exist")
    if not len(x):
        return axes
    radius = 0.46 * _spacing(found.x.reshape(-1, 2))  # of the stiffest [m]
    longest = np.linalg.eigvalsh(stiffest)[:, -1]
    for i, place in enumerate(x):
        length = radius / longest[i]  # [m] for 1 N/m
        _fan(axes, place, tilt[i], radius)
        for K, colour, width, label in ((stiffest[i], _STIFF, 1.6, "stiffest"), (softest[i], _SOFT, 1.6, "softest")):
            axes.plot(*(place[:, None] + length * ellipse(K)), color=colour, linewidth=width, label=label)
    legend_outside(axes)
    if len(x) <= _MOST_NUMBERS:
        _number(axes, x - [0, 1.05 * radius], np.asarray(longest))
    return axes


def _number(axes: Any, places: Array, values: Array) -> None:
    """Write each value below its place, unless it would cover a value before."""
    axes.figure.draw_without_rendering()  # texts are placed in the final layout of the axes
    taken: list[Any] = []
    for place, value in zip(places, values, strict=True):
        text = axes.annotate(f"{value:.0f}", place, ha="center", va="top", fontsize="x-small")
        covers = text.get_window_extent()
        if any(covers.overlaps(other) for other in taken):
            text.remove()
        else:
            taken.append(covers)


def _fan(axes: "Axes", place: Array, tilt: Array, radius: float) -> None:
    """Draw the sector of the tilts to both sides."""
    angle = np.linspace(tilt[0], tilt[1], 60)
    rim = radius * np.stack([np.cos(angle), np.sin(angle)])
    both = np.concatenate([np.zeros((2, 1)), rim, np.zeros((2, 1)), -rim, np.zeros((2, 1))], axis=1)
    axes.fill(*(place[:, None] + both), color=_FAN, linewidth=0, label="tilts of the long axis")


def _spacing(places: Array) -> float:
    """Return the median distance of a place to its nearest neighbour, or the arm's reach of a single one."""
    from scipy.spatial import cKDTree

    if len(places) < 2:
        return float(np.hypot(*places[0])) or 1.0
    return float(np.median(cKDTree(places).query(places, 2)[0][:, 1]))


# --- an arm -----------------------------------------------------------------------------------------------------------


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

    Muscles are lines, darker at lower pressures. Those between sites are drawn along their paths; those round pulleys
    beside the links, on the side of their arms, farther out the more joints they cross. The ellipse is K_x u of unit
    displacements u, at `scale` [m per N/m], by default a third of the arm long. `endpoint` has to be `Endpoint.planar`,
    or another point on links in the plane. Returns the Matplotlib axes. Raises `InvalidInput`.
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
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)  # to the left: there a pull raises the angle
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
