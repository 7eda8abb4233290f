"""Isobars of a fitted muscle are drawn with the data."""

from typing import Any

import numpy as np

from allocator.identification.muscle.result import Fit, Level
from allocator.units import BAR

_MOST_ISOBARS = 8
_NEAR = 0.003  # of the highest pressure: what counts as the same level


def plot_isobars(fit: Fit[Any], axes: Any = None) -> Any:
    """Draw force against contraction at some of the measured pressures, model (lines) and data (dots).

    Filled dots are taut samples, crosses slack ones; the grey line is zero force. Returns the Matplotlib axes; new ones
    unless `axes` are given.
    """
    import matplotlib.pyplot as plt

    if axes is None:
        _, axes = plt.subplots(figsize=(7, 5), layout="constrained")
    samples = fit.samples
    levels = _chosen(fit.levels)
    colours = plt.get_cmap("viridis")(np.linspace(0, 0.92, len(levels)))
    least, most = max(samples.contraction.min(), fit.muscle.min_contraction), samples.contraction.max()
    eps = np.linspace(least, most, 201)
    for level, colour in zip(levels, colours, strict=True):
        F = fit.muscle.force(level.pressure, eps)
        axes.plot(100 * eps, np.where(F >= 0, F, np.nan), color=colour, label=f"{level.pressure / BAR:.3g} bar")
        near = np.abs(samples.pressure - level.pressure) <= _NEAR * samples.pressure.max()
        for group, marker in ((near & ~fit.slack, "o"), (near & fit.slack, "x")):
            axes.plot(100 * samples.contraction[group], samples.force[group], marker, color=colour, markersize=4)
    axes.axhline(0, color="0.7", linewidth=0.8, zorder=0)
    axes.set_xlabel("contraction [%]")
    axes.set_ylabel("force [N]")
    axes.set_title(f"{fit.model}: {fit.rms:.1f} N RMS ({fit.rms_percent:.1f} % of full scale)")
    axes.legend(fontsize="small", frameon=False)
    return axes


def _chosen(levels: tuple[Level, ...]) -> tuple[Level, ...]:
    """Return a few levels, spread evenly over the pressures."""
    P = np.array([level.pressure for level in levels])
    wanted = np.linspace(P.min(), P.max(), _MOST_ISOBARS)
    return tuple(levels[i] for i in np.unique(np.abs(P - wanted[:, None]).argmin(axis=1)))


__all__ = ["plot_isobars"]
