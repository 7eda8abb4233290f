"""The options that say which stiffness is meant are the same for every command: isobaric, shut, or at a frequency."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from allocator.errors import InvalidFile, InvalidInput

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
    lag: Annotated[
        float | None,
        Option(help=f"lag of the pressure regulators [s], for --frequency; else that of --joint's plant, or {_LAG:g}"),
    ] = None

    def kind(self, joint: Path | None) -> "StiffnessKind":
        """Return which stiffness is meant, with the lags in the file `joint` where none is given.

        Raises `InvalidInput` for valves, a frequency or a lag that cannot be.
        """
        from allocator.joint.gas import StiffnessKind

        states = ("open", "shut", "free", *_STATES)
        if self.valves not in states:
            raise InvalidInput(f"--valves {self.valves}: choose one of {', '.join(states)}")
        lag = _stored_lag(joint) if self.frequency is not None and self.lag is None else self.lag
        return StiffnessKind.of(_STATES.get(self.valves, self.valves), self.frequency, lag)


def _stored_lag(path: Path | None) -> Any:
    """Return the lag or the two lags [s] of the plant in the file; raises `InvalidFile` if [plant] is no table."""
    from allocator.muscles import storage

    plant = {} if path is None else storage.read(path).get("plant", {})
    if not isinstance(plant, dict):
        raise InvalidFile(str(path), "[plant] has to be a table")
    return plant.get("lag", _LAG)
