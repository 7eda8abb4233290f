"""`antagonist init` is here, and the options that describe a plant; degrees and bar here, SI behind."""

from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from allocator.shell.joint_options import JointOptions
from allocator.shell.options import numbers, within
from allocator.shell.outputs import Force, claim
from allocator.units import BAR

if TYPE_CHECKING:
    from mpc.model.compensation import Compensation
    from mpc.model.plant import Plant


_LAGS = ("lag_up", "lag_down")


@dataclass(frozen=True)
class PlantOptions(JointOptions):
    """The options are what the user says of the plant; the rest is as in the file, or as in `Plant()`."""

    inertia: Annotated[float | None, typer.Option(help="moment of inertia of the link [kg·m²]; else 0.05")] = None
    damping: Annotated[float | None, typer.Option(help="viscous damping [N·m·s/rad]; else 0.1")] = None
    lag: Annotated[
        str | None,
        typer.Option(help="time constant of the pressures [s], or AGONIST:ANTAGONIST; else 0.1, real plant 0.12"),
    ] = None
    gravity: Annotated[
        float | None, typer.Option(help="m g l of a link that hangs at 0° [N·m], negative where it stands; else 0")
    ] = None
    slew: Annotated[float | None, typer.Option(help="greatest change of a commanded pressure [bar/s]; else 5")] = None
    kappa: Annotated[
        float | None,
        typer.Option(help="reckon with the gas in the muscles: its polytropic exponent, 1 (slow) to 1.4 (fast)"),
    ] = None
    frequency: Annotated[
        float | None, typer.Option(help="frequency at which the stiffness is meant [Hz], with gas; else it is isobaric")
    ] = None

    def __post_init__(self) -> None:
        """Refuse what can only be a mistake, in the units of the options."""
        super().__post_init__()
        within("--inertia", self.inertia, "kg·m²", 1e-9, 1e6)
        within("--damping", self.damping, "N·m·s/rad", 0, 1e6)
        within("--gravity", self.gravity, "N·m", -1e6, 1e6)
        within("--slew", self.slew, "bar/s", 1e-3, 1e5)
        within("--frequency", self.frequency, "Hz", 0, 1e4)

    def plant(self, **otherwise: Any) -> "Plant":
        """Build the plant; `otherwise` holds what is neither given nor in the file."""
        from mpc.model.plant import NUMBERS, Plant
        from mpc.model.storage import stored_numbers

        stored = {} if self.joint is None else stored_numbers(self.joint, NUMBERS)
        joint = self.build()
        if self.kappa is not None:
            joint = replace(joint, gas=replace(joint.gas, kappa=self.kappa))
        return Plant(joint, **(otherwise | stored | self._numbers()))

    def compensation(self) -> "Compensation":
        """Return what the file tells beyond the plant: hysteresis or friction, and regulators. --lag overrides lags."""
        from mpc.model.compensation import Compensation
        from mpc.model.storage import stored_regulators

        known = Compensation.of(self.build())
        if self.joint is None:
            return known
        told = stored_regulators(self.joint)
        return replace(known, **{n: value for n, value in told.items() if self.lag is None or n not in _LAGS})

    def _numbers(self) -> dict[str, Any]:
        """Return the numbers of `Plant` that are given."""
        given: dict[str, Any] = {
            "inertia": self.inertia,
            "damping": self.damping,
            "gravity_torque": self.gravity,
            "slew": None if self.slew is None else self.slew * BAR,
            "gas": None if self.kappa is None else True,  # the joint's
            "frequency": self.frequency,
        }
        if self.lag is not None:
            lags = numbers("--lag", self.lag, 1, 2, "0.1:0.12")
            for lag in lags:
                within("--lag", lag, "s", 1e-4, 100)
            given["lag"] = (lags[0], lags[-1])
        return {name: value for name, value in given.items() if value is not None}


def init_command(
    file: Annotated[Path, typer.Argument(help="the TOML file to write, e.g. joint.toml")],
    force: Force = False,
) -> None:
    """Write a plant to edit: joint, muscles and link, with comments; it runs as it is.

    Every command takes it with --joint.
    """
    from allocator.files.atomic import write_text

    claim(file, force=force)
    write_text(file, (resources.files("mpc") / "data" / "joint.toml").read_text(encoding="utf-8"))
    typer.echo(f"written: {file}; edit it, then try `antagonist map --joint {file}`")
