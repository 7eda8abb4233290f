"""Health of a joint or an arm: the faults that `mpc.observer.diagnosis` suspects, and the reactions to them.

| fault | observation | reaction |
|---|---|---|
| leak | pressure below that of its command, which does not rise or loses a constant share | stiffen less |
| stuck valve | pressure that does not move while its command does | hold |
| supply drop | pressure that follows its command up to a ceiling common to several muscles | stiffen less |
| offset of a pressure sensor | it settles at a distance from its command, which the observer compensates | none |
| drifting pressure sensor | slow departure from its command, and d̂ cancels the torque of it | stiffen less |
| broken cable | d̂ jumps to minus the muscle's torque, and follows it | vent |
| silent, frozen or rejected sensor | the observer's own flags | none for a pressure, hold for the angle |
| load or drift of the angle | d̂ larger than usual loads, for any pressures | hold |
| loop that rings | the angle swings at a common period, does not come to rest, and d̂ with it | hold |

If several faults explain the observations, all of them are reported; `docs/faults.md` lists which, and until when.
"""

from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import NamedTuple

from allocator.units import BAR


class Reaction(IntEnum):
    """Reaction to a fault; larger values are more urgent."""

    NONE = 0
    STIFFEN_LESS = 1  # command less stiffness, that is lower pressures
    HOLD = 2  # stop the motion; a loop on a bench holds while it runs, and then stops safely
    VENT = 3  # vent all muscles

    def __str__(self) -> str:
        """Return it in words."""
        return self.name.lower().replace("_", " ")


class FaultKind(StrEnum):
    """Kind of fault."""

    LEAK = "leak"
    STUCK_VALVE = "stuck valve"
    SUPPLY_DROP = "supply drop"
    DRIFTING_SENSOR = "drifting sensor"
    BROKEN_CABLE = "broken cable"
    SILENT_SENSOR = "silent sensor"
    FROZEN_SENSOR = "frozen sensor"
    REJECTED_SENSOR = "rejected sensor"
    LOAD = "load"
    RINGING = "ringing"
    OFFSET = "offset"


class Part(StrEnum):
    """Part of a joint that may have a fault."""

    MUSCLE_1 = "muscle 1"
    MUSCLE_2 = "muscle 2"
    SUPPLY = "supply"
    ANGLE = "angle"
    P1 = "P1"
    P2 = "P2"
    JOINT = "joint"
    LOOP = "loop"


MUSCLES = Part.MUSCLE_1, Part.MUSCLE_2
SENSORS = Part.ANGLE, Part.P1, Part.P2


class Parts(NamedTuple):
    """Names of the parts that may have a fault, in a machine of n joints and m muscles."""

    muscles: tuple[str, ...]  # (m,)
    sensors: tuple[str, ...]  # (n + m,), of angles and pressures
    joints: tuple[str, ...]  # (n,)
    loops: tuple[str, ...]  # (n,)

    @classmethod
    def of(cls, joints: tuple[str, ...], muscles: tuple[str, ...]) -> "Parts":
        """Return the parts of a machine with these names of `joints` and `muscles`."""
        angles = tuple(f"{Part.ANGLE} of {name}" for name in joints)
        pressures = tuple(f"pressure of {name}" for name in muscles)
        return cls(muscles, (*angles, *pressures), joints, tuple(f"{Part.LOOP} of {name}" for name in joints))


PARTS = Parts(MUSCLES, SENSORS, (Part.JOINT,), (Part.LOOP,))
"""Parts of one joint with two muscles."""

_REACTIONS = {
    FaultKind.LEAK: Reaction.STIFFEN_LESS,
    FaultKind.STUCK_VALVE: Reaction.HOLD,
    FaultKind.SUPPLY_DROP: Reaction.STIFFEN_LESS,
    FaultKind.DRIFTING_SENSOR: Reaction.STIFFEN_LESS,
    FaultKind.BROKEN_CABLE: Reaction.VENT,
    FaultKind.SILENT_SENSOR: Reaction.NONE,
    FaultKind.FROZEN_SENSOR: Reaction.NONE,
    FaultKind.REJECTED_SENSOR: Reaction.NONE,
    FaultKind.LOAD: Reaction.HOLD,
    FaultKind.RINGING: Reaction.HOLD,
    FaultKind.OFFSET: Reaction.NONE,
}


class Suspect(NamedTuple):
    """Suspected fault and its part."""

    fault: FaultKind
    part: str  # a `Part` of a joint, one of the `Parts` of an arm
    size: float = 0.0  # of an offset [Pa]

    @property
    def reaction(self) -> Reaction:
        """Reaction to this fault: a joint must not move without its angle."""
        return Reaction.HOLD if self.part.startswith(Part.ANGLE) else _REACTIONS[self.fault]

    def __str__(self) -> str:
        """Return it in words."""
        size = f", {self.size / BAR:+.2f} bar" if self.fault is FaultKind.OFFSET else ""
        return f"{self.fault} ({self.part}{size})"


class Finding(NamedTuple):
    """Detected fault: one of the `suspects`, which the observations do not distinguish."""

    suspects: tuple[Suspect, ...]
    since: float  # [s] since the observer's reset
    advice: str = ""  # the usual cause, and the number to change

    def __str__(self) -> str:
        """Return it in words."""
        found = " or ".join(map(str, self.suspects)) + f" since {self.since:.2f} s"
        return f"{found} ({self.advice})" if self.advice else found


@dataclass(frozen=True)
class Health:
    """Faults of a machine at one moment."""

    findings: tuple[Finding, ...] = ()  # with independent causes

    @property
    def well(self) -> bool:
        """Whether nothing is suspected."""
        return not self.findings

    @property
    def suspects(self) -> tuple[Suspect, ...]:
        """All suspected faults."""
        return tuple(suspect for finding in self.findings for suspect in finding.suspects)

    @property
    def ringing(self) -> Finding | None:
        """Finding of a ringing loop, if there is one."""
        return next((one for one in self.findings if one.suspects[0].fault is FaultKind.RINGING), None)

    @property
    def reaction(self) -> Reaction:
        """Most urgent reaction of all suspects, since the worst of indistinguishable faults is assumed."""
        return max((suspect.reaction for suspect in self.suspects), default=Reaction.NONE)

    def __str__(self) -> str:
        """Return one sentence."""
        if self.well:
            return "Nothing is suspected."
        return "; ".join(map(str, self.findings)) + f": {self.reaction}."


WELL = Health()
