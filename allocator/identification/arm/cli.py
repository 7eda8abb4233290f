"""Command `antagonist fit-arm`: which muscles pull which joint, and how well the motion is predicted."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from allocator.identification.arm.episodes import Windows, read_arm_log
from allocator.identification.arm.fit import ArmFit, fit_arm
from allocator.identification.least_squares import rms
from allocator.identification.options import LogOptions, clock, columns_option
from allocator.shell.options import grouped, within
from allocator.shell.outputs import AsJSON, print_json, say
from allocator.units import DEG


@dataclass(frozen=True)
class ArmLogOptions(LogOptions):
    """Options of an arm's log."""

    columns: Annotated[str | None, columns_option("theta1=elbow:deg,pressure1=biceps:bar")] = None


@grouped
def fit_arm_command(
    log: Annotated[
        list[Path], typer.Argument(help="CSV files or bags; with time [s], q1 [deg] …, p1 [bar], p2 …, see above")
    ],
    source: ArmLogOptions,
    terms: Annotated[
        bool,
        typer.Option(help="choose further terms of each joint's law by left-out episodes; takes minutes per joint"),
    ] = True,
    horizon: Annotated[int, typer.Option(help="rows of the free runs whose error is minimised")] = 40,
    as_json: AsJSON = False,
) -> None:
    """Find which muscles pull which joint of an arm, and fit the motion of every joint, from the arm's own log.

    Columns are found by name and unit: time [s], the angles q1, q2 … [deg] or [rad], two measured pressures a joint
    p1, p2 … in any one unit and order, and speeds v1, v2 … [rad/s] if they were measured. Files, and stretches between
    gaps, are episodes. Rows with spikes, drop-outs and missing readings are left out and listed.

    The errors are those of free runs of left-out episodes, in which only the pressures are known. `fit_arm` in Python
    returns the model, whose `predict` gives angles and their bands.
    """
    within("--horizon", horizon, "rows", 2, 10_000)
    console = Console(stderr=as_json)
    data = source.read(read_arm_log, log)
    say(console, *data.notes)
    chosen = None if terms else dict.fromkeys(range(data.episodes[0].q.shape[1]), ())
    with clock(console) as bar:
        task = bar.add_task("fitting", total=None)
        fit = fit_arm(
            data.episodes, horizon=horizon, terms=chosen, progress=lambda step: bar.update(task, description=step)
        )
    joints = _joints(fit, Windows.cut(data.episodes, horizon, 10))
    if as_json:
        print_json({"episodes": len(data.episodes), "margin": fit.assignment.margin, "joints": joints})
        return
    rows = sum(len(e.q) for e in data.episodes)
    say(console, f"{len(data.episodes)} episodes, {rows} rows, {1e3 * data.episodes[0].step:.3g} ms apart")
    table = Table(*_HEAD, title=f"free runs of {horizon} rows, of left-out episodes")
    for j, joint in enumerate(joints):
        pulls = [f"p{joint[side]} ({joint[f'{side}_t']:.1f})" for side in ("raised_by", "lowered_by")]
        errors = [f"{joint[name]:.2f}" for name in ("error_deg", "hold_deg", "band_deg")]
        table.add_row(f"{j + 1}", *pulls, *errors, ", ".join(fit.laws[j].terms) or "none")
    console.print(table)
    if doubtful := [f"p{i + 1}" for i in fit.assignment.doubtful]:
        say(console, f"beware: the log hardly shows what {', '.join(doubtful)} pull: move these joints more")


_HEAD = "joint", "raised by (t)", "lowered by (t)", "RMS [°]", "if at rest [°]", "95 % band at the end [°]", "terms"


def _joints(fit: ArmFit, windows: Windows) -> list[dict[str, object]]:
    """Return the muscles and errors of each joint."""
    error, start = fit.left_out - windows.future, windows.q[:, 1]
    moved, half = windows.future - start[:, None], fit.bands.around(fit.left_out, start)[:, -1]
    rows = []
    for j, (up, down) in enumerate(fit.assignment.pairs):
        t = fit.assignment.t_statistics[j]
        rows.append(
            {
                "raised_by": up + 1,
                "lowered_by": down + 1,
                "raised_by_t": float(t[up]),
                "lowered_by_t": float(-t[down]),
                "error_deg": rms(error[..., j]) / DEG,
                "hold_deg": rms(moved[..., j]) / DEG,
                "band_deg": float(half[:, j].mean()) / DEG,
                "terms": list(fit.laws[j].terms),
            }
        )
    return rows
