"""Plants as TOML files: a joint's file (see `allocator.joint.storage`) with one table more:

[plant]                        # SI units; what is left out is as in `Plant()`
inertia = 0.05                 # [kg·m²]
damping = 0.1                  # [N·m·s/rad]
lag = [0.1, 0.1]               # [s], or one number for both pressures
gravity_torque = 0.0           # m g l [N·m]
slew = 500000.0                # [Pa/s]
"""

from dataclasses import fields
from os import PathLike
from typing import Any

from allocator.errors import InvalidFile, InvalidInput
from allocator.files.atomic import write_text
from allocator.joint import storage as joint_storage
from allocator.muscles import storage
from mpc.model.plant import Plant

FilePath = str | PathLike[str]

NUMBERS = tuple(f.name for f in fields(Plant) if f.name != "joint")


def save_plant(plant: Plant, path: FilePath) -> None:
    """Write `plant` to `path`, for every command's --joint and for `Plant.load`."""
    lines = (f"{name} = {storage.toml(getattr(plant, name))}" for name in NUMBERS)
    text = "\n".join(["[plant]  # SI units: kg·m², N·m·s/rad, s, N·m, Pa/s", *lines])
    write_text(path, f"{joint_storage.dumps(plant.joint)}\n{text}\n")


def load_plant(path: FilePath) -> Plant:
    """Read a plant; a joint's file without [plant] is one with the numbers of `Plant()`. Raises `InvalidFile`."""
    content = storage.read(path)
    joint = joint_storage.joint_from(path, content)
    try:
        return Plant(joint, **_numbers(path, content))
    except (InvalidInput, TypeError, OverflowError) as error:
        raise InvalidFile(path, f"[plant]: {error}") from None


def stored_numbers(path: FilePath) -> dict[str, Any]:
    """The numbers of `Plant` that the file gives, by name."""
    return _numbers(path, storage.read(path))


def _numbers(path: FilePath, content: dict[str, Any]) -> dict[str, Any]:
    table = content.get("plant", {})
    if not isinstance(table, dict):
        raise InvalidFile(path, "[plant] has to be a table")
    if surplus := table.keys() - set(NUMBERS):
        raise InvalidFile(path, f"[plant] has no {', '.join(sorted(surplus))}; it has {', '.join(NUMBERS)}")
    return {name: tuple(value) if isinstance(value, list) else value for name, value in table.items()}


__all__ = ["NUMBERS", "load_plant", "save_plant", "stored_numbers"]
