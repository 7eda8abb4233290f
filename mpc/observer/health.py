"""Health is what may be broken in a joint or an arm, as `mpc.observer.diagnosis` reads it off what an observer sees,
and what to do about it.

| fault | what is seen | reaction |
|---|---|---|
| leak | pressure below what its command makes of it, and never rising | stiffen less |
| stuck valve | pressure that does not move while its command does | hold |
| supply drop | pressure that follows its command up to a ceiling common to several muscles | stiffen less |
| offset of a pressure sensor | it comes to rest beside its command, which the observer makes up for | none |
| drifting pressure sensor | departs slowly from its command, and d̂ takes back the torque of it | stiffen less |
| broken cable | d̂ jumps to minus the muscle's torque, and follows it | vent |
| silent, frozen or rejected sensor | the observer's own flags | none for a pressure, hold for the angle |
| load or drift of the angle | d̂ larger than usual loads, whatever the pressures do | hold |
| loop that rings | the angle swings at a common period, does not come to rest, and d̂ with it | hold |

Where several faults explain what is seen all of them are named: `docs/faults.md` says which, and until when.
"""

from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import NamedTuple

from allocator.units import BAR


class Reaction(IntEnum):
    """A reaction says what to do, the more urgent the larger."""

    NONE = 0
    STIFFEN_LESS = 1  # ask for less stiffness, that is for lower pressures
    HOLD = 2  # stop the motion; a loop on a bench holds for as long as it runs, and then stops safely
    VENT = 3  # let all muscles empty

    def __str__(self) -> str:
        """Say it in words."""
        return self.name.lower().replace("_", " ")


class FaultKind(StrEnum):
    """These are the kinds of faults that are told apart."""

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
    """A part is what a fault is in."""

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
    """The names of what may be broken in a machine of n joints and m muscles."""

    muscles: tuple[str, ...]  # (m,)
    sensors: tuple[str, ...]  # (n + m,), of angles and pressures
    joints: tuple[str, ...]  # (n,)
    loops: tuple[str, ...]  # (n,)

    @classmethod
    def of(cls, joints: tuple[str, ...], muscles: tuple[str, ...]) -> "Parts":
        """Return those of a machine whose `joints` and `muscles` have these names."""
        angles = tuple(f"{Part.ANGLE} of {name}" for name in joints)
        pressures = tuple(f"pressure of {name}" for name in muscles)
        return cls(muscles, (*angles, *pressures), joints, tuple(f"{Part.LOOP} of {name}" for name in joints))


PARTS = Parts(MUSCLES, SENSORS, (Part.JOINT,), (Part.LOOP,))
"""Those of one joint with two muscles."""

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
    """A suspect is a fault, and what it is in."""

    fault: FaultKind
    part: str  # a `Part` of a joint, one of the `Parts` of an arm
    size: float = 0.0  # of an offset [Pa]

    @property
    def reaction(self) -> Reaction:
        """Return what to do if it is this: without its angle a joint had better not move."""
        return Reaction.HOLD if self.part.startswith(Part.ANGLE) else _REACTIONS[self.fault]

    def __str__(self) -> str:
        """Say it in words."""
        size = f", {self.size / BAR:+.2f} bar" if self.fault is FaultKind.OFFSET else ""
        return f"{self.fault} ({self.part}{size})"


class Finding(NamedTuple):
    """A finding is something that is wrong: one of the `suspects`, which what was seen does not tell apart."""

    suspects: tuple[Suspect, ...]
    since: float  # [s] since the observer's reset
    advice: str = ""  # the usual cause, and which number to change

    def __str__(self) -> str:
        """Say it in words."""
        found = " or ".join(map(str, self.suspects)) + f" since {self.since:.2f} s"
        return f"{found} ({self.advice})" if self.advice else found


@dataclass(frozen=True)
class Health:
    """Health says what is wrong with a joint at one moment."""

    findings: tuple[Finding, ...] = ()  # each with a cause of its own

    @property
    def well(self) -> bool:
        """Return whether nothing is suspected."""
        return not self.findings

    @property
    def suspects(self) -> tuple[Suspect, ...]:
        """Return all that is suspected."""
        return tuple(suspect for finding in self.findings for suspect in finding.suspects)

    @property
    def ringing(self) -> Finding | None:
        """Return the finding that the loop rings, if it does."""
        return next((one for one in self.findings if one.suspects[0].fault is FaultKind.RINGING), None)

    @property
    def reaction(self) -> Reaction:
        """Return the most urgent one that a suspect asks for: what is not told apart is taken for the worse."""
        return max((suspect.reaction for suspect in self.suspects), default=Reaction.NONE)

    def __str__(self) -> str:
        """Say it in one sentence."""
        if self.well:
            return "Nothing is suspected."
        return "; ".join(map(str, self.findings)) + f": {self.reaction}."


WELL = Health()
