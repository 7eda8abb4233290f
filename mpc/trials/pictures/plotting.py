"""Pictures of a run: angles, stiffness and pressures with references and limits, and the path of a hand."""

from dataclasses import replace
from pathlib import Path
from textwrap import wrap
from typing import Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.joint.limits import Limits
from allocator.lazy import Axes, Figure
from allocator.mechanism.bodies import Bodies
from allocator.mechanism.endpoint import Endpoint
from allocator.presentation.plotting import GREY, legend_below, legend_outside, new_figure, save_figure
from allocator.units import BAR, DEG
from mpc.model.arm.model import Arm
from mpc.model.plant import Plant
from mpc.trials.metrics import metrics
from mpc.trials.other_plant import STIFFNESS_BAND
from mpc.trials.simulation import Run

# Okabe & Ito's colours, distinguishable with colour blindness
COLOURS = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#8c8c8c"
_BLACK = "#000000"
_SHOWN = 0.02  # [m] to all sides of a path
_GOLDEN = 0.5 * (5**0.5 - 1)  # its multiples meet no period twice


class Way(NamedTuple):
    """Path of a hand and its reference, in the two coordinates with the most motion."""

    names: tuple[str, str]
    x: Array  # (M+1, 2) [m]
    asked: Array  # (M+1, 2) [m]
    J: Array  # ∂x/∂q (M+1, 2, n) [m/rad]


def way_of(run: Run, hand: Endpoint | None = None) -> Way | None:
    """Return the path of `hand`, or else of the tracked endpoint, or of the end of a chain in the plane.

    None for a joint, and if fewer than two coordinates are known.
    """
    arm = run.plant
    if not isinstance(arm, Arm):
        return None
    hand = hand or arm.endpoint or (arm.bodies.endpoint if isinstance(arm.bodies, Bodies) else None)
    if hand is None or hand.dim < 2:
        return None
    place, asked = hand.at(run.theta), hand.at(run.theta_ref)
    two = np.sort(np.argsort(-np.ptp(asked.position, axis=0))[:2])
    names = getattr(hand.kinematics, "axes", "123456789")
    return Way((names[two[0]], names[two[1]]), place.position[:, two], asked.position[:, two], place.jacobian[:, two])


def draw_hand(axes: "Axes", run: Run, way: Way) -> None:
    """Draw the path of the hand, its reference, and the arm in the plane at the end."""
    axes.plot(way.asked[:, 0], way.asked[:, 1], color=_BLACK, ls="--", lw=1, label="reference")
    axes.plot(way.x[:, 0], way.x[:, 1], color=COLOURS[0], lw=1.2, label="hand")
    if isinstance(run.plant.bodies, Bodies):
        points = run.plant.bodies.points(run.theta[-1])
        axes.plot(points[:, 0], points[:, 1], color=COLOURS[7], lw=3, marker="o", zorder=0)
    _at_least(axes, way.asked)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel=f"{way.names[0]} [m]", ylabel=f"{way.names[1]} [m]", title="path of the hand")
    legend_below(axes)


def draw_ellipses(axes: "Axes", run: Run, way: Way) -> None:
    """Draw the displacements of the hand by forces of 1 N, at some moments: the compliance J K⁻¹ Jᵀ."""
    K_joints = replace(run.plant, endpoint=None).along(run.x)[0]
    turn = np.linspace(0, 2 * np.pi, 73)
    circle = np.stack([np.cos(turn), np.sin(turn)])
    for k in (np.arange(9) * _GOLDEN % 1 * (len(run.t) - 1)).astype(int):
        J, stiff = way.J[k], K_joints[k] + run.plant.bodies.gravity_stiffness(run.theta[k])
        moved = J @ np.linalg.solve(stiff, J.T) @ circle
        x, y = way.x[k]
        axes.plot(x + moved[0], y + moved[1], color=COLOURS[0], lw=1)
        axes.plot(x, y, ".", color=COLOURS[1], ms=3)
    axes.set_aspect("equal", adjustable="datalim")
    axes.locator_params(axis="x", nbins=4)  # of a narrow panel, with numbers of several digits
    axes.set(xlabel=f"{way.names[0]} [m]", ylabel=f"{way.names[1]} [m]", title="displacement by 1 N")


