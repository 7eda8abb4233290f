"""The options that say which stiffness is meant are the same for every command: isobaric, shut, or at a frequency."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

from typer import Option

from allocator.errors import InvalidInput
from allocator.shell.options import within
from allocator.units import DEG

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from allocator.joint.gas import Stiffness, StiffnessKind

PAIR = ("agonist", "antagonist")
_STATES = {"agonist": (True, False), "antagonist": (False, True)}
_LAG = 0.1  # [s], that of a plant without one


@dataclass(frozen=True)
class StiffnessOptions:
    """Which valves are shut, or which frequency is felt, and by which push; without them pressures are held."""

    PANEL: ClassVar[str] = "Which stiffness"

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
        Option(help=f"lag of the regulators [s], for --frequency; else that of --machine's plant, or {_LAG:g}"),
    ] = None

    amplitude: Annotated[
        float | None, Option(help="stiffness that pushes by ± this meet, with the joint's hysteresis [degrees]")
    ] = None

    def meant(self, file: str | None, muscles: Sequence[str] = PAIR) -> "Stiffness":
        """Return the stiffness meant, see `kind`. Raises `InvalidInput`."""
        from allocator.joint.gas import Stiffness

        within("--amplitude", self.amplitude, "degrees", 1e-3, 180)
        amplitude = None if self.amplitude is None else self.amplitude * DEG
        return Stiffness(self.kind(file, muscles), amplitude=amplitude)

    def damping(self, file: str | None) -> float:
        """Return the viscous damping [N·m·s/rad] of the plant in a machine's `file`; 0 where there is none."""
        return float(_stored(file, "damping", 0.0))  # type: ignore[arg-type]

    def kind(self, file: str | None, muscles: Sequence[str] = PAIR) -> "StiffnessKind":
        """Return which stiffness of the `muscles` is meant, with the lags in a machine's `file` where none is given.

        Raises `InvalidInput` for valves, a frequency or a lag that cannot be.
        """
        from allocator.joint.gas import StiffnessKind

        states = ("open", "shut", *(("free", *_STATES) if tuple(muscles) == PAIR else ()))
        if self.valves not in states:
            raise InvalidInput(f"--valves {self.valves}: choose one of {', '.join(states)}")
        lag = _stored(file, "lag", _LAG) if self.frequency is not None and self.lag is None else self.lag
        return StiffnessKind.of(_STATES.get(self.valves, self.valves), self.frequency, lag, muscles)


def _stored(path: str | None, name: str, otherwise: float) -> "ArrayLike":
    """Return a number of the plant in the file, such as its lag or two lags; raises `InvalidFile` for no table."""
    from allocator.files.toml import Table

    plant = None if path is None else Table.read(path).table("plant")
    return otherwise if plant is None else plant.entries.get(name, otherwise)
