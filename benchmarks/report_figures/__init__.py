"""Figures of Tondu's report (arXiv 2104.13167) from its parameters: `figure_*` are the curves, `draw` the picture.

>>> draw(*figure_8()).savefig("figure_8.png")  # doctest: +SKIP
"""

from benchmarks.report_figures.joint import figure_3, figure_8, figure_8_marked
from benchmarks.report_figures.muscles import figure_1b, figure_5b, figure_6, figure_7
from benchmarks.report_figures.panel import Curve, Panel, draw

FIGURES = {
    "1b": figure_1b,
    "3": figure_3,
    "5b": figure_5b,
    "6": figure_6,
    "7": figure_7,
    "8": figure_8,
    "8-marked": figure_8_marked,
}
"""Every figure by its number: a function without arguments that gives its panels."""

__all__ = [
    "FIGURES",
    "Curve",
    "Panel",
    "draw",
    "figure_1b",
    "figure_3",
    "figure_5b",
    "figure_6",
    "figure_7",
    "figure_8",
    "figure_8_marked",
]
