"""Figures as data: panels with curves, and the function that draws them."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from allocator.calculus import Array
from allocator.presentation.plotting import legend_outside, name_axes, new_figure, shades

STYLES: dict[str, dict[str, Any]] = {
    "line": {"linestyle": "-"},
    "dashed": {"linestyle": (0, (5, 2))},
    "dotted": {"linestyle": (0, (1, 1.6))},
    "dots": {"linestyle": "none", "marker": "o", "markersize": 4},
}


@dataclass(frozen=True, eq=False)
class Curve:
    """Curve of n points in the units of the panel; NaN is a gap."""

    label: str  # curves of one label have one colour
    x: Array = field(repr=False)  # (n,)
    y: Array = field(repr=False)  # (n,)
    style: str = "line"  # a key of `STYLES`


@dataclass(frozen=True, eq=False)
class Panel:
    """One picture of a figure."""

    title: str
    x: str  # label of the axis, with its unit
    y: str
    curves: tuple[Curve, ...]
    styles: tuple[tuple[str, str], ...] = ()  # (style, meaning), if there are several

    def curve(self, label: str, style: str = "line") -> Curve:
        """Return the curve with this label in this style."""
        return next(curve for curve in self.curves if (curve.label, curve.style) == (label, style))


def draw(*panels: Panel) -> Any:
    """Draw the panels side by side in a Matplotlib figure, with one legend at the right."""
    figure = new_figure(2.6 + 4.2 * len(panels), 4.2)
    for axes, panel in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        labels = list(dict.fromkeys(curve.label for panel in panels for curve in panel.curves))
        colours = dict(zip(labels, shades(len(labels)), strict=True))
        for curve in panel.curves:
            axes.plot(curve.x, curve.y, color=colours[curve.label], **STYLES[curve.style])
        name_axes(axes, panel.x, panel.y)
        axes.set_title(panel.title, fontsize="medium", loc="left")
    _legend(axes, colours.items(), panels[-1].styles)
    return figure


def _legend(axes: Any, colours: Iterable[tuple[str, Any]], styles: Iterable[tuple[str, str]]) -> None:
    """Draw the legend of colours and styles."""
    for label, colour in colours:
        axes.plot([], [], color=colour, linewidth=3, label=label)
    for style, meaning in styles:
        axes.plot([], [], color="0.4", label=meaning, **STYLES[style])
    legend_outside(axes)
