"""The options that say which stiffness is meant are the same for every command: isobaric, shut, or at a frequency."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from typer import Option

from allocator.errors import InvalidInput

if TYPE_CHECKING:
    from allocator.joint.gas import StiffnessKind

_STATES = {"agonist": (True, False), "antagonist": (False, True)}
_LAG = 0.1  # [s], that of a plant without one


@dataclass(frozen=True)
class StiffnessOptions:
    """The options are which valves are shut, or which frequency is felt; without them pressures are held."""

    valves: Annotated[
        str,
        Option(
            help="open: isobaric stiffness, pressures are held; shut: with the gas of both muscles trapped, or of the "
            "agonist or the antagonist alone; free: whichever valves serve best"
        ),
    ] = "open"
    frequency: Annotated[float | None, Option(help="stiffness that motions at this frequency meet [Hz]")] = None
    lag: Annotated[float | None, Option(help=f"lag of the pressure regulators [s], for --frequency; {_LAG:g}")] = None

    @property
    def kind(self) -> "StiffnessKind":
        """Return which stiffness is meant. Raises `InvalidInput` for valves, a frequency or a lag that cannot be."""
        from allocator.joint.gas import StiffnessKind

        states = ("open", "shut", "free", *_STATES)
        if self.valves not in states:
            raise InvalidInput(f"--valves {self.valves}: choose one of {', '.join(states)}")
        lag = _LAG if self.frequency is not None and self.lag is None else self.lag
        return StiffnessKind.of(_STATES.get(self.valves, self.valves), self.frequency, lag)


__all__ = ["StiffnessOptions"]
