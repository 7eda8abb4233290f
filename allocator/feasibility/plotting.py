"""Pictures of a joint's feasible sets."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.feasibility.edges import Edge
from allocator.joint.limits import Limit, names
from allocator.lazy import Axes, Figure
from allocator.presentation.plotting import (
    FILL,
    GREY,
    QUANTITIES,
    categories,
    legend_outside,
    light,
    name_axes,
    new_axes,
    new_figure,
    shades,
)

if TYPE_CHECKING:
    from allocator.feasibility.result import FeasibilityMap

_MOST_SLICES = 7

_LETTER = 5  # pixels
_INSIDE = 1.5  # [-] length of an edge over its label, at least, where the label lies inside between other edges

_SUPPLY = Limit.P1_UPPER | Limit.P2_UPPER | Limit.AGONIST_VALIDITY | Limit.ANTAGONIST_VALIDITY
_SLACK = Limit.AGONIST_SLACK | Limit.ANTAGONIST_SLACK | Limit.P1_LOWER | Limit.P2_LOWER
_ENDS = Limit.JOINT_RANGE | Limit.CONTRACTION_THRESHOLD

Dash = str | tuple[int, tuple[float, ...]]
"""A line style of Matplotlib."""

_OTHER_DASH: Dash = (0, (6, 1.5, 1, 1.5, 1, 1.5))
_DASH_OF: Mapping[Limit, Dash] = {_SUPPLY: "-", _SLACK: (0, (5, 1.5)), _ENDS: ":", Limit.COCONTRACTION: "-."}


def plot_map(feasible: "FeasibilityMap", axes: "Axes | None" = None) -> Any:
    """Draw the feasible set of a map with every edge labelled; with three axes the sets at up to seven torques."""
    if len(feasible.varied) == 3:
        chosen = np.unique(np.linspace(0, feasible.T.size - 1, min(_MOST_SLICES, feasible.T.size)).astype(int))
        slices = feasible.slices
        return plot_maps({f"{feasible.T[i]:.4g} N·m": slices[i] for i in chosen}, axes, title="torque T")
    x, y = _drawn(feasible)
    axes = new_axes() if axes is None else axes
    for loop in outlines(feasible).values():
        axes.fill(*loop, color=FILL, linewidth=0)
    for edge in feasible.edges:
        axes.plot(*_curve(edge, x, y), color="black", linestyle=_dash(edge.limits), linewidth=1.5)
    name_axes(axes, _named(x, [feasible]), _named(y, [feasible]))
    _show_range(axes, [feasible])
    _label_edges(axes, feasible, x, y)
    _title(axes, f"feasible {_held(feasible)}", feasible.assumed)
    return axes


def plot_maps(maps: Mapping[str, "FeasibilityMap"], axes: "Axes | None" = None, *, title: str | None = None) -> Any:
    """Draw several feasible sets in one picture, by their names: torques, angles, muscles, models.

    The colour shows the set, the dashes the limit: solid where the supply or the model's validity binds, dashed where a
    cable goes slack, dotted at the ends of the joint range. With a `title`, the quantity of which the names are values,
    the colours are ordered and the sets filled.
    """
    if len({m.varied for m in maps.values()}) != 1:
        raise InvalidInput("maps on one picture have to vary the same two quantities")
    axes = new_axes(7.8) if axes is None else axes
    colours = categories(len(maps)) if title is None else shades(len(maps))
    for (name, feasible), colour in zip(maps.items(), colours, strict=True):
        x, y = _drawn(feasible)
        for loop in outlines(feasible).values() if title else ():  # fills of unordered sets would only overlap
            axes.fill(*loop, color=colour, alpha=0.10, linewidth=0)
        for edge in feasible.edges:
            axes.plot(*_curve(edge, x, y), color=colour, linestyle=_dash(edge.limits), linewidth=1.6)
        axes.plot([], [], color=colour, linewidth=3, label=name if feasible.edges else f"{name}: nothing")
    for text, dash in _dashes_used(edge for m in maps.values() for edge in m.edges):
        axes.plot([], [], color=GREY, linestyle=dash, label=text)
    name_axes(axes, _named(x, maps.values()), _named(y, maps.values()))
    _show_range(axes, list(maps.values()))
    held = {_held(m) for m in maps.values()}
    shown = f"feasible by {title}" if title else "feasible"
    _title(axes, f"{shown} {held.pop()}" if len(held) == 1 else shown, _assumed(maps))
    legend_outside(axes, title)
    return axes


def plot_pressures(feasible: "FeasibilityMap", figure: "Figure | None" = None) -> "Figure":
    """Draw both pressures over the feasible cells of a map with two axes; returns the Matplotlib figure."""
    x, y = _drawn(feasible)
    figure = new_figure(9.0, 3.9) if figure is None else figure
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    top = QUANTITIES["P"].shown(np.array(feasible.joint.pressure_limits[1]))
    flip = feasible.varied != (x, y)
    levels = np.linspace(0, float(top), 21)
    for axes, name in zip(panels, ("P1", "P2"), strict=True):
        P = np.where(feasible.feasible, QUANTITIES["P"].shown(getattr(feasible, name)), np.nan)
        grid = (_shown(feasible, x), _shown(feasible, y), P if flip else P.T)
        colours = axes.contourf(*grid, levels=levels, cmap="viridis")
        lines = axes.contour(*grid, levels=levels[2::2], colors="white", linewidths=0.6)
        axes.clabel(lines, fontsize="x-small", fmt="%.3g")
        for edge in feasible.edges:
            axes.plot(*_curve(edge, x, y), color="black", linewidth=1.0)
        name_axes(axes, _named(x, [feasible]), _named(y, [feasible]))
        axes.set_title({"P1": "agonist P1", "P2": "antagonist P2"}[name], fontsize="medium", loc="left")
        light(axes)
    panels[1].set_ylabel("")
    figure.colorbar(colours, ax=panels, label=QUANTITIES["P"].label, ticks=np.linspace(0, float(top), 6))
    _show_range(panels[0], [feasible])
    figure.suptitle("\n".join(filter(None, (f"pressures {_held(feasible)}", feasible.assumed))), fontsize="medium")
    return figure


def _title(axes: "Axes", shown: str, assumed: str) -> None:
    """Write the title: the constant quantities, and assumed slack limits."""
    axes.set_title("\n".join(filter(None, (shown, assumed))), fontsize="medium", loc="left")


def _assumed(maps: Mapping[str, "FeasibilityMap"]) -> str:
    """Return a note on the maps with assumed slack limits, if any."""
    assumed = {name: m.assumed for name, m in maps.items() if m.assumed}
    which = "" if len(assumed) == len(maps) else f"{', '.join(assumed)}: "
    return which + next(iter(assumed.values())) if assumed else ""


# --- curves ---------------------------------------------------------------------------------------------------------


def outlines(feasible: "FeasibilityMap") -> dict[int, Array]:
    """Return the closed border (2, n) of each connected part of the set by its number, in units of the picture."""
    x, y = _drawn(feasible)
    curves: dict[int, list[Array]] = {}
    for edge in feasible.edges:
        curves.setdefault(edge.part, []).append(np.stack(_curve(edge, x, y)))
    return {part: _joined(pieces) for part, pieces in curves.items()}


def _joined(curves: list[Array]) -> Array:
    """Chain curves (2, n), each time with the one that has the nearest end."""
    size = np.maximum(np.ptp(np.concatenate(curves, axis=1), axis=1), 1e-12)
    loop, *left = curves
    while left:
        gaps = [[np.abs((curve[:, end] - loop[:, -1]) / size).sum() for end in (0, -1)] for curve in left]
        i = int(np.argmin(np.min(gaps, axis=1)))
        curve = left.pop(i)
        loop = np.concatenate([loop, curve if gaps[i][0] <= gaps[i][1] else curve[:, ::-1]], axis=1)
    return loop


def _curve(edge: Edge, x: str, y: str) -> tuple[Array, Array]:
    return QUANTITIES[x].shown(getattr(edge, x)), QUANTITIES[y].shown(getattr(edge, y))


def _drawn(feasible: "FeasibilityMap") -> tuple[str, str]:
    """Return the names of the quantities along the x and y axes."""
    if len(feasible.varied) != 2:
        raise InvalidInput("a picture shows two quantities; take one of the map's slices")
    x, y = feasible.varied
    return (y, x) if (x, y) == ("K", "T") else (x, y)


def _shown(feasible: "FeasibilityMap", name: str) -> Array:
    return QUANTITIES[name].shown(getattr(feasible, name))


def _named(quantity: str, maps: Iterable["FeasibilityMap"]) -> str:
    """Return the label of an axis, with the kind of stiffness if it is the same in all maps."""
    kinds = {m.kind.text for m in maps}
    if quantity != "K" or len(kinds) > 1:
        return quantity
    return QUANTITIES["K"].label.replace("stiffness K", f"{kinds.pop()} K")


def _show_range(axes: "Axes", maps: Iterable["FeasibilityMap"]) -> None:
    """Show the whole requested grid, with a margin for lines on its border."""
    maps = list(maps)
    for name, axis in zip(_drawn(maps[0]), "xy", strict=True):
        shown = np.concatenate([_shown(m, name) for m in maps])
        margin = 0.02 * np.ptp(shown)
        axes.set(**{f"{axis}lim": (shown.min() - margin, shown.max() + margin)})


# --- labels ---------------------------------------------------------------------------------------------------------


def limit_text(limits: int) -> str:
    """Return the binding limits in two or three words: "P1 upper", "both slack", …"""
    kinds = {
        Limit.AGONIST_SLACK | Limit.ANTAGONIST_SLACK: "both slack",
        Limit.P1_UPPER | Limit.P2_UPPER: "supply pressure",
        Limit.P1_LOWER | Limit.P2_LOWER: "no pressure",
        Limit.CONTRACTION_THRESHOLD: "ε threshold",
    }
    return kinds.get(Limit(limits), " + ".join(names(limits)))


def _held(feasible: "FeasibilityMap") -> str:
    """Return the constant quantities of the map."""
    (name,) = {"theta", "K", "T"} - set(feasible.varied)
    symbol, unit = {"theta": ("θ", "°"), "K": ("K", " N·m/rad"), "T": ("T", " N·m")}[name]
    return f"at {symbol} = {float(_shown(feasible, name)):.4g}{unit}"


def _dash(limits: int) -> Dash:
    return next((dash for kinds, dash in _DASH_OF.items() if limits & kinds), _OTHER_DASH)


def _dashes_used(edges: Iterable[Edge]) -> list[tuple[str, Dash]]:
    texts = ("supply pressure", "cable slack", "joint range", "co-contraction floor", "other limit")
    used = [_dash(edge.limits) for edge in edges]
    dashes = [*_DASH_OF.values(), _OTHER_DASH]
    return [(text, dash) for text, dash in zip(texts, dashes, strict=True) if dash in used]


def _label_edges(axes: "Axes", feasible: "FeasibilityMap", x: str, y: str) -> None:
    """Write the binding limits along the middle of every edge: outside the set, inside at ends of the joint range."""
    to_pixels = axes.transData.transform
    loops = outlines(feasible)
    for edge in feasible.edges:
        curve = to_pixels(np.stack(_curve(edge, x, y), axis=1))
        room = _INSIDE if edge.limits & _ENDS else 1.0
        if np.hypot(*np.ptp(curve, axis=0)) < room * _LETTER * len(limit_text(edge.limits)):
            continue  # no space; the dashes identify it
        middle, tangent = _halfway(curve)
        centre = to_pixels(np.mean(loops[edge.part], axis=1))
        normal = np.array([-tangent[1], tangent[0]])
        normal *= np.sign(normal @ (middle - centre)) * (-1 if edge.limits & _ENDS else 1)
        angle = np.degrees(np.arctan2(tangent[1], tangent[0]))
        axes.annotate(
            limit_text(edge.limits),
            tuple(axes.transData.inverted().transform(middle)),
            xytext=tuple(8 * normal),
            textcoords="offset points",
            ha="center",
            va="center",
            rotation=(angle + 90) % 180 - 90,  # never upside down
            rotation_mode="anchor",
            fontsize="small",
        )


def _halfway(curve: Array) -> tuple[Array, Array]:
    """Return the point (2,) in the middle of the length of a curve (n, 2), and the direction of the curve there."""
    steps = np.diff(curve, axis=0)
    lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*steps.T))])
    at = np.interp(lengths[-1] * np.array([0.4, 0.5, 0.6]), lengths, np.arange(len(curve)))
    before, middle, after = (np.array([np.interp(i, np.arange(len(curve)), column) for column in curve.T]) for i in at)
    return middle, (after - before) / max(np.hypot(*(after - before)), 1e-9)
