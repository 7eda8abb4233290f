"""Picture of a tuning's trade-off: error against sensitivity peak, one dot per evaluation."""

import numpy as np

from allocator.lazy import Figure
from allocator.presentation.plotting import legend_below, new_figure
from mpc.tuning.cost import OF_DRAWS
from mpc.tuning.result import Tuned

_MOST = 3.0  # greatest M_s shown, over its limit; greater peaks and unsettled loops are drawn at the edge
_MOST_ERROR = 3.0  # greatest cost shown, over the greater of before and after


def plot_tuned(tuned: Tuned, figure: "Figure | None" = None) -> "Figure":
    """Draw every evaluation; returns the Matplotlib figure, a new one unless `figure` is given."""
    from matplotlib.ticker import MaxNLocator

    figure = new_figure(7, 5) if figure is None else figure
    axes = figure.subplots()
    limit = tuned.problem.limit
    peak = np.minimum([one.excess for one in tuned.evaluations], _MOST)
    simulated = np.array([bool(one.draws) for one in tuned.evaluations])
    error = np.array([one.error for one in tuned.evaluations])
    before, after = (tuned.evaluations.index(one) for one in (tuned.before, tuned.after))
    highest = _MOST_ERROR * max(error[before], error[after])
    error, number = np.minimum(error, highest), np.arange(len(peak))
    dots = axes.scatter(peak[simulated], error[simulated], c=number[simulated], cmap="viridis", s=22, zorder=2)
    figure.colorbar(dots, ax=axes, label="evaluation", ticks=MaxNLocator(integer=True))
    axes.plot(peak[~simulated], error[~simulated], "x", color="0.6", label="only margins computed")
    for i, label, marker in ((before, "before", "s"), (after, "after", "*")):
        axes.plot(peak[i], error[i], marker, color="C3", markersize=13, markerfacecolor="none", zorder=3, label=label)
    axes.axvspan(1.0, axes.set_xlim(right=max(axes.get_xlim()[1], 1.1))[1], color="0.92", zorder=0)
    axes.text(0.99, 0.02, "beyond the limit", transform=axes.transAxes, ha="right", color="0.4")
    axes.set_ylim(0, 1.08 * float(error.max()))
    limits = f"{limit:g} on the model, {OF_DRAWS * limit:g} on the draws"
    axes.set(xlabel=f"sensitivity peak M_s over its limit ({limits}) [-]", ylabel="mean cost over the draws [°]")
    axes.set_title(f"{tuned.tuning.controller}: {len(peak)} evaluations on {len(tuned.problem.draws)} draws")
    legend_below(axes)
    return figure
