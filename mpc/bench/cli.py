"""Commands about hardware are here: `antagonist devices`, `run` and `sweep`; degrees and bar here, SI behind."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, Self

import typer

from allocator.errors import InvalidInput
from allocator.shell.options import finite, grouped, numbers, within
from allocator.shell.outputs import IMAGES, Force, claim
from allocator.shell.printing import say
from allocator.units import BAR
from mpc.plant_cli import PlantOptions

if TYPE_CHECKING:
    from rich.console import Console

    from mpc.bench.clock import Clock
    from mpc.bench.cycle import Settings
    from mpc.bench.device import Device
    from mpc.bench.logs import Record
    from mpc.bench.record import Row
    from mpc.bench.safety import Ending
    from mpc.model.compensation import Compensation
    from mpc.model.plant import Plant
    from mpc.observer.kalman import Observer
    from mpc.trials.simulation import Controller

_EXITS = {"finished": 0, "interrupted": 130, "terminated": 143}
_STOPPED = 4  # exit code of a loop that ended for safety
_SIM = "sim"
_SUFFIXES = (*IMAGES, ".csv", ".npz")


@dataclass(frozen=True)
class BenchOptions:
    """The options are those of every command that moves a joint."""

    device: Annotated[
        str, typer.Option(help="NAME or NAME:ADDRESS, such as sim, serial:/dev/ttyUSB0, modbus:192.168.0.5:502")
    ]
    present: Annotated[
        str | None, typer.Option(help="pressures at the start [bar], P1:P2, where the device measures none; 0:0 vented")
    ] = None
    start_rate: Annotated[float, typer.Option(help="of the soft start [bar/s]")] = 1.0
    stop: Annotated[str, typer.Option(help="what then happens to the pressures, however it ends: ramp, hold, vent")] = (
        "ramp"
    )
    stop_rate: Annotated[float, typer.Option(help="of the ramp down [bar/s]")] = 1.0
    overrun: Annotated[
        str, typer.Option(help="what follows samples that took too long: skip (the reference goes on), catch-up, stop")
    ] = "skip"
    fast: Annotated[bool, typer.Option("--fast", help="with sim: as fast as the computer can, not in real time")] = (
        False
    )
    quiet: Annotated[bool, typer.Option("--quiet", help="show nothing while it runs")] = False

    def opened(self, options: PlantOptions) -> "Opened":
        """Return the device, the clock of its loop, and what the options tell of the joint.

        A `sim` without a file simulates the joint of the options, with what a bench does besides; its controller is
        told what a fit would find.
        """
        from mpc.bench.clock import MonotonicClock, SimulatedClock
        from mpc.bench.devices.registry import open_device
        from mpc.bench.devices.simulated import SimulatedDevice, open_simulated, simulated
        from mpc.model.real_plant import RealPlant

        name, _, address = self.device.partition(":")
        clock = SimulatedClock() if self.fast else MonotonicClock()
        plant, known = options.plant(), options.compensation()
        if name == _SIM and not address:
            plant = RealPlant.standard().nominal if options == PlantOptions() else plant
            real = simulated(plant, known)
            return Opened(SimulatedDevice(real, clock), clock, plant, real.known(share=1.0))
        if name == _SIM:
            return Opened(open_simulated(address, clock), clock, plant, known)
        if self.fast:
            raise InvalidInput(f"--fast is for --device {_SIM}: {name} is as fast as it is")
        return Opened(open_device(self.device), clock, plant, known)

    def settings(self, settle: float = 0.0) -> "Settings":
        """Return how a loop starts, what ends it and what then happens."""
        from mpc.bench.cycle import Overrun, Settings
        from mpc.bench.safety import Action, SafeStop, SoftStart

        within("--start-rate", self.start_rate, "bar/s", 1e-3, 100)
        within("--stop-rate", self.stop_rate, "bar/s", 1e-3, 100)
        _chosen("--stop", self.stop, list(Action))
        policies = {policy.name.lower().replace("_", "-"): policy for policy in Overrun}
        _chosen("--overrun", self.overrun, policies)
        present = None
        if self.present is not None:
            one, two = numbers("--present", self.present, 2, 2, "0:0")
            present = one * BAR, two * BAR
        start = SoftStart(self.start_rate * BAR, settle=settle, present=present)
        return Settings(policies[self.overrun], start, stop=SafeStop(Action(self.stop), self.stop_rate * BAR))


class Opened(NamedTuple):
    """What is opened is a device with its clock, and what is known of the joint behind it."""

    device: "Device"
    clock: "Clock"
    plant: "Plant"
    known: "Compensation"


def _chosen(option: str, value: str, among: Iterable[str]) -> None:
    if value not in (names := list(among)):
        raise InvalidInput(f"{option} {value}: choose one of {', '.join(names)}")


def devices_command() -> None:
    """List the kinds of devices that --device takes, those of installed packages included."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from mpc.bench.devices.registry import kinds

    table = Table("name", "what it does", "from")
    for name, kind in sorted(kinds().items()):
        table.add_row(name, Text(kind.summary), kind.brought_by)
    Console().print(table)


