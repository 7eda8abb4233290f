"""The options that describe a joint are the same for every command; millimetres, degrees and bar here, SI behind."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from allocator.errors import InvalidInput
from allocator.shell.options import numbers, within
from allocator.units import BAR, CM3, DEG, MM

if TYPE_CHECKING:
    from allocator.joint.antagonist import AntagonistJoint
    from allocator.joint.geometry import Geometry
    from allocator.muscles import Muscle

_MUSCLE = "a name that `antagonist muscles` lists, or a TOML file written by `antagonist fit`"


@dataclass(frozen=True)
class JointOptions:
    """The options are what the user says of the joint; the rest is as in the file, or as in the report's joint."""

    joint: Annotated[
        Path | None,
        Option(
            help="joint or plant in a TOML file, written by `antagonist init` or `fit-joint`; without it the report's. "
            "The options below change what it says"
        ),
    ] = None
    muscle: Annotated[list[str] | None, Option(help=f"both muscles: {_MUSCLE}")] = None
    agonist: Annotated[str | None, Option(help="the muscle that shortens as the angle grows, likewise")] = None
    antagonist: Annotated[str | None, Option(help="the muscle that lengthens, likewise")] = None
    radius: Annotated[float | None, Option(help="radius of the pulley [mm]; the report's: 20")] = None
    rest_length: Annotated[float | None, Option(help="rest length of the muscles [mm]; the report's: 400")] = None
    initial_contraction: Annotated[
        float | None, Option(help="contraction ratio of both muscles at 0°; the report's: 0.1375")
    ] = None
    supply: Annotated[float | None, Option(help="greatest pressure of the supply [bar]; the report's: 5")] = None
    stops: Annotated[str | None, Option(help="mechanical end stops LOW:HIGH [degrees]; the report's: -125:125")] = None
    rest_volume: Annotated[
        float | None, Option(help="gas in each muscle at rest length [cm³]; else that of a tube of the muscle's radius")
    ] = None
    tube_volume: Annotated[float | None, Option(help="gas between each muscle and its valve [cm³]")] = None
    friction: Annotated[float | None, Option(help="friction, as a share of the muscles' forces; the report's: 0")] = (
        None
    )

    def __post_init__(self) -> None:
        """Refuse what can only be a mistake, in the units of the options."""
        within("--radius", self.radius, "mm", 0.1, 10_000)
        within("--rest-length", self.rest_length, "mm", 1, 10_000)
        within("--initial-contraction", self.initial_contraction, "(a ratio, not percent)", 0, 1)
        within("--supply", self.supply, "bar", 0.05, 100)
        within("--friction", self.friction, "", 0, 1)
        within("--rest-volume", self.rest_volume, "cm³", 0.1, 5000)
        within("--tube-volume", self.tube_volume, "cm³", 0, 1000)

    def build(self) -> "AntagonistJoint":
        """Build the joint. Raises `InvalidInput` for several muscles."""
        joints = self.compared()
        if len(joints) > 1:
            raise InvalidInput("--muscle is given several times; for two different ones --agonist and --antagonist")
        return next(iter(joints.values()))

    def compared(self) -> dict[str, "AntagonistJoint"]:
        """Return the joint with each of the muscles, by their names."""
        from allocator.joint.antagonist import report_joint
        from allocator.joint.storage import load_joint

        base = report_joint() if self.joint is None else load_joint(self.joint)
        if not self.muscle:
            return {self._name: self._changed(base, None)}
        return {name: self._changed(base, name) for name in self.muscle}

    @property
    def files(self) -> tuple[str | Path | None, ...]:
        """Return the files that these options may name."""
        return (self.joint, *(self.muscle or ()), self.agonist, self.antagonist)

    @property
    def _name(self) -> str:
        given = [str(name) for name in (self.agonist, self.antagonist) if name]
        return " and ".join(given) or ("tondu-dmsp-20-400n" if self.joint is None else self.joint.stem)

    def _changed(self, base: "AntagonistJoint", muscle: str | None) -> "AntagonistJoint":
        """Return `base` with everything that is given."""
        changes: dict[str, Any] = self._muscles(muscle)
        if changes:
            changes["covariance"] = None  # it was of the muscles in the file
        if (geometry := self._geometry(base.geometry)) != base.geometry:
            changes["geometry"] = geometry
        if self.supply is not None:
            changes["pressure_limits"] = (base.pressure_limits[0], self.supply * BAR)
        if self.stops is not None:
            left, right = numbers("--stops", self.stops, 2, 2, "-90:90")
            for angle in (left, right):
                within("--stops", angle, "degrees", -360, 360)
            changes["angle_limits"] = (left * DEG, right * DEG)
        if self.friction is not None:
            changes |= {"friction": self.friction, "hysteresis": None}  # one says all that the other would
        if volumes := self._volumes:
            for side in ("agonist", "antagonist"):
                changes[side] = replace(changes.get(side, getattr(base, side)), **volumes)
        return replace(base, **changes) if changes else base

    @property
    def _volumes(self) -> dict[str, float]:
        given = {"rest_volume": self.rest_volume, "tube_volume": self.tube_volume}
        return {name: volume * CM3 for name, volume in given.items() if volume is not None}

    def _muscles(self, both: str | None) -> dict[str, "Muscle"]:
        from allocator.muscles.catalogue import named_muscle

        names = {"agonist": self.agonist or both, "antagonist": self.antagonist or both}
        return {side: named_muscle(name) for side, name in names.items() if name is not None}

    def _geometry(self, base: "Geometry") -> "Geometry":
        from allocator.joint.geometry import Pulley

        given: dict[str, float] = {}
        if self.rest_length is not None:
            given["rest_length"] = self.rest_length * MM
        if self.radius is not None:
            given["radius"] = self.radius * MM
        if self.initial_contraction is not None:
            given["initial_contraction"] = self.initial_contraction
        if given.keys() - {"rest_length"} and not isinstance(base, Pulley):
            raise InvalidInput(
                f"--radius and --initial-contraction are for a pulley; {self.joint} has a {type(base).__name__}"
            )
        return replace(base, **given) if given else base
