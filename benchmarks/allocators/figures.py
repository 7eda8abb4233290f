"""Plots of the report."""

from itertools import groupby
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

from allocator import BAR, DEG
from benchmarks.allocators.comparison import Results
from benchmarks.allocators.contenders import BACK_ENDS, CONTENDERS, EXACT, INVERSES, Allocator, Answer, Inverse
from benchmarks.allocators.effect import effect
from benchmarks.allocators.targets import Array, TargetSet, report_grid

COLOURS = ("#c44e52", "#dd8452", "#ccb974")  # of the three inverses
BLUE, GREY = "#4c72b0", "#8c8c8c"
CURVES = ({"color": COLOURS[1], "lw": 3}, {"color": "black", "ls": ":"}, {"color": BLUE})
BACKED = [back_end.name for back_end in BACK_ENDS]
STYLE = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False}


def draw(results: Results, out: Path) -> None:
    """Write all plots into the folder `out`."""
    plots = {
        "within_limits": within_limits,
        "torque_error": torque_error,
        "pressures": pressures,
        "time": time,
    }
    with mpl.rc_context(STYLE):
        for name, plot in plots.items():
            figure = plot(results)
            figure.savefig(out / f"allocators_{name}.png", dpi=110, metadata={"Software": None})
            plt.close(figure)


def within_limits(results: Results) -> Any:
    """Draw the share of answers within all limits, a bar for each set; of the back-ends the least share."""
    figure, axes = plt.subplots(figsize=(7.5, 3.6), layout="constrained")
    groups = {c.name: [c.name] for c in (*INVERSES, EXACT)} | {f"all {len(BACKED)} back-ends": BACKED}
    height = 0.8 / len(results.sets)
    shades = [GREY, *mpl.colormaps["Blues"](np.linspace(0.4, 0.9, len(results.sets) - 1))]
    for i, (targets, shade) in enumerate(zip(results.sets, shades, strict=True)):
        shares = [100 * min(of(results, targets, name).within_limits for name in names) for names in groups.values()]
        label = f"{targets.name}, {targets.joint_name}"
        axes.barh(np.arange(len(groups)) + (i - 2) * height, shares, height, color=shade, label=label)
    axes.set_yticks(range(len(groups)), list(groups))
    axes.invert_yaxis()
    axes.set(xlabel="answers within all limits [%]", xlim=(0, 100))
    figure.legend(loc="outside lower center", ncols=2, fontsize=8)
    return figure


def of(results: Results, targets: TargetSet, name: str) -> Any:
    """Return the torque-first score of a contender on a set."""
    wanted = (targets.name, targets.joint_name, name, "torque")
    return next(s for s in results.scores if (s.set, s.joint, s.contender, s.priority) == wanted)


def torque_error(results: Results) -> Any:
    """Draw the share of targets with reachable torque at which the torque error exceeds a value."""
    figure, panels = plt.subplots(1, 2, figsize=(7.5, 3.2), layout="constrained", sharey=True)
    grid, random = results.sets[:1], results.sets[1:]
    for axes, sets, title in zip(panels, (grid, random), ("Fig. 8", "random targets, all joints"), strict=True):
        for contender, line in zip((*INVERSES[1:], EXACT), CURVES, strict=True):
            errors = np.sort(np.concatenate([reachable_errors(targets, contender) for targets in sets]))
            share = 100 * (1 - np.arange(1, errors.size + 1) / errors.size)
            x, y = np.append(np.maximum(errors, 1e-4), 100), np.append(share, 0)
            axes.step(x, y, where="post", label=contender.name, **line)
        axes.set(xscale="log", xlim=(1e-3, 50), ylim=(-2, 100), title=title, xlabel="torque error x [N·m]")
    panels[0].set_ylabel("targets with error > x [%]")
    largest = max(s.T_worst_reachable for s in results.scores if s.priority == "torque" and s.contender in BACKED)
    panels[1].legend(title=f"(back-ends: as exact, to {largest:.0e} N·m)", fontsize=8, title_fontsize=8)
    return figure