@grouped
def run_command(
    options: PlantOptions,
    bench: BenchOptions,
    trajectory: Annotated[
        str | None, typer.Argument(help="a standard trajectory (`antagonist track --help`), or a CSV, as of `track`")
    ] = None,
    out: Annotated[
        list[Path] | None,
        typer.Option(help="a .csv (written sample by sample), .npz or .png to write; may be repeated"),
    ] = None,
    stiffness: Annotated[
        float | None, typer.Option(help="K about which a standard trajectory runs [N·m/rad]; else the joint's middle")
    ] = None,
    dt: Annotated[float, typer.Option(help="sample time [s]")] = 0.01,
    horizon: Annotated[int, typer.Option(help="samples that mpc looks ahead")] = 20,
    controller: Annotated[str, typer.Option(help="mpc, pid, predictive-pid, lqr, feedforward")] = "mpc",
    settle: Annotated[float, typer.Option(help="under control at the first point of the trajectory [s]")] = 1.0,
    force: Force = False,
) -> None:
    """Let a controller drive a joint on a device along a trajectory of angle and stiffness.

    It begins with a soft start from the pressures of now, and ends with the pressures as --stop says, whatever ends it:
    the end of the trajectory, Ctrl-C (twice: vent at once), SIGTERM, a device or a log that fails. Exit code 0 at the
    end, 130 and 143 after Ctrl-C and SIGTERM, 4 where the loop ended itself. With .npz or .png alone the samples go
    into a .csv beside it, which is removed when all is well.
    """
    from rich.console import Console

    from mpc.bench.loop import RealTimeLoop
    from mpc.trials.choice import reference_called

    console = Console()
    finite("--settle", settle, "s")
    files = _files(out or [])
    journal = _journal(files)
    claim(*files, None if journal in files else journal, inputs=(trajectory, *options.files), force=force)
    settings = bench.settings(settle)
    opened = bench.opened(options)
    plant, known = opened.plant, opened.known
    reference = reference_called(trajectory, stiffness, plant)
    say(console, f"plant: {plant.summary}" + f"; {known.summary}" * bool(known.summary))
    say(console, f"trajectory: {reference.summary}")
    with Console(stderr=True).status("building the controller (compiled once after an installation: some 20 seconds)"):
        driver, observer = _loop(controller, opened, dt, horizon)
        watch = _Watch(plant.joint.pressure_limits[1], dt, bench.quiet)
        loop = RealTimeLoop(
            opened.device, driver, observer, reference, plant=plant, start=settings.start, stop=settings.stop,
            watchdog=settings.watchdog, overrun=settings.overrun, log=journal, clock=opened.clock,
            watch=watch,
        )  # fmt: skip
    watch.health = lambda: loop.tracking.health
    with watch:
        record = loop.run()
    _report(record, console)
    if record.controlled:
        _write(record, files, journal, console)
    raise typer.Exit(_code(record.ending))


def _loop(name: str, opened: Opened, dt: float, horizon: int) -> "tuple[Controller, Observer]":
    """Return the controller of this name and its observer."""
    from mpc.tracking.weights import Weights
    from mpc.trials.loops import Settings, loop

    told = Settings(opened.plant, dt, horizon, opened.known, Weights.calm())
    return loop(name, told, True if name in ("mpc", "predictive-pid", "lqr") else None)


class _Watch:
    """The watch of a loop shows its samples on a dashboard, unless it is to be quiet."""

    def __init__(self, highest: float, dt: float, quiet: bool) -> None:
        from mpc.bench.dashboard import Dashboard

        self.health: Callable[[], object] = lambda: ""
        self._dashboard = None if quiet else Dashboard(highest, dt)

    def __enter__(self) -> Self:
        if self._dashboard is not None:
            self._dashboard.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        if self._dashboard is not None:
            self._dashboard.__exit__(*error)

    def __call__(self, row: "Row") -> None:
        """Show a row."""
        if self._dashboard is not None:
            self._dashboard.show(row, str(self.health()))


def _files(out: list[Path]) -> list[Path]:
    """Return the files to write."""
    for path in out:
        if path.suffix not in _SUFFIXES:
            raise InvalidInput(f"--out {path}: a run is written as {', '.join(_SUFFIXES)}")
    return out


def _journal(files: list[Path]) -> Path | None:
    """Return the file that is written sample by sample: a .csv that is asked for, or one beside the first other."""
    if not files:
        return None
    return next((path for path in files if path.suffix == ".csv"), files[0].with_suffix(".partial.csv"))


def _write(record: "Record", files: list[Path], journal: Path | None, console: "Console") -> None:
    """Write the other files, and remove a journal that nobody asked for."""
    from mpc.trials.plotting import save_tracking_figure

    for path in files:
        if path.suffix == ".npz":
            record.save(path)
        elif path.suffix != ".csv":
            save_tracking_figure(record.run(), path)
    if journal is not None and journal not in files:
        journal.unlink()
    if files:
        say(console, f"written: {', '.join(map(str, files))}")


def _report(record: "Record", console: "Console") -> None:
    """Say how it ended and how well it went."""
    from allocator.units import DEG

    say(console, f"ended: {record.ending}")
    if record.ending.action is not None:
        done = "" if record.ending.delivered else ", which the device did not take"
        say(console, f"pressures: {record.ending.action}{done}")
    say(console, str(record.lateness))
    if record.tracked:
        say(console, f"angle error: {record.theta_rms / DEG:.3g}° RMS, as measured")


def _code(ending: "Ending") -> int:
    """Return the exit code that an ending asks for."""
    return _EXITS.get(str(ending.reason), _STOPPED)


__all__ = ["BenchOptions", "devices_command", "run_command"]
