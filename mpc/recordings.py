"""Runs as NPZ: everything of a run in SI units, plant included, without pickle. NumPy alone opens it too."""

from dataclasses import fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from zipfile import BadZipFile
from zlib import error as Damaged  # noqa: N812  # it has no other name

import numpy as np

from allocator.errors import InvalidFile, InvalidInput
from allocator.joint_storage import load_joint, save_joint
from mpc.plant import NU, NX, Plant
from mpc.simulation import Run

_NUMBERS = ("inertia", "damping", "lag", "gravity_torque", "slew")  # of the plant, besides its joint
_ARRAYS = tuple(f.name for f in fields(Run) if f.name != "plant")


def save_recording(run: Run, path: str | Path) -> None:
    """Write `run`: its arrays by the names they have in `Run`, and the plant as `joint` (TOML) and `plant_…`."""
    values: dict[str, Any] = {name: getattr(run, name) for name in _ARRAYS}
    values |= {f"plant_{name}": getattr(run.plant, name) for name in _NUMBERS}
    with TemporaryDirectory() as directory:
        joint = Path(directory) / "joint.toml"
        save_joint(run.plant.joint, joint)
        values["joint"] = joint.read_text(encoding="utf-8")
    with Path(path).open("wb") as file:  # given a name, NumPy would add a suffix
        np.savez_compressed(file, **values)


def load_recording(path: str | Path) -> Run:
    """Read what `save_recording` wrote. Raises `InvalidFile` if it is something else."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            stored = dict(archive)
    except OSError as error:
        raise InvalidFile(path, f"cannot be read ({error.strerror or error})") from None
    except (ValueError, BadZipFile, Damaged, EOFError, AttributeError, TypeError):
        raise InvalidFile(path, "is not an NPZ file") from None
    if missing := {*_ARRAYS, "joint", *(f"plant_{name}" for name in _NUMBERS)} - stored.keys():
        raise InvalidFile(path, f"is not the recording of a run: {', '.join(sorted(missing))} missing")
    arrays: dict[str, Any] = {name: stored[name] for name in _ARRAYS}
    steps = arrays["step_time"].size
    for name, array in arrays.items():
        if array.shape != (expected := _shape(name, steps)):
            raise InvalidFile(
                path, f"is not the recording of a run: {name} has the shape {array.shape}, not {expected}"
            )
    plain = {"dt": float(stored["dt"]), "implementation": str(stored["implementation"])}
    return Run(_plant(path, stored), **(arrays | plain))


def _shape(name: str, steps: int) -> tuple[int, ...]:
    """What `Run` says of the array called `name`."""
    if name in ("dt", "implementation"):
        return ()
    length = steps + 1 if name in ("t", "x", "theta_ref", "K_ref", "K", "forces") else steps
    width = {"x": NX, "estimate": NX + 1, "u": NU, "forces": NU, "moved": 3}.get(name)
    return (length,) if width is None else (length, width)


def _plant(path: str | Path, stored: dict[str, Any]) -> Plant:
    with TemporaryDirectory() as directory:
        joint = Path(directory) / "joint.toml"
        joint.write_text(str(stored["joint"]), encoding="utf-8")
        numbers: dict[str, Any] = {name: stored[f"plant_{name}"].tolist() for name in _NUMBERS}
        try:
            return Plant(load_joint(joint), **(numbers | {"lag": tuple(numbers["lag"])}))
        except (InvalidInput, InvalidFile, TypeError) as error:
            raise InvalidFile(path, f"does not hold a plant ({error})") from None


__all__ = ["load_recording", "save_recording"]
