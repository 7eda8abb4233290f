"""TOML files of plants: a machine's file (see `allocator.machine_file`) with one more table:

[plant]                        # SI units; defaults are those of `Plant()`
inertia = 0.05                 # [kg·m²]
damping = 0.1                  # [N·m·s/rad]
lag = [0.1, 0.1]               # [s], or one number for both pressures; means of rising and falling pressures
venting = 1.0                  # lag of a falling pressure over that of a rising one; by default lag_down / lag_up
gravity_torque = 0.0           # m g l [N·m]
hanging_angle = 0.0            # of the link [rad]; where it stands if gravity_torque is negative
slew = 500000.0                # [Pa/s]
gas = true                     # motion compresses the gas in the muscles, see [gas]; false: it does not
frequency = 0.0                # of the stiffness with gas [Hz]; 0 isobaric

and tables of the regulators and sensors, which `Compensation.load` and commands read, like the joint's own
[hysteresis].

[regulators]
dead_time = 0.0                # of the commands [s]
dead_band = 0.0                # [Pa], total
lag_up = 0.08                  # of a rising pressure [s], the geometric mean of both muscles (their ratio is that of
lag_down = 0.12                # `lag`), and of a falling one; optional lines (0 is read as unknown as well)
flow = 500000.0                # fastest change of a pressure [Pa/s]; optional

[sensors]
reading_age = 0.0              # of the angle's readings [s]

Observers and controllers of a joint predict with the lag of [plant] and the ratio of lag_down to lag_up. Simulated
plants have lag_up, lag_down and flow themselves. If both lags are there, the diagnosis of faults has narrower limits.
"""

from collections.abc import Collection, Mapping
from typing import Any

from allocator import checks
from allocator.errors import InvalidInput
from allocator.files.atomic import write_text
from allocator.files.text import FilePath
from allocator.files.toml import Table, section
from allocator.joint.antagonist import AntagonistJoint
from allocator.machine_file import dumps, joint_from
from mpc.model.pressures import ratio

_REGULATORS = ("dead_time", "dead_band", "lag_up", "lag_down", "flow")
_SENSORS = ("reading_age",)
_LAGS = ("lag_up", "lag_down")


def save_plant(path: FilePath, joint: AntagonistJoint, numbers: Mapping[str, object]) -> None:
    """Write a joint and the numbers of its plant to `path`, for --machine of all commands and for `Plant.load`."""
    plant = section("plant", numbers, "SI units: kg·m², N·m·s/rad, s, N·m, Pa/s")
    write_text(path, dumps(joint) + "\n".join(plant) + "\n")


def load_plant(
    path: FilePath, names: Collection[str], *, scale_needed: bool = True
) -> tuple[AntagonistJoint, dict[str, Any]]:
    """Read a joint, and those of the numbers `names` that the file contains. Raises `InvalidFile`."""
    file, told = Table.read(path), stored_regulators(path)
    venting = {"venting": ratio(told["lag_up"], told["lag_down"])} if told.keys() >= set(_LAGS) else {}
    return joint_from(file, scale_needed=scale_needed), venting | numbers_in(file, names)


def numbers_in(file: Table, names: Collection[str], where: str = "plant") -> dict[str, Any]:
    """Return those of the numbers `names` that a file contains in its table `where`. Raises `InvalidFile`."""
    table = file.table(where)
    if table is None:
        return {}
    table.only(names)
    return {name: tuple(value) if isinstance(value, list) else value for name, value in table.entries.items()}


def stored_regulators(path: FilePath) -> dict[str, Any]:
    """Read the numbers of regulators and sensors in a file, for any joint. Raises `InvalidFile`."""
    file = Table.read(path)
    found = numbers_in(file, _REGULATORS, "regulators") | numbers_in(file, _SENSORS, "sensors")
    for where, names in (("regulators", _LAGS), ("sensors", _SENSORS)):
        try:
            for name in names:
                checks.not_negative(name, found.get(name, 0.0), "s")
        except InvalidInput as error:
            raise Table(path, {}, where).fault(error) from None
    return {name: value for name, value in found.items() if value or name not in _LAGS}
