"""Options of a machine, shared by all commands; in millimetres, degrees and bar.

`HandOptions` are those of the posture and the hand of several joints; in degrees, millimetres and N.
"""

from dataclasses import dataclass, replace
from inspect import signature
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple

import numpy as np
from typer import Option

from allocator.errors import InvalidInput
from allocator.shell.options import numbers, row, within
from allocator.units import BAR, CM3, DEG, MM

if TYPE_CHECKING:
    from allocator.calculus import Array
    from allocator.joint.antagonist import AntagonistJoint
    from allocator.joint.geometry import Geometry
    from allocator.machine_file import Machine
    from allocator.mechanism.endpoint import Endpoint
    from allocator.mechanism.mechanism import Mechanism
    from allocator.mechanism.routes.base import Routes
    from allocator.muscles import Muscle


class Hand(NamedTuple):
    """Hand of --links or --hand, and its force of --push."""

    endpoint: "Endpoint"
    force: "Array"  # (2,) [N]


@dataclass(frozen=True)
class HandOptions:
    """Options of several joints; numbers are separated by commas."""

    PANEL: ClassVar[str] = "Several joints"

    posture: Annotated[str | None, Option(help="the joint angles, such as 23,-17 [degrees]")] = None
    links: Annotated[
        str | None,
        Option(help="lengths of the links of a planar machine, such as 300,250 [mm]; they locate its hand"),
    ] = None
    links_at_zero: Annotated[
        str | None, Option(help="angle of each link to the one before at posture 0 [degrees]; 0 by default")
    ] = None
    hand: Annotated[
        str | None,
        Option(help="hand of a MuJoCo model: a site or a body; with some of its coordinates, such as tip:xy"),
    ] = None
    push: Annotated[str | None, Option(help="force that the hand exerts, such as 5,0 [N]; 0 by default")] = None

    def __post_init__(self) -> None:
        if self.links is not None and self.hand is not None:
            raise InvalidInput(f"--links {self.links} and --hand {self.hand}: give one of the two")
        if self.links_at_zero is not None and self.links is None:
            raise InvalidInput("--links-at-zero goes with --links")
        if self.push is not None and self.links is None and self.hand is None:
            raise InvalidInput("--push goes with --links, or with --hand of a MuJoCo model, which locate the hand")

    def none(self) -> None:
        """Insist that nothing is said of several joints. Raises `InvalidInput`."""
        for option, value in (("--links", self.links), ("--hand", self.hand), ("--posture", self.posture)):
            if value is not None:
                raise InvalidInput(f"{option} goes with a --machine of several joints; a joint has --theta")

    def angles(self, mechanism: "Mechanism") -> "Array":
        """Return the posture (n,) [rad]. Raises `InvalidInput`."""
        n, names = mechanism.n, ", ".join(mechanism.joint_names)
        if self.posture is None:
            raise InvalidInput(f"give --posture, the angles of {names} [degrees], such as {','.join(['10'] * n)}")
        return np.array(_angles("--posture", self.posture, {n: f"the angles of {names}"})) * DEG

    def located(self, mechanism: "Mechanism", machine: str | None) -> Hand | None:
        """Return the hand, if the options locate it; `machine` is the name of the mechanism. Raises `InvalidInput`."""
        if self.hand is not None:
            endpoint = self._of_model(mechanism, machine)
        elif self.links is not None:
            endpoint = self._of_links(mechanism)
        else:
            return None
        axes: Any = endpoint.kinematics
        parts = {endpoint.dim: f"its {' and '.join(axes.axes)}"}
        push = [0.0] * endpoint.dim if self.push is None else row("--push", self.push, "N", parts)
        return Hand(endpoint, np.array(push))

    def _of_model(self, mechanism: "Mechanism", machine: str | None) -> "Endpoint":
        from allocator.mechanism.endpoint import hand_of_model

        if machine is None or not _is_xml(machine):
            raise InvalidInput(f"--hand {self.hand} is of a MuJoCo model (.xml); {machine} takes --links")
        endpoint = hand_of_model(machine, str(self.hand), mechanism)
        if endpoint is None:
            raise InvalidInput(f"--hand {self.hand}: no joint of {machine} moves it")
        return endpoint

    def _of_links(self, mechanism: "Mechanism") -> "Endpoint":
        from allocator.mechanism.endpoint import Endpoint

        n = {mechanism.n: "one a link"}
        lengths = np.array(row("--links", str(self.links), "mm", n))
        within("--links", float(lengths.min()), "mm", 1, 10_000)
        within("--links", float(lengths.max()), "mm", 1, 10_000)
        angles = [0.0] if self.links_at_zero is None else _angles("--links-at-zero", self.links_at_zero, n)
        return Endpoint.planar(lengths * MM, np.broadcast_to(np.array(angles), lengths.shape) * DEG)


