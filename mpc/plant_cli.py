"""Command `antagonist init`, and the options of a plant, in degrees and bar."""

from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import typer

from allocator.errors import InvalidInput
from allocator.shell.machine_options import A_MUSCLE, OF_ONE_JOINT, MachineOptions
from allocator.shell.options import numbers, read_gravity, within
from allocator.shell.outputs import Force, check_toml, claim
from allocator.units import BAR

if TYPE_CHECKING:
    from allocator.muscles import Muscle
    from mpc.model.arm.model import Arm
    from mpc.model.arm.reading import Read
    from mpc.model.compensation import Compensation
    from mpc.model.plant import Plant
    from mpc.trials.loops import Settings
    from mpc.tuning.draws import Spreads


_LAGS = ("lag_up", "lag_down")
_DRY = 0.5  # [-] known share of the dry friction of a MuJoCo model without a tuning


@dataclass(frozen=True)
class PlantOptions(MachineOptions):
    """Options of the plant, which override its file or `Plant()`."""

    PANEL: ClassVar[str] = "Plant"

    inertia: Annotated[float | None, typer.Option(help="moment of inertia of the link [kg·m²]; 0.05 by default")] = None
    damping: Annotated[float | None, typer.Option(help="viscous damping [N·m·s/rad]; 0.1 by default")] = None
    lag: Annotated[
        str | None,
        typer.Option(
            help="time constant of the pressures [s]; one number, or AGONIST:ANTAGONIST. By default 0.1, and 0.12 "
            "on the real plant"
        ),
    ] = None
    gravity: Annotated[
        str | None,
        typer.Option(
            help="gravity of the link, G or G,θh: m g l [N·m], negative for one that stands, and the angle at which it "
            "hangs [degrees], by default the file's hanging_angle, or 0. 0 by default"
        ),
    ] = None
    slew: Annotated[float | None, typer.Option(help="greatest rate of a commanded pressure [bar/s]; 5 by default")] = (
        None
    )
    gas: Annotated[
        bool | None,
        typer.Option(help="motion compresses the gas in the muscles; by default as in the file, or yes"),
    ] = None
    kappa: Annotated[
        float | None,
        typer.Option(help="polytropic exponent of the gas; 1 (slow) to 1.4 (fast), 1.3 by default. Implies --gas"),
    ] = None
    frequency: Annotated[float | None, typer.Option(help="frequency of the stiffness [Hz]; isobaric by default")] = None
    tuning: Annotated[
        str | None,
        typer.Option(help="TOML file with the table [tuning] of the controller; by default the machine's file"),
    ] = None

    def __post_init__(self) -> None:
        """Refuse implausible values, in the units of the options."""
        super().__post_init__()
        within("--inertia", self.inertia, "kg·m²", 1e-9, 1e6)
        within("--damping", self.damping, "N·m·s/rad", 0, 1e6)
        if self.gravity is not None:
            read_gravity(self.gravity)
        within("--slew", self.slew, "bar/s", 1e-3, 1e5)
        within("--frequency", self.frequency, "Hz", 0, 1e4)
        if self.gas is False and (option := self.given("kappa", "frequency")):
            raise InvalidInput(f"{option} is of the gas, which --no-gas leaves out; drop one of them")

    def plant(self, **otherwise: Any) -> "Plant":
        """Build the plant of a joint; `otherwise` holds defaults for numbers neither given nor in the file.

        Raises `InvalidFile` for numbers of the file that are no plant's.
        """
        from allocator.files.toml import Table
        from mpc.model.plant import NUMBERS, Plant
        from mpc.model.storage import numbers_in

        joint = self.joint()
        stored = {} if self.file is None else numbers_in(Table.read(self.file), NUMBERS)
        if self.kappa is not None:
            joint = replace(joint, gas=replace(joint.gas, kappa=self.kappa))
        try:
            return Plant(joint, **(otherwise | stored | self._numbers()))
        except (InvalidInput, TypeError, OverflowError):
            if self.file is not None:
                Plant.load(str(self.file))  # names the file, if its numbers are wrong
            raise

    @property
    def encoder_zero(self) -> float:
        """Encoder reading [rad] at 0 of the joint, by its file."""
        from allocator.files.toml import Table
        from allocator.machine_file import encoder_zero_in

        return 0.0 if self.file is None else encoder_zero_in(Table.read(self.file))

    @property
    def of_several(self) -> bool:
        """Whether the machine is not one joint with two muscles. Raises `InvalidFile` and `MissingBackend`."""
        from allocator.joint.antagonist import AntagonistJoint

        return self.is_mujoco or not isinstance(self.base, AntagonistJoint)

    def arm(self) -> "Arm":
        """Build the arm of several joints with bodies that --machine names. Raises `InvalidInput`."""
        from mpc.model.arm.model import Arm
        from mpc.model.arm.storage import load_arm

        if self.is_mujoco:
            return self.mujoco_arm(self.mujoco())
        if not self.of_several:
            raise InvalidInput(
                "this command takes an arm of several joints: --machine arm26, a file with [bodies] or a MuJoCo model"
            )
        arm = load_arm(self.file) if self.file else Arm.machine(str(self.machine))
        return self.driven(replace(arm, mechanism=self._changed(arm.mechanism)))

    def mujoco(self, hand: str | None = None) -> "Read":
        """Read the MuJoCo model that --machine names, with the muscles of the options and its `hand`.

        Raises `InvalidFile`, `InvalidInput`, `MissingBackend` and `MissingPackage`.
        """
        from mpc.model.arm.reading import read_arm

        return read_arm(str(self.machine), hand=hand, **self.mujoco_numbers())

    def mujoco_arm(self, read: "Read") -> "Arm":
        """Return the arm of a MuJoCo model that was read, with its regulators and gas as given."""
        from mpc.model.arm.model import Arm

        return self.driven(Arm(read.mechanism, read.bodies))

    def driven(self, arm: "Arm") -> "Arm":
        """Return `arm` with its regulators and gas as given. Raises `InvalidInput` for options of one joint."""
        self.refuse_one_joints(*OF_ONE_JOINT, "inertia", "damping", "gravity")
        if self.frequency is not None:
            raise InvalidInput("--frequency is for one joint with two muscles: K of an arm is isobaric")
        changes: dict[str, Any] = {} if self.slew is None else {"slew": self.slew * BAR}
        if (lags := self._lags(arm.m)) is not None:
            changes["lag"] = lags
        if self.kappa is not None:
            changes["gas"] = replace(arm.mechanism.gas, kappa=self.kappa)
        elif self.gas is not None:
            changes["gas"] = self.gas
        return replace(arm, **changes) if changes else arm

    def compensation_of_arm(self) -> "Compensation":
        """Return the friction and the regulators of an arm's file, or the dry friction of a MuJoCo model's joints."""
        from mpc.model.compensation import Compensation
        from mpc.model.friction.dahl import Friction

        known = Compensation.of_arm(self.file)
        if not self.is_mujoco:
            return known
        return replace(known, frictions=tuple(Friction(coulomb=T) for T in self.mujoco().dry.tolist()))

    def compensation(self) -> "Compensation":
        """Return the hysteresis or friction and the regulators of the file. --lag overrides its lags."""
        from mpc.model.compensation import Compensation
        from mpc.model.storage import stored_regulators

        known = Compensation.of(self.joint())
        if self.file is None:
            return known
        told = stored_regulators(self.file)
        return replace(known, **{n: value for n, value in told.items() if self.lag is None or n not in _LAGS})

    def tuned(self, settings: "Settings", controller: str) -> "tuple[Settings, str]":
        """Return the settings with the tuning of this controller, and a sentence about it; "" without one.

        Without one, a loop knows half of the dry friction of a MuJoCo model, since all of it overshoots.

        Raises `InvalidInput` for a --tuning without one for this controller.
        """
        from mpc.trials.tuned import Tuning

        file = self.tuning or self.file
        tuning = None if file is None else Tuning.load(file)
        if self.tuning and (tuning is None or tuning.controller != controller):
            raise InvalidInput(f"--tuning {file} has no table [tuning] for {controller}; `antagonist tune` writes one")
        if tuning is None or tuning.controller != controller:
            known = settings.compensation
            told = tuple(one.share(_DRY) for one in known.frictions) if self.is_mujoco else known.frictions
            return settings._replace(compensation=replace(known, frictions=told)), ""
        return tuning.applied(settings), tuning.summary

    def spreads(self) -> "Spreads":
        """Return the spreads of the file's fit; those of data sheets without a file."""
        from mpc.tuning.draws import Spreads

        return Spreads() if self.file is None else Spreads.load(self.file)

    def _numbers(self) -> dict[str, float | tuple[float, ...]]:
        """Return the numbers of `Plant` that are given."""
        from allocator.joint.gravity import FILED

        given: dict[str, Any] = {
            "inertia": self.inertia,
            "damping": self.damping,
            "slew": None if self.slew is None else self.slew * BAR,
            "gas": self.gas if self.kappa is None else True,  # the joint's
            "frequency": self.frequency,
        }
        if self.gravity is not None:
            given |= dict(zip(FILED, read_gravity(self.gravity), strict=False))
        if (lags := self._lags(2)) is not None:
            given |= {"lag": lags, "venting": 1.0}
        return {name: value for name, value in given.items() if value is not None}

    def _lags(self, m: int) -> tuple[float, ...] | None:
        """Return the lags [s] of `m` muscles, if they are given."""
        if self.lag is None:
            return None
        lags = numbers("--lag", self.lag, 1, m, "0.1:0.12")
        for lag in lags:
            within("--lag", lag, "s", 1e-4, 10)
        if len(lags) not in (1, m):
            raise InvalidInput(f"--lag {self.lag}: expected one time or {m}, one a muscle")
        return tuple(lags) if len(lags) == m else tuple(lags * m)


