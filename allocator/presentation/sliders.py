"""Sliders are put over a picture in a notebook, and the picture is alone where nothing is alive to move them."""

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from ipywidgets import FloatSlider
    from matplotlib.figure import Figure


class Range(NamedTuple):
    """A range is what a slider runs over."""

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