def torques(text: str, mechanism: "Mechanism") -> "Array":
    """Return the torques (n,) [N·m]. Raises `InvalidInput`."""
    found = row("--torque", text, "N·m", {1: "one for all joints", mechanism.n: "one a joint"})
    return np.broadcast_to(np.array(found), (mechanism.n,))


def _angles(option: str, text: str, counts: dict[int, str]) -> list[float]:
    """Read angles [degrees]."""
    found = row(option, text, "degrees", counts)
    if max(map(abs, found)) > 360:
        raise InvalidInput(f"{option} {text}: an angle is over a turn")
    return found


A_MUSCLE = "a name that `antagonist muscles` lists, or a TOML file written by `antagonist fit`"
OF_ONE_JOINT = "agonist", "antagonist", "radius", "stops", "friction"  # options
_MUSCLE, _CONTRACTION = "sarosi-dmsp-20-400n", 0.1375  # defaults of a MuJoCo model


def _is_xml(machine: str | None) -> bool:
    return machine is not None and machine.lower().endswith(".xml")


def _one_or_all(values: list[Any]) -> Any:
    return values[0] if len(values) == 1 else values


@dataclass(frozen=True)
class MachineOptions:
    """Options of the machine, which override its file or the report's joint."""

    PANEL: ClassVar[str] = "Machine"

    machine: Annotated[
        str | None,
        Option(
            help="a TOML file of a joint or of several joints, arm26, arm48 or leg37, or a MuJoCo model (.xml); "
            "`antagonist init` writes a TOML file. By default the joint of Tondu's report. The options below override "
            "the file"
        ),
    ] = None
    muscle: Annotated[
        list[str] | None,
        Option(help=f"all muscles; {A_MUSCLE}. Repeat it to give one muscle each to several joints"),
    ] = None
    agonist: Annotated[str | None, Option(help="the muscle that shortens as the angle grows; as --muscle")] = None
    antagonist: Annotated[str | None, Option(help="the muscle that lengthens as the angle grows; as --muscle")] = None
    radius: Annotated[float | None, Option(help="radius of the pulley [mm]; the report's: 20")] = None
    rest_length: Annotated[
        str | None,
        Option(help="rest length of the muscles [mm]; one number, or one per muscle with commas. The report's: 400"),
    ] = None
    initial_contraction: Annotated[
        str | None,
        Option(
            help="contraction ratio of the muscles at 0°; one number, or one per muscle with commas. The "
            "report's: 0.1375"
        ),
    ] = None
    supply: Annotated[float | None, Option(help="greatest supply pressure [bar]; the report's: 5")] = None
    stops: Annotated[str | None, Option(help="mechanical end stops LOW:HIGH [degrees]; the report's: -125:125")] = None
    rest_volume: Annotated[
        float | None,
        Option(help="gas in each muscle at rest length [cm³]; by default that of a tube of the muscle's radius"),
    ] = None
    tube_volume: Annotated[float | None, Option(help="gas between each muscle and its valve [cm³]")] = None
    friction: Annotated[float | None, Option(help="friction, as a share of the muscle forces; the report's: 0")] = None

    def __post_init__(self) -> None:
        """Refuse implausible values, in the units of the options."""
        within("--radius", self.radius, "mm", 0.1, 10_000)
        for length in self.rest_lengths or ():
            within("--rest-length", length, "mm", 1, 10_000)
        for ratio in self.contractions or ():
            within("--initial-contraction", ratio, "(a ratio, not percent)", 0, 1)
        within("--supply", self.supply, "bar", 0.05, 100)
        within("--friction", self.friction, "", 0, 1)
        within("--rest-volume", self.rest_volume, "cm³", 0.1, 5000)
        within("--tube-volume", self.tube_volume, "cm³", 0, 1000)

    def build(self) -> "Machine":
        """Build the machine. Raises `InvalidInput` and `MissingBackend`."""
        from allocator.mechanism.mechanism import Mechanism

        base = self.base
        if self.is_mujoco:
            return base
        return self._changed(base) if isinstance(base, Mechanism) else self._one(base)

    def joint(self) -> "AntagonistJoint":
        """Build one joint with two muscles. Raises `InvalidInput`, also for another machine."""
        from allocator.machine_file import described
        from allocator.mechanism.mechanism import Mechanism

        base = None if self.is_mujoco else self.base
        if base is None or isinstance(base, Mechanism):
            what = "a MuJoCo model" if base is None else described(base)
            raise InvalidInput(f"this command takes one joint with two muscles; --machine {self.machine} is {what}")
        return self._one(base)

    def compared(self, base: "AntagonistJoint") -> dict[str, "AntagonistJoint"]:
        """Return the joint with each of the muscles, by their names."""
        if not self.muscle:
            return {self.name: self._joint(base, None)}
        return {name: self._joint(base, name) for name in self.muscle}

    @property
    def base(self) -> "Machine":
        """The machine without the changes, but a MuJoCo model has the muscles of the options."""
        from allocator.joint.antagonist import report_joint
        from allocator.machine_file import named_machine
        from allocator.mechanism.mechanism import Mechanism

        if self.is_mujoco:
            return Mechanism.from_mjcf(str(self.machine), **self.mujoco_numbers())
        return report_joint() if self.machine is None else named_machine(self.machine)

    @property
    def is_mujoco(self) -> bool:
        """Whether the machine is a MuJoCo model."""
        return _is_xml(self.machine)

    @property
    def mujoco_muscles(self) -> list[str]:
        """Names of a MuJoCo model's muscles, one for all or one each."""
        return self.muscle or [_MUSCLE]

    def mujoco_numbers(self) -> dict[str, Any]:
        """Return muscles, rest lengths and cables of a MuJoCo model, which has tendons only. Raises `InvalidInput`."""
        from allocator.muscles.catalogue import named_muscle

        self.refuse_one_joints(*OF_ONE_JOINT)
        muscles = [replace(named_muscle(name), **self.volumes) for name in self.mujoco_muscles]
        lengths, eps = self.rest_lengths, self.contractions
        found: dict[str, Any] = {"muscles": _one_or_all(muscles)}
        if lengths is not None:
            found["rest_length"] = _one_or_all([length * MM for length in lengths])
            found["contraction"] = _one_or_all(eps or [_CONTRACTION])
        elif eps is not None:
            raise InvalidInput("--initial-contraction of a MuJoCo model goes with --rest-length, of its muscles")
        return found if self.supply is None else found | {"pressure_limits": (0.0, self.supply * BAR)}

    @property
    def file(self) -> str | None:
        """The file of the machine, if it has one."""
        return self.machine if self.machine is not None and self.machine.endswith(".toml") else None

    @property
    def files(self) -> tuple[str | None, ...]:
        """The files that these options may name."""
        return (self.machine, *(self.muscle or ()), self.agonist, self.antagonist)

    @property
    def name(self) -> str:
        """The joint's name, after its muscles or its file."""
        from pathlib import Path

        given = [str(name) for name in (self.agonist, self.antagonist) if name]
        return " and ".join(given) or ("tondu-dmsp-20-400n" if self.machine is None else Path(self.machine).stem)

    @property
    def rest_lengths(self) -> list[float] | None:
        """Rest lengths [mm], one or one each."""
        return None if self.rest_length is None else row("--rest-length", self.rest_length, "mm")

    @property
    def contractions(self) -> list[float] | None:
        """Contraction ratios at 0°, one or one each."""
        return None if self.initial_contraction is None else row("--initial-contraction", self.initial_contraction, "-")

    def given(self, *names: str) -> str | None:
        """Return the first option of these names that is given, as it is written."""
        return next((f"--{name.replace('_', '-')}" for name in names if getattr(self, name) is not None), None)

    # --- of several joints ------------------------------------------------------------------------------------------

    def _changed(self, base: "Mechanism") -> "Mechanism":
        """Return `base` with everything that is given."""
        self.refuse_one_joints(*OF_ONE_JOINT)
        changes: dict[str, Any] = {}
        if self.muscle:
            changes["muscles"] = self.all_muscles(base.m)
        if self.supply is not None:
            changes["pressure_limits"] = (base.pressure_limits[0], self.supply * BAR)
        if volumes := self.volumes:
            changes["muscles"] = tuple(replace(muscle, **volumes) for muscle in changes.get("muscles", base.muscles))
        given = {"rest_length": self.rest_lengths, "initial_contraction": self.contractions}
        lengths = {name: values for name, values in given.items() if values is not None}
        if lengths:
            changes["routes"] = self._routes(base.routes, lengths)
        return replace(base, **changes) if changes else base

    def refuse_one_joints(self, *names: str) -> None:
        """Refuse these options of one joint."""
        if option := self.given(*names):
            edited = f"edit {self.machine} instead" if self.file or self.is_mujoco else f"{self.machine} has several"
            raise InvalidInput(f"{option} is for one joint with two muscles; {edited}")

    def all_muscles(self, m: int) -> tuple["Muscle", ...]:
        """Return the muscles that --muscle names, one for all `m` or one each. Raises `InvalidInput`."""
        from allocator.muscles.catalogue import named_muscle

        found = tuple(named_muscle(name) for name in self.muscle or ())
        if len(found) not in (1, m):
            raise InvalidInput(f"--muscle is given {len(found)} times; expected once, or once for each of {m}")
        return found * m if len(found) == 1 else found

    def _routes(self, base: "Routes", lengths: dict[str, list[float]]) -> "Routes":
        kind = type(base)
        known = {name: getattr(base, name) for name in signature(kind).parameters}
        if "initial_contraction" in lengths and "initial_contraction" not in known:
            raise InvalidInput(f"--initial-contraction is for pulleys; {self.machine} has {kind.__name__}")
        scale = {"rest_length": MM, "initial_contraction": 1.0}
        changed = {name: [value * scale[name] for value in values] for name, values in lengths.items()}
        return kind(**known | {name: values[0] if len(values) == 1 else values for name, values in changed.items()})

    # --- of one joint -----------------------------------------------------------------------------------------------

    def _one(self, base: "AntagonistJoint") -> "AntagonistJoint":
        joints = self.compared(base)
        if len(joints) > 1:
            raise InvalidInput("--muscle is given several times; for two different ones --agonist and --antagonist")
        return next(iter(joints.values()))

    def _joint(self, base: "AntagonistJoint", muscle: str | None) -> "AntagonistJoint":
        """Return `base` with everything that is given."""
        changes: dict[str, Any] = self._muscles(muscle)
        if changes:
            changes["covariance"] = None  # it was of the muscles in the file
        if geometry := self._geometry(base.geometry):
            changes["geometry"] = geometry
        if self.supply is not None:
            changes["pressure_limits"] = (base.pressure_limits[0], self.supply * BAR)
        if self.stops is not None:
            left, right = numbers("--stops", self.stops, 2, 2, "-90:90")
            for angle in (left, right):
                within("--stops", angle, "degrees", -360, 360)
            if not left < right:
                raise InvalidInput(f"--stops {self.stops}: the first angle has to be below the second")
            changes["angle_limits"] = (left * DEG, right * DEG)
        if self.friction is not None:
            changes |= {"friction": self.friction, "hysteresis": None}  # one says all that the other would
        if volumes := self.volumes:
            for side in ("agonist", "antagonist"):
                changes[side] = replace(changes.get(side, getattr(base, side)), **volumes)
        return replace(base, **changes) if changes else base

    @property
    def volumes(self) -> dict[str, Any]:
        """Volumes of the gas [m³] that are given."""
        given = {"rest_volume": self.rest_volume, "tube_volume": self.tube_volume}
        return {name: volume * CM3 for name, volume in given.items() if volume is not None}

    def _muscles(self, both: str | None) -> dict[str, "Muscle"]:
        from allocator.muscles.catalogue import named_muscle

        names = {"agonist": self.agonist or both, "antagonist": self.antagonist or both}
        return {side: named_muscle(name) for side, name in names.items() if name is not None}

    def _geometry(self, base: "Geometry") -> "Geometry | None":
        """Return the changed geometry; None if nothing of it is given."""
        from allocator.joint.geometry import Pulley

        lengths = self.rest_lengths, self.contractions
        if any(values is not None and len(values) > 1 for values in lengths):
            raise InvalidInput("--rest-length and --initial-contraction of a joint are one number, for both muscles")
        if self.given("radius", "initial_contraction") and not isinstance(base, Pulley):
            raise InvalidInput(
                f"--radius and --initial-contraction are for a pulley; {self.machine} has a {type(base).__name__}"
            )
        given = {
            "rest_length": None if lengths[0] is None else lengths[0][0] * MM,
            "radius": None if self.radius is None else self.radius * MM,
            "initial_contraction": None if lengths[1] is None else lengths[1][0],
        }
        changes = {name: value for name, value in given.items() if value is not None}
        return replace(base, **changes) if changes else None