def _at_least(axes: "Axes", points: Array) -> None:
    """Let `axes` show some centimetres about `points` (…, 2), even if the hand does not move."""
    middle, half = points.mean(axis=0), np.maximum(np.ptp(points, axis=0) / 2, _SHOWN)
    axes.plot(*np.transpose([middle - half, middle + half]), alpha=0.0)


NOTHING = 1e-6  # [N·m/rad] of an entry of the stiffness: no muscle crosses both joints
_LABEL = 24  # characters of a label's line beside a small panel
_PAIR = 2.2, 2.2  # heights of the pressures of two muscles, each with its command and infeasible pressures
_MANY = (3.0,)  # of those of more muscles


def tracking_figure(run: Run, title: str = "", hand: Endpoint | None = None, model: Plant | None = None) -> "Figure":
    """Return a matplotlib figure of `run`, made without pyplot, with `title` above it.

    An arm's figure also has the path of its `hand`, see `mpc.trials.pictures.plotting.way_of`. With the controller's
    `model` of a joint, the stiffness that it predicts from the estimated states is drawn as a 95 % band.
    """
    pair, way = isinstance(run.plant, Plant), way_of(run, hand)
    heights = 3.0, 1.3, 2.2, *(_PAIR if pair else _MANY)
    figure = new_figure(9 if way is None else 11, 9.2)
    columns = [1] if way is None else [1, 2]
    grid = figure.add_gridspec(len(heights), len(columns), width_ratios=columns, height_ratios=heights)
    angle, angle_error, stiffness, *pressures = (figure.add_subplot(grid[row, -1]) for row in range(len(heights)))
    for axes in (angle_error, stiffness, *pressures):
        axes.sharex(angle)
    for axes in (angle, angle_error, stiffness, *pressures[:-1]):
        axes.tick_params(labelbottom=False)
    _angle(angle, angle_error, run)
    _stiffness(stiffness, run, model)
    if pair:
        for muscle, axes in enumerate(pressures):
            _pressure(axes, run, muscle)
    else:
        _pressures(pressures[0], run)
    pressures[-1].set_xlabel("time [s]")
    for axes in figure.axes:
        axes.margins(x=0.01)
    if way is not None:
        draw_hand(figure.add_subplot(grid[:2, 0]), run, way)
        draw_ellipses(figure.add_subplot(grid[2:, 0]), run, way)
    for axes in figure.axes:
        axes.grid(alpha=0.25)
    figure.align_ylabels()
    figure.suptitle("\n".join(filter(None, (title, errors(run)))), fontsize="medium")
    return figure


def errors(run: Run) -> str:
    """Return a line with the errors of angle and stiffness."""
    m = metrics(run)
    angle, K = np.max(m.theta_rms), np.max(m.K_rms)
    return f"RMS: angle {angle:.3g}°, {run.plant.stiffness_text} {K:.3g} {m.K_unit}"


def save_tracking_figure(
    run: Run, path: str | Path, title: str = "", hand: Endpoint | None = None, model: Plant | None = None
) -> None:
    """Write the figure of `tracking_figure` as an image, whole or not at all."""
    save_figure(tracking_figure(run, title, hand, model), path)


def _angle(axes: "Axes", errors: "Axes", run: Run) -> None:
    plant, rows = run.plant, run.t.size
    theta, asked = (a.reshape(rows, -1) / DEG for a in (run.theta, run.theta_ref))
    names = ("angle",) if plant.angle_shape == () else plant.labels.angles
    for i, name in enumerate(names):
        axes.plot(run.t, theta[:, i], color=COLOURS[i % len(COLOURS)], label=name)
        axes.plot(run.t, asked[:, i], color=_BLACK, ls="--", lw=1, label="reference")
        errors.plot(run.t, theta[:, i] - asked[:, i], color=COLOURS[i % len(COLOURS)], lw=1)
    for limit in np.ravel(plant.angle_limits) / DEG:
        if len(names) == 1 and abs(limit) < 1.6 * np.abs(theta).max():  # a distant limit would only flatten the curve
            axes.axhline(limit, color=GREY, ls="-.", lw=1, label="end of the joint range")
    axes.set_ylabel("joint angle θ [°]")
    _widen(axes, 2.0)
    legend_outside(axes)
    errors.set_ylabel("error of θ [°]")


