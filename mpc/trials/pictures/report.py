"""Reports of a run: a table of its errors, files in the format of their suffix, and a picture of margins."""

from collections.abc import Callable, Iterator, Sequence
from os import PathLike
from pathlib import Path

import numpy as np

from allocator.lazy import Figure, Table
from allocator.mechanism.endpoint import Endpoint
from allocator.presentation.plotting import GREY, name_axes, new_figure, save_figure
from allocator.units import BAR
from mpc.model.plant import Plant
from mpc.trials.files import save_mcap, save_recording, save_run
from mpc.trials.margins import ROBUST, Margins
from mpc.trials.metrics import Errors, Metrics
from mpc.trials.pictures.animation import ENDINGS
from mpc.trials.pictures.plotting import COLOURS, NOTHING, save_tracking_figure
from mpc.trials.simulation import Run

_LOWEST = 0.2  # [Hz]
_PLANE = 2.5  # of the plane around -1
_CIRCLE = np.exp(1j * np.linspace(0, 2 * np.pi, 361))
_STEPS = {"REST": "steps at rest, commands held"}
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
            table.add_row(_STEPS.get(rung, f"steps answered by {rung}"), "", str(steps))
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
        if not np.abs(run.K[:, i, j]).max() <= NOTHING:
            yield f"stiffness error, {name} [{plant.stiffness_unit}]", of.K_rms[i, j], of.K_worst[i, j]
