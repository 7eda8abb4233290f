"""Command `antagonist export`: C code, FMUs and firmware."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, NamedTuple

import typer

from allocator.errors import InvalidInput
from allocator.shell.machine_options import MachineOptions
from allocator.shell.options import Command, grouped
from allocator.shell.outputs import Force, claim, say
from allocator.units import DEG
from mpc.export.serial.cli import BoardOptions
from mpc.plant_cli import PlantOptions

if TYPE_CHECKING:
    from mpc.model.real_experiment import RealMachine
    from mpc.observer.kalman import KalmanObserver
    from mpc.tracking.controller import TrackingMPC

export_app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

Out = Annotated[Path, typer.Option(help="new or empty directory for the files")]
Precision = Annotated[str, typer.Option(help="double, or single for processors without a double-precision FPU")]


@dataclass(frozen=True)
class ControllerOptions(PlantOptions):
    """Options of a controller and its plant."""

    PANEL: ClassVar[str] = "Controller"

    horizon: Annotated[int, typer.Option(help="horizon of the controller, in samples of 10 ms")] = 10
    errors: Annotated[
        str | None,
        typer.Option(
            help="controller weights, as the errors that each cost one half; e.g. theta=0.1,rate=0.3: theta [°], "
            "omega [°/s], K [N·m/rad], u [bar], rate [bar/s]"
        ),
    ] = None

    def process(self) -> "RealMachine":
        """Build the simulated machine, with the friction and the regulators of the file."""
        from mpc.model.real import real_of

        if self.of_several:
            return real_of(self.arm(), self.compensation_of_arm())
        return real_of(self.plant(), self.compensation())

    def built(self) -> "Built":
        """Build controller and observer of a joint or an arm, with the compensation and the tuning of the file.

        Those of an arm are those of `antagonist track --plant real`, but for the shorter horizon.
        """
        from mpc.export.controller.tuning import weights_from
        from mpc.export.entry import check_arm
        from mpc.export.joint import kernel_of
        from mpc.observer.filter import CALM_NOISE
        from mpc.observer.kalman import KalmanObserver
        from mpc.tracking.controller import TrackingMPC
        from mpc.tracking.cost import CALM
        from mpc.trials.loops import Settings
        from mpc.trials.robust import robust_weights

        if several := self.of_several:
            s = Settings(self.arm(), compensation=self.compensation_of_arm(), weights=CALM, noise=CALM_NOISE)
            check_arm(s.plant)
        else:
            s = Settings(self.plant(), compensation=self.compensation())
            kernel_of(s.plant.joint)  # refuses other joints before any work
        s, tuned = self.tuned(s._replace(N=self.horizon), "mpc")
        weights = s.weights
        if self.errors is not None:
            weights = weights_from(self.errors)
        elif not (tuned or several):
            weights = robust_weights(s.plant, N=s.N, compensation=s.compensation, noise=s.noise, compiled=False)
        controller = TrackingMPC(s.plant, s.dt, s.N, weights, compensation=s.compensation, compiled=False)
        observer = KalmanObserver(s.plant, s.dt, s.noise, s.compensation, compiled=False)
        return Built(controller, observer, tuned, self.encoder_zero)


class Built(NamedTuple):
    """A controller with its observer, a sentence about a tuning, or "", and the encoder's zero [rad]."""

    controller: "TrackingMPC"
    observer: "KalmanObserver"
    tuned: str
    zero: float = 0.0


@export_app.callback()
def _group() -> None:
    """Write C99 for a microcontroller or a real-time PC, or FMUs.

    `allocation` takes any --machine, `governor` an arm, and all others one joint with two muscles or an arm.
    """


@export_app.command("controller", cls=Command, short_help="controller, observer and allocation as C")
@grouped
def controller_command(
    out: Out,
    options: ControllerOptions,
    precision: Precision = "double",
    alone: Annotated[
        bool, typer.Option("--alone", help="leave the demonstration of the allocation out of main.c")
    ] = False,
) -> None:
    """Write controller, observer and allocation of a joint or an arm as plain C99, without a heap."""
    from mpc.export.entry import export

    built = options.built()
    what = "mpc" if alone else "all"
    made = export(out, controller=built.controller, observer=built.observer, what=what, precision=precision)
    _say(built, made, f"{made / 'README.md'} describes how to build them")


@export_app.command("allocation", cls=Command, short_help="the allocation of any machine as C")
@grouped
def allocation_command(out: Out, options: MachineOptions, precision: Precision = "double") -> None:
    """Write the allocation of one or several joints as plain C99: pressures for torques and stiffnesses."""
    from allocator.joint.antagonist import AntagonistJoint
    from mpc.export.entry import export
    from mpc.export.mechanism import export_mechanism

    machine = options.build()
    if isinstance(machine, AntagonistJoint):
        made = export(out, joint=machine, what="allocate", precision=precision)
    else:
        made = export_mechanism(out, machine, precision=precision)
    _say(None, made, f"{made / 'README.md'} describes how to build them")


