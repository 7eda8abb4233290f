"""Picture of a measurement: felt stiffness against amplitude, measured and by the model."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.felt import Loop
from allocator.presentation.plotting import legend_below, new_figure
from allocator.units import DEG
from mpc.bench.measuring.result import MeasuredStiffness

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BAND = 1.96  # of 95 %


def plot_measured(
    found: Sequence[MeasuredStiffness], joint: AntagonistJoint, loop: Loop, figure: "Figure | None" = None
) -> "Figure":
    """Draw K_felt(A) of each rest with 95 % bands, and the model's; returns the Matplotlib figure.

    `joint` and its `loop` of hysteresis are the model before the measurement.
    """
    from matplotlib.ticker import LogLocator, NullFormatter

    figure = new_figure(7, 5) if figure is None else figure
    axes = figure.subplots()
    for k, m in enumerate(m for m in found if m.success):
        A = np.array([f.amplitude for f in m.felt]) / DEG
        K, std = (np.array([getattr(f, name) for f in m.felt]) for name in ("K", "K_std"))
        at = f"{round(m.theta / DEG)}°"
        fine = np.geomspace(A.min() / 2, A.max() * 1.5, 120)
        felt = [joint.stiffness(m.theta, *m.pressures, amplitude=a * DEG, loop=loop) for a in fine]
        axes.plot(fine, felt, "--", color=f"C{k}", lw=1, label=f"model, {at}")
        axes.errorbar(A, K, _BAND * std, fmt="o", color=f"C{k}", capsize=3, label=f"measured, {at}")
        axes.axhspan(m.K - _BAND * m.K_std, m.K + _BAND * m.K_std, color=f"C{k}", alpha=0.2, lw=0)
        axes.axhline(m.K, color=f"C{k}", lw=1.5, label=f"backbone measured, {at}")
        axes.axhline(m.model_K, color=f"C{k}", lw=1, ls=":", label=f"backbone of the model, {at}")
    axes.set_xscale("log")
    axes.set_ylim(0)
    axes.set(xlabel="amplitude of the push [±°]", ylabel="stiffness [N·m/rad]")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
    legend_below(axes)
    return figure
