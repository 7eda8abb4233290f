"""Pictures of a joint's fit: angle against prediction, residual with hysteresis, stiffness with its band."""

import numpy as np

from allocator.calculus import Array
from allocator.identification.joint.relative import RelativeJoint, stiffness_with_gradient
from allocator.identification.joint.result import JointFit
from allocator.lazy import Axes, Figure
from allocator.presentation.plotting import legend_below, new_figure
from allocator.units import BAR, DEG

_WAYS = ((1.0, "rising θ", "C1", "^"), (-1.0, "falling θ", "C0", "v"), (0.0, "direction unknown", "C2", "o"))
_LEVELS = (0.4, 0.6, 0.8)  # of the supply, co-contractions drawn


def plot_joint_fit(fit: JointFit, figure: "Figure | None" = None) -> "Figure":
    """Draw the three pictures side by side; returns the Matplotlib figure, a new one unless `figure` is given."""
    figure = new_figure(14, 4.6) if figure is None else figure
    left, middle, right = figure.subplots(1, 3)
    _angles(fit, left)
    _residuals(fit, middle)
    _stiffness(fit, right)
    return figure


def _angles(fit: JointFit, axes: "Axes") -> None:
    measured, predicted = fit.samples.theta / DEG, fit.predicted() / DEG
    ends = [measured.min(), measured.max()]
    axes.plot(ends, ends, color="0.6", linewidth=1, zorder=0)
    for way, label, colour, marker in _WAYS:
        here = fit.samples.direction == way
        if here.any():
            axes.plot(predicted[here], measured[here], marker, color=colour, markersize=3.5, alpha=0.7, label=label)
    axes.set(xlabel="predicted angle [°]", ylabel="measured angle [°]")
    axes.set_title(f"{fit.model}: {fit.rms / DEG:.2f}° RMS, μ = {fit.friction:.3f}")
    legend_below(axes)


def _residuals(fit: JointFit, axes: "Axes") -> None:
    """Draw the errors of the prediction without friction; the band shows the fitted friction."""
    problem, u = fit.problem, fit.problem.unknowns(fit.x)
    still, _ = problem.still().equilibrium(u)
    moving, _ = problem.equilibrium(u)
    error = (fit.samples.theta - u.zero - still) / DEG
    band = (moving - still) / DEG
    for way, label, colour, marker in _WAYS:
        here = fit.samples.direction == way
        if not here.any():
            continue
        axes.plot(still[here] / DEG, error[here], marker, color=colour, markersize=3.5, alpha=0.7, label=label)
        if way and fit.friction:
            order = np.argsort(still[here])
            at, width = still[here][order] / DEG, band[here][order]
            axes.fill_between(at, *_envelope(width), color=colour, alpha=0.18, linewidth=0)
    axes.axhline(0, color="0.6", linewidth=1, zorder=0)
    axes.set(xlabel="predicted angle without friction [°]", ylabel="measured minus predicted [°]")
    share = "" if np.isnan(fit.hysteresis_share) else f"{fit.hysteresis_share:.0%} of the squared error is hysteresis"
    axes.set_title(share or "error without friction")
    legend_below(axes, "band: friction μ" if fit.friction else None)


def _envelope(values: Array) -> tuple[Array, Array]:
    """Return the running least and greatest of the neighbours, so that the band is smooth."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    width = 2 * max(1, values.size // 12) + 1
    return minimum_filter1d(values, width, mode="nearest"), maximum_filter1d(values, width, mode="nearest")


def _stiffness(fit: JointFit, axes: "Axes") -> None:
    """Draw K or K/K_ref over the angle at three co-contractions, ± 2 standard deviations."""
    label, joint = next(iter(fit.shapes.items()))
    theta = np.linspace(*joint.angle_range, 61)
    relative = RelativeJoint(joint)
    for share, colour in zip(_LEVELS, ("C0", "C2", "C3"), strict=True):
        P = np.full_like(theta, share * joint.pressure_limits[1])
        if fit.scale is None:
            K = relative.relative_stiffness(theta, P, P)
            std = 0 * K if joint.covariance is None else relative.relative_stiffness_std(theta, P, P)
        else:
            quantity = stiffness_with_gradient(joint, theta, P, P)
            K = quantity.value
            std = 0 * K if joint.covariance is None else quantity.std(np.asarray(joint.covariance))
        axes.plot(theta / DEG, K, color=colour, label=f"P1 = P2 = {P[0] / BAR:.2g} bar")
        axes.fill_between(theta / DEG, K - 2 * std, K + 2 * std, color=colour, alpha=0.2, linewidth=0)
    known = fit.scale is not None
    axes.set(
        xlabel="angle [°]", ylabel="isobaric stiffness K [N·m/rad]" if known else "relative isobaric stiffness K/K_ref"
    )
    where = "" if len(fit.shapes) == 1 else f" ({label})"
    axes.set_title(f"stiffness ± 2 std{where}" if known else f"force scale unknown: K/K_ref ± 2 std{where}")
    axes.set_ylim(bottom=0)
    legend_below(axes)
