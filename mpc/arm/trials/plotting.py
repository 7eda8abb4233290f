"""Pictures of an arm's run are drawn here: the way of its hand, angles, stiffness and pressures over the time."""

from pathlib import Path
from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.presentation.plotting import save_figure
from allocator.units import BAR, DEG
from mpc.arm.trials.simulation import ArmRun

# Okabe & Ito's colours, told apart by colour-blind eyes
COLOURS = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#8c8c8c"
_BLACK = "#000000"
_GOLDEN = 0.5 * (5**0.5 - 1)  # whose multiples meet no period twice


def arm_figure(run: ArmRun) -> Any:
    """Draw a matplotlib figure of `run`, without pyplot, so that nothing global changes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 8.5), layout="constrained")
    grid = figure.add_gridspec(4, 2, width_ratios=[1, 2], height_ratios=[3, 1.4, 2.2, 3])
    hand, angle = figure.add_subplot(grid[:2, 0]), figure.add_subplot(grid[0, 1])
    error, stiffness = figure.add_subplot(grid[1, 1], sharex=angle), figure.add_subplot(grid[2, 1], sharex=angle)
    pressure, ellipses = figure.add_subplot(grid[3, 1], sharex=angle), figure.add_subplot(grid[2:, 0])
    _hand(hand, run)
    _ellipses(ellipses, run)
    _angles(angle, error, run)
    _stiffness(stiffness, run)
    for j, name in enumerate(run.arm.mechanism.muscle_names):
        pressure.plot(run.t, run.P[:, j] / BAR, color=COLOURS[j % len(COLOURS)], lw=1, label=name)
    pressure.set_ylabel("gauge pressure [bar]")
    pressure.set_xlabel("time [s]")
    for axes in (angle, stiffness, pressure):
        axes.legend(loc="upper left", bbox_to_anchor=(1.005, 1.02), frameon=False, fontsize="small")
    for axes in figure.axes:
        axes.grid(alpha=0.25)
    return figure


def save_arm_figure(run: ArmRun, path: str | Path) -> None:
    """Write the figure as an image, whole or not at all."""
    save_figure(arm_figure(run), path)


def _hand(axes: Any, run: ArmRun) -> None:
    """Draw the way of the endpoint, its reference, and the arm where it ends."""
    way, asked = run.arm.bodies.points(run.q), run.arm.bodies.points(run.q_ref)
    axes.plot(asked[:, -1, 0], asked[:, -1, 1], color=_BLACK, ls="--", lw=1, label="reference")
    axes.plot(way[:, -1, 0], way[:, -1, 1], color=COLOURS[0], lw=1.2, label="hand")
    axes.plot(way[-1, :, 0], way[-1, :, 1], color=COLOURS[7], lw=3, marker="o", zorder=0)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="x [m]", ylabel="y [m]")
    axes.legend(frameon=False, fontsize="small")


def _ellipses(axes: Any, run: ArmRun) -> None:
    """Draw what forces of 1 N in all directions move the hand by, at some moments: the compliance J K⁻¹ Jᵀ."""
    turn = np.linspace(0, 2 * np.pi, 73)
    circle = np.stack([np.cos(turn), np.sin(turn)])
    for k in (np.arange(9) * _GOLDEN % 1 * (len(run.t) - 1)).astype(int):
        J = endpoint_jacobian(run.arm.bodies, run.q[k])
        stiff = run.K[k] + run.arm.bodies.gravity_stiffness(run.q[k])
        moved = J @ np.linalg.solve(stiff, J.T) @ circle
        x, y = run.arm.bodies.points(run.q[k])[-1]
        axes.plot(x + moved[0], y + moved[1], color=COLOURS[0], lw=1)
        axes.plot(x, y, ".", color=COLOURS[1], ms=3)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="x [m]", ylabel="y [m]", title="where 1 N moves the hand")


def endpoint_jacobian(bodies: Any, q: Array) -> Array:
    """Return ∂(x, y)/∂q (2, n) of the endpoint in the plane: a hinge at p moves it by (-(y - p_y), x - p_x)."""
    points = bodies.points(q)
    arms = points[-1] - points[:-1]
    return np.stack([-arms[:, 1], arms[:, 0]])


def _angles(axes: Any, errors: Any, run: ArmRun) -> None:
    for i, name in enumerate(run.arm.mechanism.joint_names):
        axes.plot(run.t, run.q[:, i] / DEG, color=COLOURS[i], label=name)
        axes.plot(run.t, run.q_ref[:, i] / DEG, color=_BLACK, ls="--", lw=0.8, label="reference" if i == 0 else None)
        errors.plot(run.t, (run.q - run.q_ref)[:, i] / DEG, color=COLOURS[i], lw=1)
    axes.set_ylabel("joint angle [°]")
    errors.set_ylabel("error [°]")


def _stiffness(axes: Any, run: ArmRun) -> None:
    for colour, (i, j) in enumerate(zip(*np.triu_indices(run.arm.n), strict=True)):
        if np.abs(run.K[:, i, j]).max() < 1e-6:  # of muscles that cross one joint only
            continue
        axes.plot(run.t, run.K[:, i, j], color=COLOURS[colour % len(COLOURS)], label=f"K{i + 1}{j + 1}")
        axes.plot(run.t, run.K_ref[:, i, j], color=_BLACK, ls="--", lw=0.8)
    axes.set_ylabel("stiffness [N·m/rad]")


__all__ = ["COLOURS", "arm_figure", "endpoint_jacobian", "save_arm_figure"]
