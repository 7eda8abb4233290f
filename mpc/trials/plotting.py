"""The picture of a run is drawn here: angle, stiffness and pressures against their references and limits."""

from pathlib import Path
from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.joint.limits import Limits
from allocator.presentation.plotting import new_figure, save_figure
from allocator.units import BAR, DEG
from mpc.trials.metrics import metrics
from mpc.trials.simulation import Run

# Okabe & Ito's colours, told apart by colour-blind eyes
_BLUE, _ORANGE, _BLACK, _GREY = "#0072B2", "#D55E00", "#000000", "#8c8c8c"


def tracking_figure(run: Run, title: str = "") -> Any:
    """Draw a matplotlib figure of `run`, without pyplot, so that nothing global changes; `title` names what it is."""
    figure = new_figure(9, 9.2)
    angle, angle_error, stiffness, *pressures = figure.subplots(
        5, 1, sharex=True, height_ratios=[3, 1.3, 2.2, 2.2, 2.2]
    )
    _angle(angle, angle_error, run)
    _stiffness(stiffness, run)
    for muscle, axes in enumerate(pressures):
        _pressure(axes, run, muscle)
    pressures[-1].set_xlabel("time [s]")
    for axes in figure.axes:
        axes.grid(alpha=0.25)
        axes.margins(x=0.01)
    figure.align_ylabels()
    figure.suptitle("\n".join(filter(None, (title, errors(run)))), fontsize="medium")
    return figure


def errors(run: Run) -> str:
    """Say the errors of angle and stiffness in a line."""
    m = metrics(run)
    return f"RMS: angle {m.theta_rms:.3g}°, {run.plant.kind.text} {m.K_rms:.3g} %"


def save_tracking_figure(run: Run, path: str | Path, title: str = "") -> None:
    """Write the figure as an image, whole or not at all."""
    save_figure(tracking_figure(run, title), path)


def _angle(axes: Any, errors: Any, run: Run) -> None:
    axes.plot(run.t, run.theta / DEG, color=_BLUE, label="angle")
    axes.plot(run.t, run.theta_ref / DEG, color=_BLACK, ls="--", lw=1, label="reference")
    for limit in np.array(run.plant.joint.angle_range) / DEG:
        if abs(limit) < 1.6 * np.abs(run.theta / DEG).max():  # a far limit would only flatten the curve
            axes.axhline(limit, color=_GREY, ls="-.", lw=1, label="end of the joint range")
    axes.set_ylabel("joint angle θ [°]")
    _widen(axes, 2.0)
    _legend(axes)
    errors.plot(run.t, (run.theta - run.theta_ref) / DEG, color=_BLUE, lw=1)
    errors.set_ylabel("error of θ [°]")


def _stiffness(axes: Any, run: Run) -> None:
    axes.plot(run.t, run.K, color=_BLUE, label="stiffness")
    axes.plot(run.t, run.K_ref, color=_BLACK, ls="--", lw=1, label="reference")
    name, *frequency = run.plant.kind.text.split(" at ")
    axes.set_ylabel("\n".join([f"{name} K", " at ".join(["[N·m/rad]", *frequency])]))
    _widen(axes, 0.2)
    _legend(axes)


def _pressure(axes: Any, run: Run, muscle: int) -> None:
    """Draw pressure and command of a muscle (0, 1); what is shaded is forbidden: beyond the supply, or slack."""
    color, name = ((_BLUE, "P1"), (_ORANGE, "P2"))[muscle]
    low, high = (limit / BAR for limit in run.plant.joint.pressure_limits)
    taut = _taut_limit(run)[muscle] / BAR
    axes.plot(run.t, run.P[:, muscle] / BAR, color=color, label=f"pressure {name}")
    axes.step(run.t[:-1], run.u[:, muscle] / BAR, color=_BLACK, lw=0.7, alpha=0.6, where="post", label="command")
    floor, ceiling = low - 0.05 * (high - low), high + 0.08 * (high - low)
    forbidden = {"color": _GREY, "alpha": 0.25, "lw": 0}
    axes.fill_between(run.t, floor, np.maximum(taut, low), label="slack, or beyond the supply", **forbidden)
    axes.axhspan(high, ceiling, **forbidden)
    axes.set_ylim(floor, ceiling)
    axes.set_ylabel(f"{('agonist', 'antagonist')[muscle]}\n[bar]")
    _legend(axes)


def _taut_limit(run: Run) -> tuple[Array, Array]:
    """Return the pressures (M+1,) below which agonist and antagonist go slack [Pa]."""
    box = run.plant.joint.pressure_box(run.theta, Limits(min_force=0.0))
    return box.agonist.lo, box.antagonist.lo


def _widen(axes: Any, least: float) -> None:
    """Make the axis at least so high: what should be constant shall look it."""
    low, high = axes.get_ylim()
    if high - low < least:
        axes.set_ylim((low + high - least) / 2, (low + high + least) / 2)


def _legend(axes: Any) -> None:
    """Draw the legend to the right of the axes, where no data are; what is drawn twice is named once."""
    named = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    axes.legend(
        named.values(), named.keys(), loc="upper left", bbox_to_anchor=(1.005, 1.02), frameon=False, fontsize="small"
    )
