"""`antagonist export` writes allocator and controller as C. Heavy libraries load when it runs."""

from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allocator.errors import InvalidInput
from allocator.shell.options import grouped
from allocator.shell.outputs import claim
from allocator.shell.printing import say
from mpc.export.serial.cli import BoardOptions
from mpc.plant_cli import PlantOptions

if TYPE_CHECKING:
    from mpc.model.compensation import Compensation
    from mpc.model.plant import Plant
    from mpc.tracking.controller import TrackingMPC


@grouped
def export_command(
    out: Annotated[Path, typer.Option(help="new or empty directory for the C files; the file of --tuning")],
    options: PlantOptions,
    board: BoardOptions,
    what: Annotated[str, typer.Option(help="allocate, mpc or all")] = "all",
    precision: Annotated[str, typer.Option(help="double, or single for an FPU without double")] = "double",
    horizon: Annotated[int, typer.Option(help="samples of 10 ms that the controller looks ahead")] = 10,
    errors: Annotated[
        str | None,
        typer.Option(
            help="the controller's weights by errors that cost one half, e.g. theta=0.1,rate=0.3: theta [°], omega "
            "[°/s], K [N·m/rad], u [bar], rate [bar/s]"
        ),
    ] = None,
    tuning: Annotated[
        bool,
        typer.Option("--tuning", help="write numbers to --out that retune a controller in C without a compiler"),
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="replace the file of --tuning")] = False,
    fmu: Annotated[
        bool,
        typer.Option("--fmu", help="write plant.fmu and controller.fmu (FMI 3.0 co-simulation) into --out instead"),
    ] = False,
    mechanism: Annotated[
        str | None, typer.Option(help="arm26, arm48, leg37 or a TOML file: its allocation, with --muscle if given")
    ] = None,
    governor: Annotated[
        str | None, typer.Option(help="arm26, arm48 or leg37: the governor of its pressures, every 10 ms")
    ] = None,
) -> None:
    """Write allocator and controller as plain C99, for a microcontroller or a real-time PC; or as FMUs."""
    from rich.console import Console

    from mpc.export.entry import default_controller, export
    from mpc.export.tuning import weights_from, write_tuning

    if fmu and (board.serial or precision != "double" or what != "all"):
        raise InvalidInput("--fmu: an FMU has all in double precision; leave --target, --what and --precision away")
    allocates = what == "allocate" or (board.serial and board.variant == "terminal")
    if (errors is not None or tuning) and (allocates or mechanism is not None or governor is not None):
        raise InvalidInput("--errors, --tuning: they are the controller's, and here there is none")
    if tuning and (fmu or board.serial or what != "all"):
        raise InvalidInput("--tuning: it writes one file of numbers; leave --what, --fmu and --target away")
    if force and not tuning:
        raise InvalidInput("--force: it replaces the file of --tuning; directories have to be new or empty")
    if governor is not None:
        if fmu or board.serial or what != "all" or mechanism is not None:
            raise InvalidInput("--governor: it comes alone; leave --mechanism, --what, --fmu and --target away")
        _governor(out, governor, precision)
        return
    if mechanism is not None:
        if fmu or board.serial or what == "mpc":
            raise InvalidInput(
                "--mechanism: of a mechanism there is the allocation as C only; leave --what, --fmu away"
            )
        _mechanism(out, mechanism, options, precision)
        return
    if tuning:
        claim(out, inputs=options.files, force=force)
    plant = options.plant()
    known = options.compensation()
    weights = None if errors is None else weights_from(errors)
    controller = None if allocates else default_controller(plant, horizon, known, weights)
    if tuning and controller is not None:
        write_tuning(out, controller, precision=precision)
        say(Console(), f"written: {out}, for a build of the same plant in {precision} precision; its README says how")
        return
    if fmu:
        made, read = _fmus(out, plant, known, controller), "any tool that reads FMI 3.0 takes them"
    elif board.serial:
        made = board.export(out, plant, known, controller, precision)
        read = f"{made / 'serial' / 'README.md'} says what to do"
    else:
        made = export(out, joint=plant.joint, controller=controller, what=what, precision=precision)
        read = f"{made / 'README.md'} says how to build them"
    console = Console()
    if controller is not None:
        say(console, f"plant: {plant.summary}")
        if known.summary:
            say(console, f"told to the controller: {known.summary}")
        if known.untold:
            say(console, f"not told to the controller, whose C has no such numbers: {known.untold}")
    say(console, f"written: {sum(path.is_file() for path in made.rglob('*'))} files in {made}; {read}")


def _fmus(out: Path, plant: "Plant", known: "Compensation", controller: "TrackingMPC | None") -> Path:
    from mpc.export.directory import check
    from mpc.export.fmu.entry import export_controller_fmu, export_plant_fmu
    from mpc.model.real_plant import RealPlant

    check(out)
    export_plant_fmu(out / "plant.fmu", RealPlant.of(plant, known))
    export_controller_fmu(out / "controller.fmu", controller)
    return out


def _mechanism(out: Path, name: str, options: PlantOptions, precision: str) -> None:
    """Write the allocation of the mechanism called `name`, with --muscle if given. Raises `AntagonistError`."""
    from rich.console import Console

    from allocator.mechanism import machines
    from allocator.muscles.catalogue import named_muscle
    from mpc.export.mechanism.entry import export_mechanism

    given = [field.name for field in fields(options) if getattr(options, field.name) is not None]
    others = [name for name in given if name != "muscle"]
    if others or len(options.muscle or ()) > 1:
        raise InvalidInput(
            f"--mechanism: of the joint's options there is one --muscle, for all its muscles; leave "
            f"--{others[0].replace('_', '-') if others else 'muscle'} away, and write what differs into its TOML file"
        )
    mechanism = machines.machine(name)
    if options.muscle:
        mechanism = mechanism.with_muscles(named_muscle(options.muscle[0]))
    made = export_mechanism(out, mechanism, precision=precision)
    files = sum(path.is_file() for path in made.rglob("*"))
    say(Console(), f"written: {files} files in {made}; {made / 'README.md'} says how to build them")


def _governor(out: Path, name: str, precision: str) -> None:
    """Write the governor of the machine called `name`. Raises `InvalidInput` and `MissingBackend`."""
    from rich.console import Console

    from mpc.export.governor.entry import export_governor
    from mpc.governor import PressureGovernor
    from mpc.model.arm.model import Arm

    made = export_governor(out, PressureGovernor.of_arm(Arm.machine(name), 0.01), precision=precision)
    files = sum(path.is_file() for path in made.rglob("*"))
    say(Console(), f"written: {files} files in {made}; {made / 'README.md'} says how to build them")
