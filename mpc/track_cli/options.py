"""Options of `antagonist track`, which a joint and an arm share, and all that a command line asks for."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, NamedTuple

import typer

from allocator import checks
from allocator.errors import MissingBackend
from allocator.shell.options import finite, within
from mpc.arm.options import HandOptions
from mpc.plant_cli import LoopOptions, PlantOptions
from mpc.repetition.options import RepeatOptions

if TYPE_CHECKING:
    from mpc.trials.motions.reference import Reference
    from mpc.trials.simulation import Load

OTHER, REAL, NOMINAL = "other", "real", "nominal"
PLANTS = {
    OTHER: "driving a plant of another structure",
    REAL: "driving the plant with the effects of a real one",
    NOMINAL: "driving its own model",
}
"""Plants under test, and the words for them in titles."""
MPC = "mpc"


@dataclass(frozen=True)
class TrialOptions:
    """Options of a simulated run: the plant under test, the controller, its observer and the load."""

    PANEL: ClassVar[str] = "Options"

    solver: Annotated[
        str | None,
        typer.Option(
            help="QP or NLP solver; for mpc riccati (default), daqp or a solver of qpsolvers, e.g. osqp; for nmpc "
            "ipopt or fatrop"
        ),
    ] = None
    plant: Annotated[
        str,
        typer.Option(
            help="plant to drive: other, real or nominal; other: muscles of another force law and "
            "the effects of real. real: wrong muscle strengths, hysteresis, dead time, dead band, sensors "
            "with steps and noise. nominal: the controller's model. The real plant of several joints has only the "
            "hysteresis of its file"
        ),
    ] = OTHER
    controller: Annotated[str, typer.Option(help="mpc, nmpc (slow), pid, pi, predictive-pid, lqr or feedforward")] = MPC
    observer: Annotated[
        bool | None,
        typer.Option(
            help="estimate state and disturbance torque; by default mpc, nmpc and lqr do unless the plant is nominal"
        ),
    ] = None
    payload: Annotated[
        float, typer.Option(help="unmodelled load from half-way on [N·m]; with several joints on the first one")
    ] = 0.0
    seed: Annotated[int, typer.Option(help="seed of the sensor noise")] = 0
    amplitude: Annotated[
        float | None,
        typer.Option(
            help="amplitude of pushes whose felt stiffness is reported [±°]; for plants with hysteresis; 2 by default"
        ),
    ] = None
    wait: Annotated[
        bool,
        typer.Option(
            "--wait",
            envvar="ANTAGONIST_WAIT",
            help="wait for compilation of the mpc step; needed once after an installation, and once for each arm. "
            "Otherwise it is compiled in a second process, and this run takes the uncompiled step",
        ),
    ] = False

    def __post_init__(self) -> None:
        if self.plant not in PLANTS:
            raise MissingBackend("plant", self.plant, PLANTS)
        finite("--payload", self.payload, "N·m")
        within("--amplitude", self.amplitude, "°", 1e-3, 180)
        checks.count("--seed", self.seed, least=0)

    def load(self, asked: "Reference", n: int = 1) -> "Load | None":
        """Return the torque [N·m] of --payload over time, on the first of `n` joints from half-way on."""
        if not self.payload:
            return None
        half_way, on = asked.duration / 2, [self.payload] + [0.0] * (n - 1)
        loaded, free = (on, [0.0] * n) if n > 1 else (self.payload, 0.0)
        return lambda t: loaded if t >= half_way else free


@dataclass(frozen=True)
class ArmOptions(HandOptions):
    """Options of several joints on MuJoCo."""

    catch: Annotated[float, typer.Option(help="unmodelled mass at rest that the hand catches half-way [kg]")] = 0.0
    view: Annotated[bool, typer.Option("--view", help="show the arm in MuJoCo's window, in real time")] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        within("--catch", self.catch, "kg", 0.0, 100.0)


class Request(NamedTuple):
    """All that a command line asks for."""

    machine: PlantOptions
    loop: LoopOptions
    arm: ArmOptions
    repeated: RepeatOptions
    trial: TrialOptions
    trajectory: str | None  # a name or a file
    files: list[Path]  # of the run

    @property
    def load(self) -> str:
        """Name of the carried load, to which a correction belongs."""
        payload = self.trial.payload
        return self.repeated.load or (f"payload {payload:g} N·m" if payload else "")