@export_app.command("governor", cls=Command, short_help="the pressure governor of an arm as C")
@grouped
def governor_command(out: Out, options: PlantOptions, precision: Precision = "double") -> None:
    """Write the pressure governor of an arm as plain C99, with 10 ms samples: --machine arm26 or a file."""
    from mpc.export.governor import export_governor
    from mpc.governor import PressureGovernor

    made = export_governor(out, PressureGovernor.of_arm(options.arm(), 0.01), precision=precision)
    _say(None, made, f"{made / 'README.md'} describes how to build them")


@export_app.command("fmu", cls=Command, short_help="plant and controller as FMUs")
@grouped
def fmu_command(
    out: Out,
    options: ControllerOptions,
    platforms: Annotated[
        str | None,
        typer.Option(
            help="platforms of the binaries, all or names such as x86_64-linux,x86_64-windows; by default this "
            "machine's. Others need the package ziglang"
        ),
    ] = None,
    source_only: Annotated[
        bool, typer.Option("--source-only", help="write no binaries; the importing tool compiles the sources")
    ] = False,
) -> None:
    """Write plant.fmu and controller.fmu (FMI 3.0 co-simulation), for Simulink and other tools."""
    from mpc.export.building import check
    from mpc.export.fmu import PLATFORMS, checked, export_controller_fmu, export_plant_fmu

    if source_only and platforms is not None:
        raise InvalidInput("--source-only and --platforms: give one of the two")
    named = None if platforms is None else PLATFORMS if platforms == "all" else platforms.split(",")
    on = () if source_only else checked(named)
    built = options.built()
    check(out)
    export_plant_fmu(out / "plant.fmu", options.process(), platforms=on)
    export_controller_fmu(out / "controller.fmu", built.controller, built.observer, platforms=on)
    _say(built, out, f"tools that read FMI 3.0 import them; binaries: {', '.join(on) or 'none'}")


@export_app.command("firmware", cls=Command, short_help="firmware of a board on a serial line")
@grouped
def firmware_command(
    out: Out,
    options: ControllerOptions,
    board: BoardOptions,
    precision: Precision = "double",
) -> None:
    """Write the firmware of a board on a serial line as plain C99, and a simulated board."""
    terminal = board.variant == "terminal"
    if terminal and options.errors is not None:
        raise InvalidInput("--errors belongs to a controller; a terminal has none")
    built = None if terminal else options.built()
    controller, observer = (None, None) if built is None else (built.controller, built.observer)
    made = board.export(out, options.process(), controller, observer, precision)
    _say(built, made, f"{made / 'serial' / 'README.md'} describes the next steps")


@export_app.command("tuning", cls=Command, short_help="a file that retunes an exported controller")
@grouped
def tuning_command(
    out: Annotated[Path, typer.Option(help="file to write")],
    options: ControllerOptions,
    force: Force = False,
) -> None:
    """Write a file that retunes an exported controller without a compiler."""
    from rich.console import Console

    from mpc.export.controller.tuning import write_tuning

    claim(out, inputs=options.files, force=force)
    write_tuning(out, options.built().controller)
    say(Console(), f"written: {out}, for a build of the same plant; its README describes its use")


def _margins(built: "Built") -> list[str]:
    """Return sentences on the margins of the loop that is exported, at the middle posture."""
    from mpc.observer.kalman import KalmanObserver
    from mpc.trials.margins import UNHELD, linear, linear_model, margins, middle_posture

    controller = built.controller
    told, model = linear(controller.compensation), linear_model(controller.plant)
    sliding = replace(controller, plant=model, compensation=told)
    observer = KalmanObserver(model, controller.dt, built.observer.noise, told, compiled=False)
    posture = middle_posture(controller.plant)
    return [UNHELD] if posture is None else margins(sliding, observer, [posture])[0].sentences


def _say(built: "Built | None", made: Path, read: str) -> None:
    """Print the plant, the effects known to the controller, its margins and the number of files."""
    from rich.console import Console

    console = Console()
    if built is not None:
        known, plant = built.controller.compensation, built.controller.plant
        say(
            console,
            f"plant: {plant.summary}",
            built.tuned,
            known.summary and f"known to the controller: {known.summary}",
        )
        if untold := known.untold(plant):
            say(console, f"not known to the controller, since its C has no such numbers: {untold}")
        if built.zero:
            say(console, f"the encoder reads {built.zero / DEG:.4g}° at 0 of the joint: subtract it before every step")
        say(console, *_margins(built))
    count = sum(path.is_file() for path in made.rglob("*"))
    say(console, f"written: {count} file{'s' * (count != 1)} in {made}; {read}")
