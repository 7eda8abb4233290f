"""Captions stay within their picture, whole and in order."""

from itertools import pairwise

import pytest

from allocator.presentation.plotting import fit_captions, new_figure, save_figure

LONG = (
    "The pressures at which the cables go slack were assumed and not measured: the limits 'agonist slack' and "
    "'antagonist slack' follow from forces below 1.5 bar that no row of the data has seen."
)


def edges(figure, texts):
    figure.draw_without_rendering()
    return [text.get_window_extent() for text in texts]


@pytest.mark.parametrize("columns", [1, 2])
@pytest.mark.parametrize("side", ["left", "center"])
def test_no_caption_leaves_the_picture_or_runs_into_the_next_panel(columns, side, tmp_path):
    figure = new_figure(7, 4)
    panels = figure.subplots(1, columns, squeeze=False)[0]
    titles = [panel.set_title(f"{i}. {LONG}", loc=side) for i, panel in enumerate(panels)]
    above = figure.suptitle(LONG + "\nRMS: angle 0.1°")
    save_figure(figure, tmp_path / "picture.png")
    for box in edges(figure, [above, *titles]):
        assert box.x0 >= 0
        assert box.x1 <= figure.bbox.width
    boxes = edges(figure, titles)
    assert all(left.x1 <= right.x0 for left, right in pairwise(boxes))
    assert above.get_text().split() == (LONG + "\nRMS: angle 0.1°").split()
    assert above.get_text().endswith("\nRMS: angle 0.1°")


def test_a_caption_that_fits_is_not_touched():
    figure = new_figure(7, 4)
    title = figure.subplots().set_title("5 bar,\n  no torque")
    fit_captions(figure)
    assert title.get_text() == "5 bar,\n  no torque"
