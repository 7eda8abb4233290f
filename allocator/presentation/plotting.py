"""Style of the project's pictures: light, told apart by colour-blind eyes, readable in grey, units on every axis.

Figures are made without pyplot, so that nothing global changes and nothing has to be closed; a notebook shows them as
they are. Every function loads Matplotlib when it is called.
"""

import textwrap
from collections.abc import Callable, Mapping
from os import PathLike
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

from allocator.calculus import Array
from allocator.files.atomic import replacing
from allocator.lazy import Axes, Figure
from allocator.units import BAR, DEG

GREY = "#8c8c8c"
FILL = "#dbe7f1"
_BELOW = 0.45  # [inch] from the x axis to a legend, past ticks and label


class Quantity(NamedTuple):
    """A quantity that an axis shows."""

    label: str
    unit: float  # SI value of the unit shown

    def shown(self, values: Array) -> Array:
        """Return the values in the unit of the label."""
        return values / self.unit


QUANTITIES: Mapping[str, Quantity] = MappingProxyType(
    {
        "theta": Quantity("joint angle θ [°]", DEG),
        "K": Quantity("stiffness K [N·m/rad]", 1.0),
        "T": Quantity("torque T [N·m]", 1.0),
        "P": Quantity("gauge pressure [bar]", BAR),
    }
)


def new_axes(width: float = 7.0, height: float = 4.4) -> "Axes":
    """Return Matplotlib axes in a new figure of this size [inch]."""
    return new_figure(width, height).subplots()


