"""Commands about motion: `antagonist track`. Degrees and bar here, SI behind; heavy libraries load when it runs."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allocator.cli import JOINT, MUSCLE, REPORT_MUSCLE, app, chosen_joint, run
from allocator.errors import InvalidInput, MissingBackend
from mpc.export.cli import export_command

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from allocator.joint import AntagonistJoint
    from mpc.loops import Settings
    from mpc.metrics import Metrics
    from mpc.simulation import Process

_NOMINAL, _REAL = "nominal", "real"  # plants


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
    joint: Annotated[Path | None, JOINT] = None,
    plant: Annotated[
        str, typer.Option(help="nominal, or real: with what the controller's model does not know")
    ] = _NOMINAL,
    controller: Annotated[str, typer.Option(help="mpc, pid, lqr or feedforward")] = "mpc",
    observer: Annotated[
        bool | None, typer.Option(help="estimate state and disturbance torque; mpc and lqr do so on a real plant")
    ] = None,
    payload: Annotated[float, typer.Option(help="load that nobody tells of, from half-way on [N·m]")] = 0.0,
    seed: Annotated[int, typer.Option(help="of the sensors' noise")] = 0,
) -> None:
    """Let a controller follow a trajectory of angle and stiffness, and say how well it did."""
    from rich.console import Console

    from mpc.files import default_trajectory, load, save_run
    from mpc.loops import loop
    from mpc.metrics import metrics
    from mpc.plant import Plant
    from mpc.plotting import save_tracking_figure
    from mpc.simulation import simulate

    console = Console()
    reference = default_trajectory() if trajectory is None else load(trajectory)
    half_way = float(reference.t[-1] - reference.t[0]) / 2
    tested, settings = _tested(plant, chosen_joint(muscle, joint), ((half_way, payload),) if payload else ())
    settings = settings._replace(dt=dt, N=horizon, solver=solver)
    if observer is None and isinstance(tested, Plant):
        observer = False  # the whole state is measured, and nothing disturbs
    driver, eyes = loop(controller, settings, observer)
    picture, table = out / "tracking.png", out / "tracking.csv"
    with _writing(out):
        out.mkdir(parents=True, exist_ok=True)
    done = simulate(tested, driver, reference, observer=eyes, seed=seed, progress=True)

    _say(console, f"drawing {picture} (the first picture after an installation takes some seconds)")
    with _writing(out):
        save_run(done, table)
        save_tracking_figure(done, picture)
    figures = metrics(done)
    console.print(_summary(figures))
    if figures.out_of_reach:
        _say(console, f"{figures.out_of_reach:.3g} % of the reference is out of this joint's reach")
    _say(console, f"written: {picture}, {table}")


def _tested(
    plant: str, joint: "AntagonistJoint", torque: "tuple[tuple[float, float], ...]"
) -> "tuple[Process, Settings]":
    """The plant called `plant` under an unknown torque, and what its controller knows."""
    from mpc.loops import Settings
    from mpc.plant import Plant
    from mpc.reality import RealPlant
    from mpc.weights import Weights

    if plant == _REAL:
        real = RealPlant.standard(torque_profile=torque, nominal=Plant(joint, lag=0.12))
        return real, Settings(real.nominal, compensation=real.known(), weights=Weights.calm())
    if plant != _NOMINAL:
        raise MissingBackend("plant", plant, [_NOMINAL, _REAL])
    nominal = Plant(joint)
    return (RealPlant(nominal, torque_profile=torque) if torque else nominal), Settings(nominal)


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


app.command("export")(export_command)


def main() -> None:
    """Entry point of the command `antagonist`."""
    run(app)


__all__ = ["app", "main", "track"]
