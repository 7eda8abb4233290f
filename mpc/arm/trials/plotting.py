"""Pictures of an arm's run are drawn here: the way of its hand, angles, stiffness and pressures over the time."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.mechanism.endpoint import Endpoint
from allocator.presentation.plotting import save_figure
from allocator.units import BAR, DEG
from mpc.arm.trials.simulation import ArmRun
from mpc.model.arm.bodies import Bodies

# Okabe & Ito's colours, told apart by colour-blind eyes
COLOURS = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#8c8c8c"
_BLACK = "#000000"
_SHOWN = 0.02  # [m] to all sides
_GOLDEN = 0.5 * (5**0.5 - 1)  # whose multiples meet no period twice


def arm_figure(run: ArmRun, hand: Endpoint | None = None) -> Any:
    """Draw a matplotlib figure of `run`, without pyplot, so that nothing global changes.

    `hand` is whose way is drawn, without it the endpoint that is tracked, or the end of a chain in the plane; of
    others with less than two coordinates none is.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 8.5), layout="constrained")
    grid = figure.add_gridspec(4, 2, width_ratios=[1, 2], height_ratios=[3, 1.4, 2.2, 3])
    way = _way(run, hand)
    if way is None:
        grid = figure.add_gridspec(4, 1, height_ratios=[3, 1.4, 2.2, 3])
    right = [figure.add_subplot(grid[row, grid.ncols - 1]) for row in range(4)]
    angle, error, stiffness, pressure = right
    for axes in right[1:]:
        axes.sharex(angle)
    if way is not None:
        _hand(figure.add_subplot(grid[:2, 0]), run, way)
        _ellipses(figure.add_subplot(grid[2:, 0]), run, way)
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


def save_arm_figure(run: ArmRun, path: str | Path, hand: Endpoint | None = None) -> None:
    """Write the figure as an image, whole or not at all."""
    save_figure(arm_figure(run, hand), path)


class Way(NamedTuple):
    """A `Way` is where a hand went and where it should have gone, in the two coordinates in which it moved most."""

    names: tuple[str, str]
    x: Array  # (M+1, 2) [m]
    asked: Array  # (M+1, 2) [m]
    J: Array  # ∂x/∂q (M+1, 2, n) [m/rad]


def _way(run: ArmRun, hand: Endpoint | None) -> Way | None:
    arm = run.arm
    hand = hand or arm.endpoint or (arm.bodies.endpoint if isinstance(arm.bodies, Bodies) else None)
    if hand is None or hand.dim < 2:
        return None
    place, asked = hand.at(run.q), hand.at(run.q_ref)
    two = np.sort(np.argsort(-np.ptp(asked.position, axis=0))[:2])
    names = getattr(hand.kinematics, "axes", "123456789")
    return Way((names[two[0]], names[two[1]]), place.position[:, two], asked.position[:, two], place.jacobian[:, two])


def _hand(axes: Any, run: ArmRun, way: Way) -> None:
    """Draw the way of the hand, its reference, and the arm in the plane where it ends."""
    axes.plot(way.asked[:, 0], way.asked[:, 1], color=_BLACK, ls="--", lw=1, label="reference")
    axes.plot(way.x[:, 0], way.x[:, 1], color=COLOURS[0], lw=1.2, label="hand")
    if isinstance(run.arm.bodies, Bodies):
        points = run.arm.bodies.points(run.q[-1])
        axes.plot(points[:, 0], points[:, 1], color=COLOURS[7], lw=3, marker="o", zorder=0)
    _at_least(axes, way.asked)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel=f"{way.names[0]} [m]", ylabel=f"{way.names[1]} [m]", title="the way of the hand")
    axes.legend(frameon=False, fontsize="small")


def _ellipses(axes: Any, run: ArmRun, way: Way) -> None:
    """Draw what forces of 1 N in all directions move the hand by, at some moments: the compliance J K⁻¹ Jᵀ."""
    K_joints = run.K if run.K_joints is None else run.K_joints
    turn = np.linspace(0, 2 * np.pi, 73)
    circle = np.stack([np.cos(turn), np.sin(turn)])
    for k in (np.arange(9) * _GOLDEN % 1 * (len(run.t) - 1)).astype(int):
        J, stiff = way.J[k], K_joints[k] + run.arm.bodies.gravity_stiffness(run.q[k])
        moved = J @ np.linalg.solve(stiff, J.T) @ circle
        x, y = way.x[k]
        axes.plot(x + moved[0], y + moved[1], color=COLOURS[0], lw=1)
        axes.plot(x, y, ".", color=COLOURS[1], ms=3)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel=f"{way.names[0]} [m]", ylabel=f"{way.names[1]} [m]", title="where 1 N moves the hand")


def _at_least(axes: Any, points: Array) -> None:
    """Let `axes` show some centimetres about `points` (…, 2): a hand that is held is no microscope's object."""
    middle, half = points.mean(axis=0), np.maximum(np.ptp(points, axis=0) / 2, _SHOWN)
    axes.plot(*np.transpose([middle - half, middle + half]), alpha=0.0)


def _angles(axes: Any, errors: Any, run: ArmRun) -> None:
    for i, name in enumerate(run.arm.mechanism.joint_names):
        axes.plot(run.t, run.q[:, i] / DEG, color=COLOURS[i % len(COLOURS)], label=name)
        axes.plot(run.t, run.q_ref[:, i] / DEG, color=_BLACK, ls="--", lw=0.8, label="reference" if i == 0 else None)
        errors.plot(run.t, (run.q - run.q_ref)[:, i] / DEG, color=COLOURS[i % len(COLOURS)], lw=1)
    axes.set_ylabel("joint angle [°]")
    errors.set_ylabel("error [°]")


def _stiffness(axes: Any, run: ArmRun) -> None:
    for colour, (i, j) in enumerate(zip(*np.triu_indices(run.arm.tracked), strict=True)):
        if np.abs(run.K[:, i, j]).max() < 1e-6:  # of muscles that cross one joint only
            continue
        axes.plot(
            run.t, run.K[:, i, j], color=COLOURS[colour % len(COLOURS)], label=f"{run.arm.stiffness_name}{i + 1}{j + 1}"
        )
        axes.plot(run.t, run.K_ref[:, i, j], color=_BLACK, ls="--", lw=0.8)
    axes.set_ylabel(f"stiffness [{run.arm.stiffness_unit}]")