def new_figure(width: float, height: float) -> "Figure":
    """Return an empty Matplotlib figure."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def name_axes(axes: "Axes", x: str, y: str) -> None:
    """Label the axes with quantity and unit (keys of `QUANTITIES`, or texts), and draw a light grid."""
    axes.set_xlabel(QUANTITIES[x].label if x in QUANTITIES else x)
    axes.set_ylabel(QUANTITIES[y].label if y in QUANTITIES else y)
    light(axes)
    if x == "theta":
        degree_ticks(axes)


def light(axes: "Axes") -> None:
    """Draw a light grid behind the data, no box."""
    axes.grid(color="#e6e6e6", linewidth=0.7)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def degree_ticks(axes: "Axes") -> None:
    """Put ticks at angles that people know."""
    from matplotlib.ticker import MaxNLocator

    axes.xaxis.set_major_locator(MaxNLocator(nbins=9, steps=[1, 1.5, 3, 4.5, 6, 9, 10]))


def legend_outside(axes: "Axes", title: str | None = None) -> None:
    """Draw a legend to the right of the axes, where no data are, with every label once."""
    handles, labels = axes.get_legend_handles_labels()
    named = dict(zip(labels, handles, strict=True))
    if named:
        axes.legend(
            named.values(),
            named.keys(),
            title=title,
            alignment="left",
            loc="upper left",
            bbox_to_anchor=(1.01, 1.02),
            frameon=False,
            fontsize="small",
        )


def legend_below(axes: "Axes", title: str | None = None, markerscale: float = 1.0) -> None:
    """Draw a legend in rows below the label of the x axis, where no data are."""
    from matplotlib.transforms import ScaledTranslation

    figure = axes.get_figure(root=True)
    assert figure is not None  # axes without one are not drawn
    axes.legend(
        title=title,
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        bbox_transform=axes.transAxes + ScaledTranslation(0, -_BELOW, figure.dpi_scale_trans),
        ncols=min(3, len(axes.get_legend_handles_labels()[1])),
        frameon=False,
        fontsize="small",
        markerscale=markerscale,
    )


def shades(n: int) -> list[tuple[float, float, float, float]]:
    """Return n colours from dark to light that are in order also in grey."""
    from matplotlib import colormaps

    return [colormaps["viridis"](0.85 * i / max(n - 1, 1)) for i in range(n)]


def categories(n: int) -> list[str]:
    """Return n colours without an order, told apart by colour-blind eyes (Okabe & Ito); more than seven repeat."""
    colours = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#000000", "#E69F00", "#56B4E9"
    return [colours[i % len(colours)] for i in range(n)]


def save_figure(figure: "Figure", path: str | PathLike[str], dpi: float = 130) -> None:
    """Write a figure as an image of the kind that its name ends with, whole or not at all; long captions are broken."""
    fit_captions(figure)
    with replacing(path) as draft:
        figure.savefig(draft, dpi=dpi)


if TYPE_CHECKING:
    from matplotlib.text import Text

_MARGIN = 6.0  # [pixels] to the edge
_FEWEST = 12  # characters of a line
_ROUNDS = 8


def fit_captions(figure: "Figure") -> None:
    """Break the lines of titles that are wider than the picture, or than their axes if others are beside them."""
    captions = _captions(figure)
    for caption in captions:
        caption.set_visible(False)  # or a long one takes the axes' place
    figure.draw_without_rendering()
    for caption in captions:
        caption.set_visible(True)
        low, high = _room(figure, caption)
        extent = caption.get_window_extent()
        centred = caption.get_horizontalalignment() == "center"
        middle = (extent.x0 + extent.x1) / 2
        room = 2 * min(middle - low, high - middle) if centred else high - extent.x0
        _fit(caption, room - _MARGIN)


def _captions(figure: "Figure") -> list["Text"]:
    """Return the titles of the figure and of its axes."""
    from matplotlib.text import Text

    found = list(figure.texts)
    for axes in figure.axes:
        found += [child for child in axes.get_children() if isinstance(child, Text) and child not in axes.texts]
    return [text for text in found if text.get_text().strip()]


def _room(figure: "Figure", caption: "Text") -> tuple[float, float]:
    """Return the least and the greatest x [pixels] that a title may take."""
    if caption.axes is None:
        return 0.0, float(figure.bbox.width)
    box, boxes = caption.axes.get_window_extent(), [axes.get_window_extent() for axes in figure.axes]
    beside = [other for other in boxes if other.y0 < box.y1 and other.y1 > box.y0]
    low = float(box.x0) if any(other.x1 <= box.x0 for other in beside) else 0.0
    return low, float(box.x1 if any(other.x0 >= box.x1 for other in beside) else figure.bbox.width)


def _fit(caption: "Text", room: float) -> None:
    """Break the lines of `caption` so that none is wider than `room` [pixels]; words are kept whole."""
    lines = caption.get_text().split("\n")
    most = max(map(len, lines))
    for _ in range(_ROUNDS):
        width = caption.get_window_extent().width
        if width <= room or most <= _FEWEST:
            return
        most = max(min(int(most * room / width), most - 1), _FEWEST)
        wrapped = (textwrap.wrap(line, most, break_long_words=False, break_on_hyphens=False) for line in lines)
        caption.set_text("\n".join("\n".join(part) for part in wrapped))


if TYPE_CHECKING:
    from ipywidgets import FloatSlider


class Range(NamedTuple):
    """Range of a slider."""

    label: str
    low: float
    high: float
    value: float


def explore(draw: Callable[..., "Figure"], **ranges: Range) -> dict[str, "FloatSlider"]:
    """Show the figure `draw(**values)` with a slider for every keyword; returns the sliders by keyword.

    The picture is an ordinary output of the cell, which the sliders replace: without a live kernel (on a web page, in
    print) it stays as it was drawn. Without ipywidgets (extra `antagonist[notebook]`) there is the picture only.
    """
    from IPython.display import display

    try:
        from ipywidgets import FloatSlider
    except ImportError:
        display(draw(**{name: r.value for name, r in ranges.items()}))
        return {}
    sliders = {
        name: FloatSlider(r.value, min=r.low, max=r.high, description=r.label, continuous_update=False)
        for name, r in ranges.items()
    }

    def figure() -> "Figure":
        return draw(**{name: slider.value for name, slider in sliders.items()})

    display(*sliders.values())
    picture = display(figure(), display_id=True)
    for slider in sliders.values():
        slider.observe(lambda change: picture.update(figure()), names="value")
    return sliders
