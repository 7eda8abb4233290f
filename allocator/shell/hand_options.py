"""Options of the posture and the hand of several joints; in degrees, millimetres and N."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar, NamedTuple

import numpy as np
from typer import Option

from allocator.errors import InvalidInput
from allocator.shell.options import row, within
from allocator.units import DEG, MM

if TYPE_CHECKING:
    from allocator.calculus import Array
    from allocator.mechanism.endpoint import Endpoint
    from allocator.mechanism.mechanism import Mechanism


class Hand(NamedTuple):
    """Hand of --links and its force of --push."""

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
    push: Annotated[str | None, Option(help="force that the hand exerts, such as 5,0 [N]; 0 by default")] = None

    def __post_init__(self) -> None:
        if self.links is None:
            for option, value in (("--links-at-zero", self.links_at_zero), ("--push", self.push)):
                if value is not None:
                    raise InvalidInput(f"{option} goes with --links, which say where the hand is")

    def none(self) -> None:
        """Insist that nothing is said of several joints. Raises `InvalidInput`."""
        for option, value in (("--links", self.links), ("--posture", self.posture)):
            if value is not None:
                raise InvalidInput(f"{option} goes with a --machine of several joints; a joint has --theta")

    def angles(self, mechanism: "Mechanism") -> "Array":
        """Return the posture (n,) [rad]. Raises `InvalidInput`."""
        n, names = mechanism.n, ", ".join(mechanism.joint_names)
        if self.posture is None:
            raise InvalidInput(
                f"{names} need --posture, {n} angles [degrees], such as {','.join(['10'] * n)}, instead of --theta"
            )
        return np.array(_angles("--posture", self.posture, {n: f"the angles of {names}"})) * DEG

    def hand(self, mechanism: "Mechanism") -> Hand | None:
        """Return the hand, if the options say where it is. Raises `InvalidInput`."""
        from allocator.mechanism.endpoint import Endpoint

        if self.links is None:
            return None
        n = {mechanism.n: "one a link"}
        lengths = np.array(row("--links", self.links, "mm", n))
        within("--links", float(lengths.min()), "mm", 1, 10_000)
        within("--links", float(lengths.max()), "mm", 1, 10_000)
        angles = [0.0] if self.links_at_zero is None else _angles("--links-at-zero", self.links_at_zero, n)
        push = [0.0, 0.0] if self.push is None else row("--push", self.push, "N", {2: "its x and y"})
        at_zero = np.broadcast_to(np.array(angles), lengths.shape) * DEG
        return Hand(Endpoint.planar(lengths * MM, at_zero), np.array(push))


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
