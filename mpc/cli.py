"""Commands about motion: `antagonist track`. Degrees and bar here, SI behind; heavy libraries load when it runs."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allocator.cli import MUSCLE, REPORT_MUSCLE, app, run
from allocator.errors import InvalidInput

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from mpc.metrics import Metrics


@app.command()
def track(
    trajectory: Annotated[
        Path | None, typer.Argument(help="CSV with the columns t,theta_deg,stiffness; without it ±40° at 0.5 Hz")
    ] = None,
    out: Annotated[Path, typer.Option(help="directory for tracking.png and tracking.csv")] = Path(),
    dt: Annotated[float, typer.Option(help="sample time of the controller [s]")] = 0.01,
    horizon: Annotated[int, typer.Option(help="samples that the controller looks ahead")] = 20,
    solver: Annotated[str, typer.Option(help="QP solver: daqp, or one that qpsolvers finds, e.g. osqp")] = "daqp",
    muscle: Annotated[str, MUSCLE] = REPORT_MUSCLE,
) -> None:
    """Let the MPC follow a trajectory of angle and stiffness, and say how well it did."""
    from rich.console import Console

    from allocator.joint import report_joint
    from allocator.muscles.catalogue import named_muscle
    from mpc.controller import TrackingMPC
    from mpc.files import default_trajectory, load, save_run
    from mpc.metrics import metrics
    from mpc.plant import Plant
    from mpc.plotting import save_tracking_figure
    from mpc.simulation import simulate

    console = Console()
    reference = default_trajectory() if trajectory is None else load(trajectory)
    plant = Plant(report_joint(named_muscle(muscle)))
    controller = TrackingMPC(plant, dt=dt, N=horizon, solver=solver)
    picture, table = out / "tracking.png", out / "tracking.csv"
    with _writing(out):
        out.mkdir(parents=True, exist_ok=True)
    done = simulate(plant, controller, reference, progress=True)

    _say(console, f"drawing {picture} (the first picture after an installation takes some seconds)")
    with _writing(out):
        save_run(done, table)
        save_tracking_figure(done, picture)
    figures = metrics(done)
    console.print(_summary(figures))
    if figures.out_of_reach:
        _say(console, f"{figures.out_of_reach:.3g} % of the reference is out of this joint's reach")
    _say(console, f"written: {picture}, {table}")


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InvalidInput(f"{path} cannot be written ({error.strerror})") from None


def _say(console: "Console", sentence: str) -> None:
    console.print(sentence, highlight=False, markup=False, soft_wrap=True)


def _summary(m: "Metrics") -> "Table":
    from rich.table import Table
    from rich.text import Text

    table = Table("", "RMS, median", "worst, 99 %", title="tracking")
    table.add_row("angle error [°]", f"{m.theta_rms:.3g}", f"{m.theta_worst:.3g}")
    table.add_row("stiffness error [%]", f"{m.K_rms:.3g}", f"{m.K_worst:.3g}")
    table.add_section()
    for limit, (excess, unit) in m.violations.items():
        table.add_row(limit, "", f"exceeded by {excess:.3g} {unit}" if excess else "kept")
    table.add_section()
    table.add_row(Text("time of a step [ms]"), f"{m.step_median:.3g}", f"{m.step_p99:.3g}")
    for rung, steps in m.rungs.items():
        table.add_row(f"steps answered by {rung}", "", str(steps))
    return table


def main() -> None:
    """Entry point of the command `antagonist`."""
    run(app)


__all__ = ["app", "main", "track"]
