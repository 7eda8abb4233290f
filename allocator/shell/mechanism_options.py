"""The options that describe a mechanism and its hand are the same for every command, in degrees, millimetres and N."""

from dataclasses import dataclass
from typing import Annotated

from typer import Option

from allocator.errors import InvalidInput
from allocator.shell.joint_options import JointOptions
from allocator.shell.stiffness_options import StiffnessOptions


@dataclass(frozen=True)
class MechanismOptions:
    """The options are what the user says of a mechanism, instead of a joint; numbers have commas between them."""

    mechanism: Annotated[
        str | None, Option(help="instead of a joint: arm26, arm48, leg37, or a mechanism in a TOML file")
    ] = None
    posture: Annotated[str | None, Option(help="of a mechanism: its joint angles, such as 23,-17 [degrees]")] = None
    links: Annotated[
        str | None,
        Option(help="of a mechanism in the plane: the lengths of its links, such as 300,250 [mm]; for its hand"),
    ] = None
    links_at_zero: Annotated[
        str | None, Option(help="angle of each link to the one before, where the posture is 0 [degrees]; 0")
    ] = None
    push: Annotated[str | None, Option(help="force that the hand exerts, such as 5,0 [N]; 0")] = None

    def __post_init__(self) -> None:
        """Refuse what needs another option."""
        if self.mechanism is None:
            for option, value in (("--links", self.links), ("--posture", self.posture)):
                if value is not None:
                    raise InvalidInput(f"{option} goes with --mechanism; a joint needs --theta")
        if self.links is None:
            for option, value in (("--links-at-zero", self.links_at_zero), ("--push", self.push)):
                if value is not None:
                    raise InvalidInput(f"{option} goes with --links, which say where the hand is")

    def alone(self, joint: JointOptions, stiffness: StiffnessOptions, theta: object) -> None:
        """Insist that nothing is said of a joint. Raises `InvalidInput`."""
        if theta is not None:
            raise InvalidInput("--theta is of a joint; a mechanism has a --posture")
        if stiffness != StiffnessOptions():
            raise InvalidInput(
                "--valves, --frequency and --lag are of a joint: with a mechanism K is isobaric here; "
                "allocate() in Python takes valves, frequency and lag, too"
            )
        if joint != JointOptions():
            raise InvalidInput(
                "--mechanism goes without the options of a joint; a mechanism's muscles stand in its file"
            )
