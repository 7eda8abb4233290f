"""Pictures of a moving joint's fit: the free run, its error over time and angle, and the hysteresis."""

from collections.abc import Callable

import numpy as np

from allocator.calculus import Array
from allocator.identification.motion.result import MotionFit
from allocator.lazy import Axes, Figure
from allocator.presentation.plotting import legend_below, new_figure
from allocator.units import DEG

_SHOWN = 30.0  # [s] of the log
_HELD = 0.6


def plot_motion_fit(fit: MotionFit, figure: "Figure | None" = None) -> "Figure":
    """Draw the four pictures; returns the Matplotlib figure, a new one unless `figure` is given."""
    figure = new_figure(13, 8) if figure is None else figure
    (top_left, top_right), (left, right) = figure.subplots(2, 2)
    _angles(fit, top_left)
    _errors(fit, top_right)
    _residuals(fit, left)
    _loops(fit, right)
    return figure


def _broken(fit: MotionFit) -> Callable[[Array], Array]:
    """Return a function that leaves out the first row of every further stretch, so that lines end at gaps."""
    begins = [part.start for part in fit.log.parts[1:]]

    def broken(values: Array) -> Array:
        values = values.copy()
        values[begins] = np.nan
        return values

    return broken


def _angles(fit: MotionFit, axes: "Axes") -> None:
    t = fit.log.t - fit.log.t[0]
    shown = t <= _SHOWN
    broken = _broken(fit)
    axes.plot(t[shown], broken(fit.log.theta)[shown] / DEG, color="0.3", label="measured")
    axes.plot(t[shown], broken(fit.run.theta)[shown] / DEG, color="C3", linewidth=1, label="free run")
    axes.plot(t[shown], broken(fit.run.static)[shown] / DEG, color="C0", linewidth=0.7, label="static angle")
    axes.set(xlabel="time [s]", ylabel="angle [°]", title=f"free run: {fit.error.every / DEG:.2f}° RMS")
    legend_below(axes)


def _errors(fit: MotionFit, axes: "Axes") -> None:
    t = fit.log.t - fit.log.t[0]
    _, low, high = fit.bands.about(0 * t, fit.problem.taut(fit.run))
    axes.fill_between(t, low / DEG, high / DEG, color="C0", alpha=0.3, linewidth=0, label="band of 95 %")
    errors = _broken(fit)(fit.errors()) / DEG
    axes.plot(t, errors, color="0.6", linewidth=0.6, label="not counted, from an unknown state")
    axes.plot(t, np.where(fit.log.settled, errors, np.nan), color="C3", linewidth=0.6)
    legend_below(axes)
    axes.axhline(0, color="0.6", linewidth=1)
    axes.axvspan(_HELD * t[-1], t[-1], color="0.92", zorder=0)
    held, left_out = fit.held_out.every / DEG, fit.left_out.every / DEG
    axes.set(xlabel="time [s]", ylabel="measured minus free run [°]")
    axes.set_title(f"held out (grey) {held:.2f}°, five blocks left out {left_out:.2f}° RMS")


def _residuals(fit: MotionFit, axes: "Axes") -> None:
    taut = fit.problem.taut(fit.run)
    for kind, colour, label in ((~taut, "C1", "a pressure below 1.5 bar"), (taut, "C0", "taut")):
        rows = kind & fit.log.settled
        if rows.any():
            axes.plot(
                fit.run.theta[rows] / DEG, fit.errors()[rows] / DEG, ".", color=colour, markersize=1.5, label=label
            )
    axes.axhline(0, color="0.6", linewidth=1)
    axes.set(xlabel="angle of the free run [°]", ylabel="measured minus free run [°]")
    legend_below(axes, markerscale=5)


def _loops(fit: MotionFit, axes: "Axes") -> None:
    """Draw the operator over sweeps of several heights."""
    for share in (1.0, 0.5, 0.2):
        height = share * fit.log.swing / 2
        to, fro = np.linspace(-height, height, 200), np.linspace(height, -height, 200)
        u = np.concatenate([to, fro, to])
        axes.plot(u[200:] / DEG, (fit.operator.run(u) - u)[200:] / DEG, label=f"± {height / DEG:.3g}°")
    axes.set(xlabel="static angle [°]", ylabel="angle minus static angle [°]", title="hysteresis at P1 + P2 = 5 bar")
    legend_below(axes)
