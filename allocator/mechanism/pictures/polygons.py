"""A polygon of two targets is drawn with what binds along each of its edges."""

from collections import Counter
from typing import TYPE_CHECKING, Any

import numpy as np

from allocator.calculus import Array
from allocator.presentation.plotting import FILL, name_axes, new_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.text import Annotation

    from allocator.mechanism.feasibility.polygon import Edge, Polygon

_MARKS = {"upper": "↑", "slack": "↓", "lower": "↓"}  # of the limits that have one
_OUTSIDE = 11  # points between an edge and its text
_LETTER = 5.0  # points


def plot_polygon(polygon: "Polygon", axes: Any = None) -> Any:
    """Draw a polygon; on its edges stand the muscles that bind, ↑ at the greatest pressure, ↓ where they go slack.

    The muscles' letters are explained beside the picture. Returns the Matplotlib axes.
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
    axes.figure.draw_without_rendering()  # texts are placed by what the layout makes of the axes
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
    """Return the initials and numbers of every name, numbered where several have the same."""
    short = {name: "".join(w if w.isdigit() else w[0].upper() for w in name.split()) for name in sorted(names)}
    alike = Counter(short.values())
    count: Counter[str] = Counter()
    for name, letters in short.items():
        count[letters] += 1
        short[name] = f"{letters}{count[letters]}" if alike[letters] > 1 else letters
    return short


def _name(axes: Any, edge: "Edge", centre: Array, letters: dict[str, str], others: list["Annotation"]) -> None:
    """Write what binds beside the middle of an edge, outside, clear of other texts; of a short edge upright."""
    to_points = 72 / axes.figure.dpi
    start, end, inside = (axes.transData.transform(point) * to_points for point in (edge.start, edge.end, centre))
    along, middle = end - start, (start + end) / 2
    normal = np.array([along[1], -along[0]]) / max(np.hypot(*along), 1e-9)
    normal *= np.sign(normal @ (middle - inside)) or 1.0
    text = " ".join("".join((letters[name], mark)) for name, mark in map(_split, edge.active))
    fits = np.hypot(*along) > _LETTER * len(text)
    angle = (np.degrees(np.arctan2(along[1], along[0])) + 90) % 180 - 90 if fits else 0.0
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