def _stiffness(axes: "Axes", run: Run, model: Plant | None) -> None:
    if model is not None:
        believed = model.along(run.estimate[:, : model.size])[0]
        axes.fill_between(
            run.t[:-1], (1 - STIFFNESS_BAND) * believed, (1 + STIFFNESS_BAND) * believed,
            color=COLOURS[5], alpha=0.3, lw=0, label=f"model ± {100 * STIFFNESS_BAND:.0f} %, 95 % band",
        )  # fmt: skip
    table, names = run.to_dict(), run.plant.labels.stiffness
    for i, name in enumerate(names):
        if np.abs(table[name]).max() < NOTHING:
            continue
        reached = f"{name} reached" if run.plant.angle_shape == () else name
        axes.plot(run.t, table[name], color=COLOURS[i % len(COLOURS)], label=reached)
        axes.plot(run.t, table[f"{name}_ref"], color=_BLACK, ls="--", lw=1, label="reference")
    name, *frequency = run.plant.stiffness_text.split(" at ")
    unit = f"[{run.plant.stiffness_unit}]"
    axes.set_ylabel("\n".join([*wrap(f"{name} K", _LABEL), " at ".join([unit, *frequency])]))
    _widen(axes, 0.2)
    legend_outside(axes)


def _pressures(axes: "Axes", run: Run) -> None:
    """Draw the pressures of all muscles."""
    for j, name in enumerate(run.plant.labels.pressures):
        axes.plot(run.t, run.P[:, j] / BAR, color=COLOURS[j % len(COLOURS)], lw=1, label=name)
    axes.set_ylabel("gauge pressure [bar]")
    legend_outside(axes)


def _pressure(axes: "Axes", run: Run, muscle: int) -> None:
    """Draw pressure and command of a muscle (0, 1), with the infeasible pressures shaded."""
    color, name = ((COLOURS[0], "P1"), (COLOURS[1], "P2"))[muscle]
    low, high = (limit / BAR for limit in run.plant.joint.pressure_limits)
    taut = _taut_limit(run)[muscle] / BAR
    axes.plot(run.t, run.P[:, muscle] / BAR, color=color, label=f"pressure {name}")
    axes.step(run.t[:-1], run.u[:, muscle] / BAR, color=_BLACK, lw=0.7, alpha=0.6, where="post", label="command")
    floor, ceiling = low - 0.05 * (high - low), high + 0.08 * (high - low)
    forbidden: dict[str, Any] = {"color": GREY, "alpha": 0.25, "lw": 0}
    axes.fill_between(run.t, floor, np.maximum(taut, low), label="slack, or beyond the supply", **forbidden)
    axes.axhspan(high, ceiling, **forbidden)
    axes.set_ylim(floor, ceiling)
    axes.set_ylabel(f"{('agonist', 'antagonist')[muscle]}\n[bar]")
    legend_outside(axes)


def _taut_limit(run: Run) -> tuple[Array, Array]:
    """Return the pressures (M+1,) below which agonist and antagonist are slack [Pa]."""
    box = run.plant.joint.pressure_box(run.theta, Limits(min_force=0.0))
    return box.agonist.lo, box.antagonist.lo


def _widen(axes: "Axes", least: float) -> None:
    """Give the axis a least height, so that nearly constant curves look constant."""
    low, high = axes.get_ylim()
    if high - low < least:
        axes.set_ylim((low + high - least) / 2, (low + high + least) / 2)
