"""Plants are kept as TOML files: a joint's file (see `allocator.joint.storage`) with one table more:

[plant]                        # SI units; what is left out is as in `Plant()`
inertia = 0.05                 # [kg·m²]
damping = 0.1                  # [N·m·s/rad]
lag = [0.1, 0.1]               # [s], or one number for both pressures
gravity_torque = 0.0           # m g l [N·m]
slew = 500000.0                # [Pa/s]
gas = true                     # reckon with the joint's gas, see its table [gas]; or without this line
frequency = 0.0                # at which the stiffness is meant [Hz], 0 isobaric; or without this line

and another one of what the pressures do besides, which is read by `Compensation.load` and commands. The joint's own
[hysteresis] counts, too.

[regulators]
dead_time = 0.0                # of the commands [s]
dead_band = 0.0                # [Pa], total
lag_up = 0.08                  # of a rising pressure [s], and
lag_down = 0.12                # of a falling one; or without these lines (0 is read as unknown, too)
flow = 500000.0                # fastest change of a pressure [Pa/s]; or without this line

Observers and controllers predict with the lag of [plant]; the last three shape simulated plants.
"""

from collections.abc import Collection, Mapping
from os import PathLike
from typing import Any

from allocator import checks
from allocator.errors import InvalidFile, InvalidInput
from allocator.files.atomic import write_text
from allocator.joint import storage as joint_storage
from allocator.joint.antagonist import AntagonistJoint
from allocator.muscles import storage

FilePath = str | PathLike[str]

_REGULATORS = ("dead_time", "dead_band", "lag_up", "lag_down", "flow")
_LAGS = ("lag_up", "lag_down")


def save_plant(path: FilePath, joint: AntagonistJoint, numbers: Mapping[str, Any]) -> None:
    """Write a joint and the numbers of its plant to `path`, for every command's --joint and for `Plant.load`."""
    lines = (f"{name} = {storage.toml(number)}" for name, number in numbers.items())
    text = "\n".join(["[plant]  # SI units: kg·m², N·m·s/rad, s, N·m, Pa/s", *lines])
    write_text(path, f"{joint_storage.dumps(joint)}\n{text}\n")


def load_plant(
    path: FilePath, names: Collection[str], *, scale_needed: bool = True
) -> tuple[AntagonistJoint, dict[str, Any]]:
    """Read a joint, and those of the numbers called `names` that the file gives. Raises `InvalidFile`."""
    content = storage.read(path)
    joint = joint_storage.joint_from(path, content, scale_needed=scale_needed)
    return joint, _numbers(path, content, names)


def stored_numbers(path: FilePath, names: Collection[str]) -> dict[str, Any]:
    """Read those of the numbers called `names` that the file gives, whatever its joint. Raises `InvalidFile`."""
    return _numbers(path, storage.read(path), names)


def stored_regulators(path: FilePath) -> dict[str, Any]:
    """Read the numbers of the regulators that the file gives, whatever its joint. Raises `InvalidFile`."""
    table = _numbers(path, storage.read(path), _REGULATORS, "regulators")
    try:
        for name in _LAGS:
            checks.not_negative(name, table.get(name, 0.0), "s")
    except InvalidInput as error:
        raise InvalidFile(path, f"[regulators]: {error}") from None
    return {name: value for name, value in table.items() if value or name not in _LAGS}


def _numbers(path: FilePath, content: dict[str, Any], names: Collection[str], where: str = "plant") -> dict[str, Any]:
    table = content.get(where, {})
    if not isinstance(table, dict):
        raise InvalidFile(path, f"[{where}] has to be a table")
    if surplus := table.keys() - set(names):
        raise InvalidFile(path, f"[{where}] has no {', '.join(sorted(surplus))}; it has {', '.join(names)}")
    return {name: tuple(value) if isinstance(value, list) else value for name, value in table.items()}