def reachable_errors(targets: TargetSet, contender: Inverse | Allocator) -> Array:
    found = effect(targets, contender.answer(targets, "torque"))
    errors = np.abs(found.T - targets.T)[targets.torque_reachable]
    return np.asarray(errors[~np.isnan(errors)])


def pressures(results: Results) -> Any:
    """P1 - P2 and P1 + P2 over the angle at K = 6, 7, 8, 9 N·m/rad and T = 0, as in the report's Fig. 8."""
    figure, panels = plt.subplots(1, 2, figsize=(7.5, 3.8), layout="constrained")
    targets, shape = report_grid(251, 4), (4, 251)
    theta, raw, exact = targets.theta / DEG, INVERSES[0].answer(targets, "torque"), EXACT.answer(targets, "torque")
    found = effect(targets, raw)
    kinds = {
        "inverse, within all limits": (found.within, "-", BLUE),
        "inverse, a cable is slack": (~found.taut, ":", COLOURS[0]),
        "inverse, beyond the supply": (found.taut & ~found.within, "--", COLOURS[1]),
    }
    for axes, sign, name in zip(panels, (-1, 1), ("P1 − P2 [bar]", "P1 + P2 [bar]"), strict=True):
        lines = [combined(answer, sign).reshape(shape) for answer in (exact, raw)]
        for row, K in enumerate((6, 7, 8, 9)):
            axes.plot(theta[:251], lines[0][row], color=GREY, lw=3, alpha=0.35, label=once("exact (torque first)", row))
            for label, (where, dashes, colour) in kinds.items():
                part = np.where(where.reshape(shape)[row], lines[1][row], np.nan)
                axes.plot(theta[:251], part, dashes, color=colour, label=once(label, row))
            axes.annotate(f"K = {K}", (theta[250], lines[1][row, -1]), xytext=(3, -3), textcoords="offset points")
        axes.set(xlabel="θ [°]", ylabel=name, xlim=(-125, 160), xticks=range(-120, 121, 60))
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def combined(answer: Answer, sign: int) -> Array:
    return np.asarray((answer.P1 + sign * answer.P2) / BAR)


def once(label: str, row: int) -> str:
    return "_" if row else label  # matplotlib leaves "_" out of the legend


def time(results: Results) -> Any:
    """Time per target, and iterations with and without the warm start; medians and means over the sets."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(7.5, 3.4), layout="constrained")
    names = [c.name for c in CONTENDERS if c not in INVERSES[1:]]
    for i, (field, label) in enumerate((("batch_us", "in a batch"), ("single_us", "single call"))):
        us = [np.median([getattr(t, field) for t in results.times if t.contender == name]) for name in names]
        left.barh(np.arange(len(names)) + 0.4 * i - 0.2, us, 0.4, label=label, color=(BLUE, GREY)[i])
    left.set_yticks(range(len(names)), names)
    left.set(xscale="log", xlabel="time per target [µs]")
    bars(right, results)
    for axes in (left, right):
        axes.invert_yaxis()
        axes.legend(fontsize=8)
    return figure


def bars(axes: Any, results: Results) -> None:
    """Mean iterations of every back-end on feasible and on mixed targets."""
    gains = sorted(results.gains, key=lambda g: (g.set, BACKED.index(g.back_end)))
    groups = [list(group) for _, group in groupby(gains, key=lambda g: (g.set, g.back_end))]
    for i, (field, label) in enumerate((("iterations_warm", "warm start"), ("iterations_cold", "without"))):
        means = [np.mean([getattr(g, field) for g in group]) for group in groups]
        axes.barh(np.arange(len(groups)) + 0.4 * i - 0.2, means, 0.4, label=label, color=(BLUE, GREY)[i])
    labels = [f"{group[0].back_end}, {'mixed' if group[0].set == 'random' else 'feasible'}" for group in groups]
    axes.set_yticks(range(len(groups)), labels)
    axes.set(xlabel="iterations per target")
