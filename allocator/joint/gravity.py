"""Torque of a link's weight about its joint, positive where it pulls θ down:

    T_g = G sin(θ - θ_h),    ∂T_g/∂θ = G cos(θ - θ_h)

with the amplitude G = m g l and the angle θ_h at which the link hangs. A joint's muscles balance it; its stiffness K is
that of the muscles alone, and the link at rest feels K + ∂T_g/∂θ.
"""

from dataclasses import dataclass
from math import atan2, hypot

from allocator import checks
from allocator.calculus import Value, cos, sin
from allocator.files.toml import Table
from allocator.units import DEG


@dataclass(frozen=True)
class Gravity:
    """Gravity of a link on one joint. Immutable. Raises `InvalidInput` for numbers that are not finite."""

    torque: float = 0.0  # G [N·m]; negative: the link stands at `hanging`
    hanging: float = 0.0  # θ_h [rad]

    def __post_init__(self) -> None:
        """Convert the numbers to plain floats and check them."""
        object.__setattr__(self, "torque", checks.number("gravity_torque", self.torque, "N·m"))
        angle = checks.angle("hanging_angle", checks.number("hanging_angle", self.hanging, "rad"))
        object.__setattr__(self, "hanging", float(angle))

    @classmethod
    def of_file(cls, file: Table) -> "Gravity":
        """Return the gravity in the table [plant] of a parsed file, none without it. Raises `InvalidFile`."""
        table = file.table("plant")
        if table is None:
            return cls()
        values = {name: table.entries.get(key, 0.0) for name, key in zip(("torque", "hanging"), FILED, strict=True)}
        return Table(table.path, values, table.name).made(cls)

    @classmethod
    def of_parts(cls, A: float, B: float) -> "Gravity":
        """Return the gravity A sin θ - B cos θ; A and B in N·m."""
        return cls(hypot(A, B), atan2(B, A)) if A or B else cls()

    @property
    def filed(self) -> dict[str, float]:
        """The entries of [plant], none without gravity."""
        return dict(zip(FILED, (self.torque, self.hanging), strict=True)) if self.torque else {}

    def __str__(self) -> str:
        """Return the amplitude, and the angle at which the link hangs unless it is 0."""
        turned = f" of a link that hangs at {self.hanging / DEG:.3g}°" if self.torque and self.hanging else ""
        return f"{self.torque:g} N·m{turned}"

    def moment(self, theta: Value) -> Value:
        """Return T_g [N·m] at the angles `theta` [rad]."""
        return self.torque * sin(theta - self.hanging)

    def stiffness(self, theta: Value) -> Value:
        """Return ∂T_g/∂θ [N·m/rad] at the angles `theta` [rad], which adds to the stiffness of the muscles."""
        return self.torque * cos(theta - self.hanging)


FILED = "gravity_torque", "hanging_angle"  # in the table [plant] [N·m], [rad]
NO_GRAVITY = Gravity()
