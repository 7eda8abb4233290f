"""File of a fitted joint: the fit, and what the user's file or options say of the joint besides.

Limits of angle and supply, the gas and the tables of other commands are the user's. Where nothing is said, the limits
are those that the rests visited, and the file reports it in [source].
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

from allocator.files.toml import Table, section
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.gravity import FILED, Gravity
from allocator.machine_file import dumps, joint_from
from allocator.muscles import Muscle
from allocator.units import BAR, DEG

_KEPT = "plant", "regulators", "sensors"  # tables of other commands
_GAS = "inner_radius", "rest_volume", "tube_volume"  # fields of a muscle that no fit to rests changes


@dataclass(frozen=True)
class Said:
    """What is known of a joint besides its fit."""

    joint: AntagonistJoint | None = None  # of the user's file
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # pressure_limits [Pa], angle_limits [rad]
    tables: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # of the file, for other commands

    @classmethod
    def of(
        cls, file: Table | None, stops: tuple[float, float] | None = None, supply: tuple[float, float] | None = None
    ) -> Self:
        """Return the content of a parsed file, with other `stops` [rad] and `supply` [Pa] if given.

        Raises `InvalidFile`.
        """
        given = {name: ends for name, ends in (("angle_limits", stops), ("pressure_limits", supply)) if ends}
        if file is None:
            return cls(limits=given)
        joint, machine = joint_from(file, scale_needed=False), file.needed("machine", "a joint")
        stated = {n: getattr(joint, n) for n in ("angle_limits", "pressure_limits") if n in machine.entries}
        tables = {name: dict(table.entries) for name in _KEPT if (table := file.table(name)) is not None}
        return cls(joint, stated | given, tables)

    def about(self, fitted: AntagonistJoint) -> AntagonistJoint:
        """Return the `fitted` joint with the limits, the gas and the hysteresis that are known."""
        ends: dict[str, Any] = dict(self.limits)
        changed = replace(fitted, **ends)
        if self.joint is None:
            return changed
        one, two = self.joint.agonist, self.joint.antagonist
        return replace(
            changed,
            agonist=_filled(fitted.agonist, one),
            antagonist=_filled(fitted.antagonist, two),
            min_contraction=min(fitted.min_contraction, self.joint.min_contraction),
            gas=self.joint.gas,
            hysteresis=self.joint.hysteresis,
        )

    def visited(self, fitted: AntagonistJoint) -> str:
        """Return a sentence on the limits of the `fitted` joint that only its rests give; "" if all are known."""
        low, high = (end / DEG for end in fitted.angle_range)
        words = {
            "angle_limits": f"its angles of {low:.3g}° to {high:.3g}°",
            "pressure_limits": f"its supply of {fitted.pressure_limits[1] / BAR:.3g} bar",
        }
        missing = [said for name, said in words.items() if name not in self.limits]
        return f"the joint's limits are those of the rests: {' and '.join(missing)}" if missing else ""

    def text(
        self, fitted: AntagonistJoint, gravity: Gravity, scale_known: bool, source: Mapping[str, str | float]
    ) -> str:
        """Return the file of the `fitted` joint in TOML; `gravity` replaces that of the user's file."""
        visited = self.visited(fitted)
        told = {**source, "limits": visited} if visited else source
        plant = {name: value for name, value in self.tables.get("plant", {}).items() if name not in FILED}
        tables = {**self.tables, "plant": plant | gravity.filed}
        lines = [dumps(self.about(fitted), scale_known=scale_known, source=told).rstrip("\n")]
        for name, entries in tables.items():
            plain = {key: tuple(value) if isinstance(value, list) else value for key, value in entries.items()}
            lines += section(name, plain) if plain else []
        return "\n".join(lines) + "\n"


def _filled(fitted: Muscle, given: Muscle) -> Muscle:
    """Return the `fitted` muscle with the gas that is said of the `given` one."""
    said = {name: value for name in _GAS if (value := getattr(given, name))}
    return replace(fitted, **said)


NOTHING_SAID = Said()
