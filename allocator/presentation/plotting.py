"""The project's pictures look alike: light, told apart by colour-blind eyes, readable in grey, units on every axis.

Figures are made without pyplot, so that nothing global changes and nothing has to be closed; a notebook shows them as
they are. Every function loads Matplotlib when it is called.
"""

from collections.abc import Mapping
from os import PathLike
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

from allocator.calculus import Array
from allocator.files.atomic import replacing
from allocator.presentation.captions import fit_captions
from allocator.units import BAR, DEG

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

GREY = "#8c8c8c"
FILL = "#dbe7f1"


class Quantity(NamedTuple):
    """A quantity is what stands on an axis."""

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
    """Draw a legend to the right of the axes, where no data are; what is drawn several times is named once."""
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
