"""Options of commands that move a joint or an arm, and the device that they open; in bar."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple

import typer

from allocator.errors import InvalidInput
from allocator.shell.options import finite, numbers, within
from allocator.units import BAR
from mpc.plant_cli import PlantOptions

if TYPE_CHECKING:
    from mpc.bench.cycle import Settings
    from mpc.bench.device import Clock, Device
    from mpc.bench.shell.dashboard import Dashboard
    from mpc.model.arm.model import Arm
    from mpc.model.compensation import Compensation
    from mpc.model.machine import Machine

_SIM = "sim"
_MUSCLE, _LAG = "sarosi-dmsp-20-400n", 0.12  # of the simulated joint, unless the options name one; [s]


@dataclass(frozen=True)
class BenchOptions:
    """Options of a command that moves a joint or an arm."""

    PANEL: ClassVar[str] = "Bench"

    device: Annotated[
        str,
        typer.Option(
            rich_help_panel="Options",
            help="device to drive, NAME or NAME:ADDRESS; such as sim, serial:/dev/ttyUSB0, "
            "modbus:192.168.0.5:502; or MODULE:FUNCTION of your own, such as my_rig:open_device. "
            "`antagonist devices` lists them",
        ),
    ] = ""
    present: Annotated[
        str | None,
        typer.Option(
            help="pressures at the start P1:P2, one a muscle [bar]; for devices that do not measure them, 0:0 if vented"
        ),
    ] = None
    start_rate: Annotated[float, typer.Option(help="rate of the soft start [bar/s]")] = 1.0
    stop: Annotated[str, typer.Option(help="final treatment of the pressures: ramp, hold or vent")] = "ramp"
    stop_rate: Annotated[float, typer.Option(help="rate of the ramp down [bar/s]")] = 1.0
    overrun: Annotated[
        str,
        typer.Option(
            help="reaction to samples that took too long: skip, catch-up or stop; with skip the reference goes on"
        ),
    ] = "skip"
    fast: Annotated[bool, typer.Option("--fast", help="run --device sim as fast as the computer can")] = False
    quiet: Annotated[bool, typer.Option("--quiet", help="show nothing during the run")] = False
    plot: Annotated[bool, typer.Option("--plot", help="draw the last seconds in a window")] = False

    def opened(self, options: PlantOptions, arm: "Arm | None" = None) -> "Opened":
        """Return the device, the clock of its loop, the joint's plant or else the `arm`, and its known effects.

        A `sim` without a file simulates the joint of the options, with the effects of a real bench. Its controller has
        the effects in the options, as on any device, and for the others the values that a fit would find. An arm has
        the effects in its file, and the sensors of a bench.
        """
        from mpc.bench.device import MonotonicClock, SimulatedClock
        from mpc.bench.devices.simulated import SimulatedDevice, simulated
        from mpc.model.real import RealPlant

        if not self.device:
            raise InvalidInput("--device is missing: name a device, such as sim or serial:/dev/ttyUSB0")
        name, _, address = self.device.partition(":")
        clock = SimulatedClock() if self.fast else MonotonicClock()
        if arm is not None:
            known = options.compensation_of_arm()
            return Opened(self._of_arm(arm, known, clock), clock, arm, known)
        plant, known = options.plant(), options.compensation()
        named = options.given("machine", "muscle", "agonist", "antagonist")
        if name == _SIM and not address:
            if not named:  # that of `RealPlant.standard`
                plant = replace(options, muscle=[_MUSCLE]).plant(lag=_LAG)
            real = simulated(plant, known)
            assert isinstance(real, RealPlant)
            found = replace(real.known(share=1.0), **known.told)
            return Opened(SimulatedDevice(real, clock, zero=options.encoder_zero), clock, plant, found)
        if name == _SIM:
            stranger = f"the controller's model is the default joint, not {address}: give --machine {address} as well"
            note = "" if named else stranger
            return Opened(_of_file(address, clock, plant), clock, plant, known, note)
        return Opened(self._driven(), clock, plant, known)

    def settings(self, options: PlantOptions, settle: float = 0.0, m: int = 2) -> "Settings":
        """Return the settings of a loop of m muscles: start, ends, safe stop, and the encoder's zero of the file."""
        from mpc.bench.cycle import Overrun, Settings
        from mpc.bench.safety import Action, SafeStop, SoftStart

        finite("--settle", settle, "s")
        within("--start-rate", self.start_rate, "bar/s", 1e-3, 100)
        within("--stop-rate", self.stop_rate, "bar/s", 1e-3, 100)
        _chosen("--stop", self.stop, list(Action))
        policies = {policy.name.lower().replace("_", "-"): policy for policy in Overrun}
        _chosen("--overrun", self.overrun, policies)
        present = None
        if self.present is not None:
            present = tuple(P * BAR for P in numbers("--present", self.present, m, m, ":".join("0" * m)))
        start = SoftStart(self.start_rate * BAR, settle=settle, present=present)
        stop = SafeStop(Action(self.stop), self.stop_rate * BAR)
        return Settings(policies[self.overrun], start, stop=stop, zero=options.encoder_zero)

    def dashboard(self, machine: "Machine") -> "Dashboard | None":
        """Return the dashboard of a loop on this machine, None if it is quiet."""
        from mpc.bench.shell.dashboard import Dashboard

        return None if self.quiet else Dashboard(machine, plot=self.plot)

    def _of_arm(self, arm: "Arm", known: "Compensation", clock: "Clock") -> "Device":
        """Return the device of an arm."""
        from mpc.bench.devices.simulated import SimulatedDevice, simulated

        name, _, address = self.device.partition(":")
        if name != _SIM:
            return self._driven()
        return _of_file(address, clock, arm) if address else SimulatedDevice(simulated(arm, known), clock)

    def _driven(self) -> "Device":
        """Return a device that is not simulated. Raises `InvalidInput` with --fast."""
        from mpc.bench.devices.registry import open_device

        if self.fast:
            raise InvalidInput(f"--fast is for --device {_SIM}: {self.device.partition(':')[0]} is as fast as it is")
        return open_device(self.device)


def _of_file(address: str, clock: "Clock", machine: "Machine") -> "Device":
    """Return the simulated device of a file. Raises `InvalidInput` for a machine with other joints or muscles."""
    from mpc.bench.devices.simulated import open_simulated

    device = open_simulated(address, clock)
    sizes = [(one.n, one.m) for one in (device.plant.nominal, machine)]
    if sizes[0] != sizes[1]:
        there, here = (f"{n} joint{'s' * (n > 1)} with {m} muscles" for n, m in sizes)
        raise InvalidInput(f"--device sim:{address} has {there}, and --machine {here}; give --machine {address}")
    return device


class Opened(NamedTuple):
    """Open device with its clock, and the plant and known effects of its joint or its arm."""

    device: "Device"
    clock: "Clock"
    plant: Any  # a `Plant` or an `Arm`
    known: "Compensation"
    note: str = ""  # a sentence on what the user may not have meant

    def assumed(self, options: PlantOptions) -> str:
        """Return the assumed effects that the joint's file does not state, or ""."""
        from mpc.model.compensation import Compensation

        told = options.compensation().told if options.file else self.known.told
        return Compensation(**{name: value for name, value in self.known.told.items() if name not in told}).summary


def _chosen(option: str, value: str, among: Iterable[str]) -> None:
    if value not in (names := list(among)):
        raise InvalidInput(f"{option} {value}: choose one of {', '.join(names)}")
