"""Parts common to all pictures."""

from allocator.presentation.plotting import legend_below, new_figure


def test_a_legend_below_covers_neither_data_nor_labels():
    left, right = new_figure(9, 3.6).subplots(1, 2)
    for axes in (left, right):
        for name in ("first", "second", "third", "a fourth"):
            axes.plot([0, 1], [0, 1], label=name)
        axes.set(xlabel="time [s]", ylabel="angle [°]")
        legend_below(axes)
    left.figure.canvas.draw()
    for axes in (left, right):
        legend = axes.get_legend().get_window_extent()
        assert not legend.overlaps(axes.bbox)
        assert not legend.overlaps(axes.xaxis.label.get_window_extent())
        assert legend.y0 > 0
