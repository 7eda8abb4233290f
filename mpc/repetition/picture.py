"""Picture of a motion that was learned: errors by repetition, and over time before and after."""

from collections.abc import Sequence

import numpy as np

from allocator.calculus import Array
from allocator.lazy import Figure
from allocator.presentation.plotting import GREY, legend_below, new_figure
from allocator.units import DEG
from mpc.repetition.learner import Learner

_BEFORE, _AFTER = "#D55E00", "#0072B2"


def plot_learning(
    learner: Learner, before: Array, after: Array, title: str = "", figure: "Figure | None" = None
) -> "Figure":
    """Draw the errors by repetition, and the errors of the first and the best one over time.

    `before` and `after` are the angles (M, …) [rad] of the two repetitions; the joints of an arm have a line each.
    Returns the Matplotlib figure, a new one unless `figure` is given.
    """
    figure = new_figure(9, 3.6) if figure is None else figure
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.6))
    rms = np.array([one.rms for one in learner.history]) / DEG
    number = np.arange(1, rms.size + 1)
    left.semilogy(number, rms, "o-", color=_AFTER, label="RMS")
    left.semilogy(number, [one.worst / DEG for one in learner.history], "s:", color=GREY, ms=4, label="worst")
    if learner.update is not None:
        promised = rms[0] * np.array(learner.update.predicted[: rms.size])
        left.semilogy(number, promised, "--", color="k", lw=1, label="RMS predicted")
    left.set(xlabel="repetition", ylabel="angle error [°]", title=title)
    left.set_xticks(_ticks(rms.size))
    legend_below(left)
    course = learner.course
    shown = slice(course.begin, course.count)  # without the first rest
    t, wanted = course.wanted.t[shown], course.wanted.theta[shown]
    for angles, colour, name in ((before, _BEFORE, "first"), (after, _AFTER, "best")):
        lines = right.plot(t, ((angles[shown] - wanted) / DEG).reshape(t.size, -1), color=colour, lw=1)
        lines[0].set_label(f"{name} repetition")
    right.axhline(0, color="k", lw=0.6)
    right.set(xlabel="time [s]", ylabel="angle error [°]", title="before and after")
    legend_below(right)
    return figure


def _ticks(count: int) -> Sequence[int]:
    return range(1, count + 1, max(1, count // 8))
