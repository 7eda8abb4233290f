"""Pictures of a fitted muscle: isobars with the data, and residuals."""

import numpy as np

from allocator.calculus import Array
from allocator.identification.muscle.result import Fit, Level
from allocator.lazy import Axes, Figure
from allocator.muscles import Muscle
from allocator.presentation.plotting import FILL, legend_outside, new_axes, new_figure, shades
from allocator.units import BAR

_MOST_ISOBARS = 8
_NEAR = 0.003  # of the highest pressure: width of a level


def fit_figure(fit: Fit[Muscle]) -> "Figure":
    """Draw isobars above and residuals below; returns the Matplotlib figure."""
    figure = new_figure(7.5, 6.6)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[2.6, 1])
    plot_isobars(fit, above)
    above.set_xlabel("")
    plot_residuals(fit, below)
    figure.align_ylabels()
    return figure


def plot_residuals(fit: Fit[Muscle], axes: "Axes") -> "Axes":
    """Draw model less measurement [N] of every sample over the contraction; the band is twice the fit's RMS."""
    eps, residuals = 100 * fit.samples.contraction, fit.residuals()
    axes.axhspan(-2 * fit.rms, 2 * fit.rms, color=FILL, label="± 2 RMS")
    axes.plot(eps[~fit.slack], residuals[~fit.slack], "o", color="0.25", markersize=2.5, label="taut")
    if fit.slack.any():
        axes.plot(eps[fit.slack], residuals[fit.slack], "x", color="0.25", markersize=4, label="slack")
    axes.axhline(0, color="0.5", linewidth=0.8)
    axes.set_xlabel("contraction [%]")
    axes.set_ylabel("residual [N]")
    legend_outside(axes)
    return axes


def plot_isobars(fit: Fit[Muscle], axes: "Axes | None" = None) -> "Axes":
    """Draw force against contraction at some of the measured pressures, model (lines) and data (dots).

    Filled dots are taut samples, crosses slack ones; the grey line is zero force. Returns the Matplotlib axes; new ones
    unless `axes` are given.
    """
    axes = new_axes(7, 5) if axes is None else axes
    samples = fit.samples
    levels = _chosen(fit.levels)
    least, most = max(samples.contraction.min(), fit.muscle.min_contraction), samples.contraction.max()
    eps = np.linspace(least, most, 201)
    for level, colour in zip(levels, shades(len(levels)), strict=True):
        F = fit.muscle.force(level.pressure, eps)
        axes.plot(100 * eps, np.where(F >= 0, F, np.nan), color=colour, label=f"{level.pressure / BAR:.3g} bar")
        near = np.abs(samples.pressure - level.pressure) <= _within(fit.levels, samples.pressure)
        for group, marker in ((near & ~fit.slack, "o"), (near & fit.slack, "x")):
            axes.plot(100 * samples.contraction[group], samples.force[group], marker, color=colour, markersize=4)
    axes.plot([], [], "o", color="0.4", markersize=4, label="taut sample")
    if fit.slack.any():
        axes.plot([], [], "x", color="0.4", markersize=4, label="slack sample")
    axes.axhline(0, color="0.7", linewidth=0.8, zorder=0)
    axes.set_xlabel("contraction [%]")
    axes.set_ylabel("force [N]")
    axes.set_title(f"{fit.model}: {fit.rms:.1f} N RMS ({fit.rms_percent:.1f} % of full scale)")
    legend_outside(axes)
    return axes


def _within(levels: tuple[Level, ...], pressure: Array) -> float:
    """Return the greatest distance [Pa] of a sample's pressure from its isobar: half the gap to the next level.

    For classes of continuously varying pressures, a tenth of their distance.
    """
    P = np.sort([level.pressure for level in levels])
    apart = float(np.diff(P).min()) if P.size > 1 else float(np.inf)
    exact = np.unique(pressure).size <= len(levels)
    return min(apart / 2, _NEAR * float(pressure.max())) if exact else max(0.1 * apart, _NEAR * float(pressure.max()))


def _chosen(levels: tuple[Level, ...]) -> tuple[Level, ...]:
    """Return a few levels, spread evenly over the pressures."""
    P = np.array([level.pressure for level in levels])
    wanted = np.linspace(P.min(), P.max(), _MOST_ISOBARS)
    return tuple(levels[i] for i in np.unique(np.abs(P - wanted[:, None]).argmin(axis=1)))
