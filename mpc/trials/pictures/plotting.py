"""Pictures of a run: angles, stiffness and pressures with references and limits, and the path of a hand.

Reports of a run: a table of its errors, files in the format of their suffix, and a picture of margins.
"""

from collections.abc import Callable, Iterator, Sequence
from os import PathLike
from pathlib import Path
from textwrap import wrap
from typing import Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.joint.limits import Limits
from allocator.lazy import Axes, Figure, Table
from allocator.mechanism.endpoint import Endpoint
from allocator.presentation.plotting import GREY, legend_below, legend_outside, name_axes, new_figure, save_figure
from allocator.units import BAR, DEG
from mpc.model.arm.bodies import Bodies
from mpc.model.arm.model import Arm
from mpc.model.plant import Plant
from mpc.model.real import STIFFNESS_BAND
from mpc.trials.files import save_mcap, save_recording, save_run
from mpc.trials.margins import ROBUST, Margins
from mpc.trials.metrics import Errors, Metrics, metrics
from mpc.trials.pictures.animation import ENDINGS
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
    K_joints = run.plant.stiffness(run.x)
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


_NOTHING = 1e-6  # [N·m/rad]
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
        if np.abs(table[name]).max() < _NOTHING:  # for muscles that cross only one joint
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


_LOWEST = 0.2  # [Hz]
_PLANE = 2.5  # of the plane around -1
_CIRCLE = np.exp(1j * np.linspace(0, 2 * np.pi, 361))

_WORTH_SAYING = 5.0  # [% of the steps] at the slew limit, below which nothing is reported


def plot_margins(found: Sequence[Margins], path: str | PathLike[str] | None = None, title: str = "") -> "Figure":
    """Return a figure of |S| and of L's eigenvalues in the plane, one colour per posture, and write it to a `path`.

    The circle of radius 1/2 around -1, which L does not enter while M_s ≤ 2, is grey.
    """
    figure = new_figure(11, 4.2)
    plane, spectrum = figure.subplots(1, 2)
    spectrum.axhline(ROBUST, color=GREY, ls="--", lw=1)
    plane.fill((_CIRCLE / ROBUST - 1).real, (_CIRCLE / ROBUST).imag, color=GREY, alpha=0.25, lw=0)
    plane.plot(-1, 0, "+", color="black")
    for margins, colour in zip(found, COLOURS, strict=False):
        name = f"{margins.place}: M_s = {margins.sensitivity_peak:.2f}"
        spectrum.loglog(margins.frequency, margins.magnitude, color=colour, label=name)
        for locus in margins.L:
            plane.plot(locus.real, locus.imag, color=colour)
    spectrum.set_xlim(left=_LOWEST)
    spectrum.set_ylim(bottom=0.05)
    plane.set(xlim=(-_PLANE + 0.5, 0.5), ylim=(-_PLANE / 2, _PLANE / 2), aspect="equal")
    name_axes(spectrum, "frequency [Hz]", "sensitivity |S| [-]")
    name_axes(plane, "real part of L [-]", "imaginary part of L [-]")
    spectrum.legend(loc="lower right", fontsize=8)
    figure.suptitle(title)
    if path is not None:
        save_figure(figure, path)
    return figure


def reach_in_words(share: float) -> str:
    """Return a sentence about the `share` [%] of a reference that is out of reach."""
    return f"{share:.3g} % of the reference is out of reach; `antagonist map` shows the reachable targets"


def limits_of_reference(figures: Metrics, slew: float) -> Iterator[str]:
    """Yield sentences about references out of reach, and about steps at the `slew` limit [Pa/s]."""
    if figures.out_of_reach:
        yield reach_in_words(figures.out_of_reach)
    if figures.at_slew_limit >= _WORTH_SAYING:
        share = f"in {figures.at_slew_limit:.3g} % of the steps a command changed at the limit --slew"
        yield f"{share} ({slew / BAR:g} bar/s): the reference may be too fast"


_UNMEASURED = "not measured"


def write_run(
    run: Run,
    path: Path,
    film: Callable[[Path], None] | None,
    title: str = "",
    hand: Endpoint | None = None,
    model: Plant | None = None,
) -> None:
    """Write `run` as CSV, NPZ or MCAP, as a film by `film`, or as a picture; see `tracking_figure`."""
    ending = path.suffix.lower()
    if ending == ".csv":
        save_run(run, path)
    elif ending == ".npz":
        save_recording(run, path)
    elif ending == ".mcap":
        save_mcap(run, path)
    elif film is not None and ending in ENDINGS:
        film(path)
    else:
        save_tracking_figure(run, path, title, hand, model)


def table_of(run: Run, m: Metrics) -> "Table":
    """Return the errors of a run, the violated limits, and the times and rungs of its steps."""
    from rich.markup import escape
    from rich.table import Table

    table = Table("", "RMS, median", "worst, 99 %", title="tracking")
    _add_errors(table, run, m)
    if m.rest:
        table.add_row(f"after the first rest of {m.rest:.3g} s")
        _add_errors(table, run, m.after_rest, "  ")
    table.add_section()
    for limit, (excess, unit) in m.violations.items():
        table.add_row(limit, "", f"exceeded by {excess:.3g} {unit}" if excess else "kept")
    if isinstance(run.plant, Plant) and run.plant.joint.slack_assumed:
        table.add_row("slack limits", "", "assumed")
    table.add_section()
    table.add_row(escape("time of a step [ms]"), f"{m.step_median:.3g}", f"{m.step_p99:.3g}")
    if run.implementation:
        table.add_row("implementation of the step", "", run.implementation)
    for rung, steps in m.rungs.items():
        if steps:
            table.add_row(f"steps answered by {rung}", "", str(steps))
    return table


def table_of_errors(run: Run, errors: Errors, title: str) -> "Table":
    """Return a table of `errors` of a run."""
    from rich.table import Table

    table = Table("", "RMS", "worst", title=title)
    _add_errors(table, run, errors)
    return table


def _add_errors(table: "Table", run: Run, of: Metrics | Errors, indent: str = "") -> None:
    """Add a row for each error: its name, its RMS and its worst."""
    from rich.markup import escape

    for name, *figures in _errors(run, of):
        table.add_row(
            escape(indent + name), *(_UNMEASURED if np.isnan(figure) else f"{figure:.3g}" for figure in figures)
        )


def _errors(run: Run, of: Metrics | Errors) -> Iterator[tuple[str, float, float]]:
    """Yield the name of each error, its RMS and its worst."""
    plant = run.plant
    names = [""] if isinstance(plant, Plant) else [f", {name}" for name in plant.mechanism.joint_names]
    for name, rms, worst in zip(names, np.ravel(of.theta_rms), np.ravel(of.theta_worst), strict=True):
        yield f"angle error{name} [°]", rms, worst
    if isinstance(plant, Plant):
        yield f"{plant.stiffness_text} error [%]", of.K_rms, of.K_worst
        return
    for name, i, j in zip(plant.labels.stiffness, *np.triu_indices(plant.tracked), strict=True):
        if not np.abs(run.K[:, i, j]).max() <= _NOTHING:
            yield f"stiffness error, {name} [{plant.stiffness_unit}]", of.K_rms[i, j], of.K_worst[i, j]
