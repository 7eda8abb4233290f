"""Captions of pictures, broken into lines that fit: titles of figures and of their axes."""

import textwrap
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure
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
