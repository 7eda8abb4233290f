"""Options of the kind of stiffness: isobaric, with shut valves, at a frequency or at an amplitude."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

from typer import Option

from allocator.errors import InvalidInput
from allocator.shell.options import within
from allocator.units import DEG

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from allocator.joint.felt import Loop
    from allocator.joint.gas import Stiffness, StiffnessKind

PAIR = ("agonist", "antagonist")
_STATES = {"agonist": (True, False), "antagonist": (False, True)}
_LAG = 0.1  # [s], that of a plant without one


@dataclass(frozen=True)
class StiffnessOptions:
    """Options of the kind of stiffness; isobaric by default."""

    PANEL: ClassVar[str] = "Kind of stiffness"

    valves: Annotated[
        str,
        Option(
            help="state of the valves: open, shut, agonist, antagonist or free; open holds the pressures "
            "(isobaric stiffness), shut traps the gas of both muscles, agonist and antagonist that of one, "
            "and free takes the best of these"
        ),
    ] = "open"
    frequency: Annotated[float | None, Option(help="frequency at which the stiffness is meant [Hz]")] = None
    lag: Annotated[
        float | None,
        Option(help=f"lag of the regulators [s], for --frequency; by default that of --machine's plant, or {_LAG:g}"),
    ] = None

    amplitude: Annotated[
        float | None,
        Option(help="amplitude of the pushes that meet the stiffness, ± [degrees]; includes the joints' hysteresis"),
    ] = None

    def meant(self, file: str | None, muscles: Sequence[str] = PAIR) -> "Stiffness":
        """Return the stiffness meant, see `kind`. Raises `InvalidInput`."""
        from allocator.joint.gas import Stiffness

        within("--amplitude", self.amplitude, "degrees", 1e-3, 180)
        kind = self.kind(file, muscles)
        if self.amplitude is None:
            return Stiffness(kind)
        loops = None if tuple(muscles) == PAIR else _loops(file)
        return Stiffness(kind, amplitude=self.amplitude * DEG, loop=loops)

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


def _loops(path: str | None) -> "list[Loop]":
    """Return the hysteresis of each joint in a machine's file. Raises `InvalidInput` without a table [friction]."""
    from allocator.files.toml import Table
    from allocator.joint.felt import Loop
    from allocator.machine_file import frictions_in

    rows = [] if path is None else frictions_in(Table.read(path))
    if not rows:
        raise InvalidInput(f"--amplitude: {path or 'the machine'} has no table [friction] with the joints' hysteresis")
    return [Loop(None, **row) for row in rows]
