"""Sliders redraw the picture; without ipywidgets the picture is all there is."""

import sys

from allocator.presentation.plotting import Range, explore

RANGES = {"T": Range("torque", 0.0, 9.0, 3.0), "F": Range("force", 0.0, 50.0, 0.0)}


class Shown:
    """Stands for the output area of a notebook."""

    def __init__(self, monkeypatch):
        self.pictures = []
        monkeypatch.setattr("IPython.display.display", self)

    def __call__(self, *things, display_id=False):
        self.pictures += [thing for thing in things if isinstance(thing, str)]
        return self if display_id else None

    def update(self, picture):
        self.pictures.append(picture)


def draw(T, F):
    return f"T = {T:g}, F = {F:g}"


def test_moving_a_slider_draws_the_picture_again(monkeypatch):
    shown = Shown(monkeypatch)
    sliders = explore(draw, **RANGES)
    sliders["T"].value = 6.0
    sliders["F"].value = 20.0
    assert shown.pictures == ["T = 3, F = 0", "T = 6, F = 0", "T = 6, F = 20"]
    assert (sliders["T"].min, sliders["T"].max) == (0.0, 9.0)


def test_without_ipywidgets_the_picture_is_shown_once(monkeypatch):
    shown = Shown(monkeypatch)
    monkeypatch.setitem(sys.modules, "ipywidgets", None)
    assert explore(draw, **RANGES) == {}
    assert shown.pictures == ["T = 3, F = 0"]