@dataclass(frozen=True)
class LoopOptions:
    """Options of a loop along a trajectory."""

    PANEL: ClassVar[str] = "Loop"

    stiffness: Annotated[
        float | None,
        typer.Option(
            help="mean stiffness of a standard trajectory [N·m/rad]; by default the middle of the joint's range"
        ),
    ] = None
    dt: Annotated[float, typer.Option(help="sample time of the controller [s]")] = 0.01
    horizon: Annotated[int, typer.Option(help="horizon of mpc and nmpc, in samples")] = 20


def init_command(
    file: Annotated[Path, typer.Argument(help="TOML file to write, e.g. joint.toml")],
    machine: Annotated[
        str | None,
        typer.Option(help="arm26, arm48 or leg37; writes several joints and their bodies instead of a joint"),
    ] = None,
    muscle: Annotated[str | None, typer.Option(help=f"all muscles; {A_MUSCLE}")] = None,
    gas: Annotated[
        bool | None,
        typer.Option(help="motion compresses the gas in the muscles; by default yes"),
    ] = None,
    force: Force = False,
) -> None:
    """Write a plant file to edit: joint, muscles and link, with comments.

    The file is valid as it is; every command takes it with --machine.
    """
    from allocator.files.atomic import write_text
    from allocator.muscles.catalogue import named_muscle

    claim(file, inputs=(muscle,), force=force)
    check_toml("FILE", file)
    law = None if muscle is None else named_muscle(muscle)
    if machine is not None:
        _write_arm(file, machine, law, gas is not False)
        typer.echo(f"written: {file}; edit it, then try `antagonist track --machine {file}`")
        return
    text = (resources.files("mpc") / "data" / "joint.toml").read_text(encoding="utf-8")
    if law is not None:
        text = _with_muscle(text, law)
    write_text(file, text.replace("gas = true ", "gas = false", 1) if gas is False else text)
    typer.echo(f"written: {file}; edit it, then try `antagonist map --machine {file}`")


def _write_arm(file: Path, machine: str, law: "Muscle | None", gas: bool) -> None:
    """Write the file of a ready-made arm, with muscles of a `law`, and say what is assumed of their gas."""
    from allocator.joint.assumption import filled
    from mpc.model.arm.model import Arm
    from mpc.model.arm.storage import save_arm

    arm = Arm.machine(machine)
    mechanism = arm.mechanism if law is None else arm.mechanism.with_muscles(law)
    _, assumed = filled(mechanism.muscles, mechanism.routes.rest_length, arm.pressure_limits[1])
    if gas and assumed:
        typer.echo(assumed)
    save_arm(replace(arm, mechanism=mechanism, gas=gas), file)


def _with_muscle(text: str, muscle: "Muscle") -> str:
    """Return the text of a joint's file with this muscle on both sides."""
    from allocator.joint.antagonist import report_joint
    from allocator.machine_file import muscle_text

    joint = replace(report_joint(), agonist=muscle, antagonist=muscle)
    return text[: text.index("[[muscle]]")] + muscle_text(joint) + text[text.index("[plant]") :]
