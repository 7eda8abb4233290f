"""Trajectories and runs as CSV (degrees, bar, N·m/rad), runs as NPZ (SI, including the plant) and MCAP, and a command's
trajectory.

NPZ files do not use pickle; NumPy alone can open them. MCAP files have one channel of JSON messages with a schema,
which Foxglove and PlotJuggler plot.
"""

import json
from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from lzma import LZMAError
from pathlib import Path
from typing import Any
from zipfile import BadZipFile
from zlib import error as Damaged  # noqa: N812  # it has no other name

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks, machine_file
from allocator.calculus import Array
from allocator.errors import InvalidFile, InvalidInput
from allocator.files import toml
from allocator.files.atomic import replacing
from allocator.units import DEG
from mpc.model.arm.model import Arm
from mpc.model.arm.storage import arm_from, arm_text
from mpc.model.machine import Machine
from mpc.model.plant import NUMBERS, Plant
from mpc.trials.motions.motion_files import JOINT_STIFFNESS, MotionColumns
from mpc.trials.motions.reference import Reference
from mpc.trials.motions.trajectories import TRAJECTORIES, shrunk, usual_stiffness
from mpc.trials.simulation import Run

COLUMNS = ("t", "theta_deg", "stiffness")  # [s], [°], [N·m/rad]
TOPIC = "/joint"  # of MCAP files
_NANO = 1_000_000_000


def load(path: str | Path) -> Reference:
    """Load the trajectory in a CSV file with the columns t [s], theta_deg [°] and stiffness [N·m/rad], in any order.

    Columns may have other units, such as ``theta [rad]``. Raises `InvalidFile` with line and column for a file that is
    not a trajectory, and warns with `UnusedColumns` of further columns.
    """
    columns = MotionColumns.read(path, dict(zip(COLUMNS, ("s", "deg", JOINT_STIFFNESS), strict=True)))
    t, theta, K = map(columns.numbers, COLUMNS)
    if t.size < 2:
        raise InvalidFile(path, f"a trajectory needs at least 2 samples, this file has {t.size}")
    columns.refuse("t", np.diff(t, prepend=-np.inf) <= 0, t, "{:g} s does not come after the sample before")
    columns.refuse("theta_deg", np.abs(theta) > 360, theta, "{:g}° is over a turn")
    columns.refuse("stiffness", K <= 0, K, "{:g} N·m/rad has to be positive")
    columns.tell_unused()
    return Reference(t, theta * DEG, K)


def save_reference(reference: Reference, path: str | Path) -> None:
    """Write a trajectory that `load` reads."""
    table = np.stack([reference.t, reference.theta / DEG, reference.K], axis=1)
    _write(path, COLUMNS, table, "%.10g")


def save_run(run: Run, path: str | Path) -> None:
    """Write a run, one line per sample; the commands of a line hold until the next (the last line repeats them)."""
    table = run.to_dict()
    _write(path, tuple(table), np.stack(list(table.values()), axis=1), "%.9g")


def _write(path: str | Path, names: tuple[str, ...], table: Array, form: str) -> None:
    with replacing(path) as draft:
        np.savetxt(draft, table, fmt=form, delimiter=",", header=",".join(names), comments="")


def reference_called(name: str | None, K: float | None, plant: Plant) -> Reference:
    """Return the trajectory of this name or in this CSV or recording, by default the standard sine.

    K [N·m/rad] is the stiffness of a standard trajectory, by default the joint's usual one. Raises `InvalidInput`.
    """
    name = name or "sine"
    if name in TRAJECTORIES:
        middle = usual_stiffness(plant.joint) if K is None else float(checks.stiffness("stiffness", K))
        return shrunk(TRAJECTORIES[name].about, middle, plant.joint)
    if K is not None:
        raise InvalidInput("--stiffness goes with a standard trajectory; a file has its own")
    if is_recording(name):
        return recorded(name, plant)
    if Path(name).suffix or Path(name).exists():
        return load(name)
    raise InvalidInput(f"there is neither a standard trajectory nor a file {name}; there are {', '.join(TRAJECTORIES)}")


def is_recording(name: str | Path) -> bool:
    """Return whether this is the name of a recording, from its ending."""
    return Path(name).suffix.lower() == ".npz"


def check_recordable(files: Iterable[Path], machine: Machine) -> None:
    """Raise `InvalidInput` if one of the `files` of --out is a recording, and no file can hold the `machine`."""
    for path in filter(is_recording, files):
        try:
            of_plant(machine)
        except InvalidInput as error:
            raise InvalidInput(f"--out {path}: {error} (an .npz contains its machine; choose a .csv)") from None


def recorded(path: str | Path, machine: Machine) -> Reference:
    """Return the reference of the run in a recording, for `machine`.

    Raises `InvalidFile` for a file that is no recording, and for a run of a machine with other joints or another
    stiffness.
    """
    run = load_recording(path)
    if run.plant.labels.angles != machine.labels.angles or run.plant.labels.stiffness != machine.labels.stiffness:
        names = (f"{', '.join(m.labels.angles)} and {', '.join(m.labels.stiffness)}" for m in (run.plant, machine))
        raise InvalidFile(path, "holds a run with {}; this machine needs {}".format(*names))
    try:
        return Reference(run.t, run.theta_ref, run.K_ref, Path(path).stem)
    except InvalidInput as error:
        raise InvalidFile(path, f"holds no trajectory: {error}") from None


_DAMAGE = (  # exceptions of zipfile and NumPy for other files
    ValueError, BadZipFile, Damaged, LZMAError, EOFError, AttributeError, TypeError, KeyError, IndexError, RuntimeError,
    OverflowError, MemoryError,
)  # fmt: skip
_JOINTS, _HAND = "joints", "hand"  # whose stiffness an arm tracks
_ARRAYS = tuple(f.name for f in fields(Run) if f.name != "plant")


def save_recording(run: Run, path: str | Path, further: Mapping[str, ArrayLike] | None = None) -> None:
    """Write `run`: its arrays with their names in `Run`, and its plant.

    A joint is stored as `joint` (TOML) and `plant_…`, an arm as `arm` (TOML) and its `tracked` stiffness. `further`
    arrays with other names are stored as well. Raises `InvalidInput` for an arm that a file cannot hold, such as a
    MuJoCo model, and `CannotWrite`.
    """
    values: dict[str, Any] = dict(further or {}) | {name: getattr(run, name) for name in _ARRAYS}
    values |= of_plant(run.plant)
    with replacing(path) as draft, draft.open("wb") as file:  # NumPy would add a suffix to a name
        np.savez_compressed(file, **values)


def load_recording(path: str | Path) -> Run:
    """Read a file of `save_recording`. Raises `InvalidFile` for any other file."""
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:  # NumPy does not close a bad file
            stored = dict(archive)
    except OSError as error:
        raise InvalidFile(path, f"cannot be read ({error.strerror or error})") from None
    except _DAMAGE:
        raise InvalidFile(path, "is not an NPZ file, or damaged") from None
    parts = ["arm", "tracked"] if "arm" in stored else ["joint", *(f"plant_{name}" for name in Plant().numbers)]
    if missing := {*_ARRAYS, *parts} - stored.keys():
        raise InvalidFile(path, f"is not the recording of a run: {', '.join(sorted(missing))} missing")
    arrays = {name: stored[name] for name in _ARRAYS}
    plant = _arm(path, stored) if "arm" in stored else _plant(path, stored)
    try:
        _check(arrays, plant)
    except InvalidInput as error:
        raise InvalidFile(path, f"is not the recording of a run: {error}") from None
    plain = {"dt": float(stored["dt"]), "implementation": str(stored["implementation"])}
    return Run(plant, **(arrays | plain))


def _check(arrays: dict[str, Array], plant: Machine) -> None:
    """Raise `InvalidInput` unless arrays have the shapes and kinds of those of a run of `plant`."""
    steps = arrays["step_time"].size
    for name, array in arrays.items():
        if array.shape != (expected := _shape(name, steps, plant)):
            raise InvalidInput(f"{name} has the shape {array.shape}, not {expected}")
        if array.dtype.kind not in ("U" if name == "implementation" else "fiu"):
            raise InvalidInput(f"{name} is an array of {array.dtype}")
    checks.real("t", arrays["t"], "s")
    checks.positive("dt", arrays["dt"], "s")
    checks.angle("theta_ref", arrays["theta_ref"])
    plant.check_stiffness("K_ref", arrays["K_ref"])


def _shape(name: str, steps: int, plant: Machine) -> tuple[int, ...]:
    """Return the shape of the array `name` of a `Run` of `plant`."""
    if name in ("dt", "implementation"):
        return ()
    length = steps + 1 if name in ("t", "x", "theta_ref", "K_ref", "K", "forces") else steps
    rows: dict[str, tuple[int, ...]] = {
        "x": (plant.size,), "estimate": (plant.size + plant.n,), "u": (plant.m,), "forces": (plant.m,), "moved": (3,),
        "theta_ref": plant.angle_shape, "K_ref": plant.stiffness_shape, "K": plant.stiffness_shape,
    }  # fmt: skip
    return (length, *rows.get(name, ()))


def of_plant(plant: Machine) -> dict[str, Any]:
    """Return a plant by the names in a recording. Raises `InvalidInput` for an arm that a file cannot hold."""
    if not isinstance(plant, Plant):
        return _of_arm(plant)
    numbers = {f"plant_{name}": value for name, value in plant.numbers.items()}
    return numbers | {"joint": machine_file.dumps(plant.joint)}


def _of_arm(arm: Arm) -> dict[str, Any]:
    """Return an arm by the names in a recording."""
    text = arm_text(arm)
    if arm.endpoint not in (None, arm.bodies.endpoint):
        raise InvalidInput(f"{arm.endpoint} cannot be written to a file, only the end of the last link can")
    return {"arm": text, "tracked": _JOINTS if arm.endpoint is None else _HAND}


def _arm(path: str | Path, stored: dict[str, Array]) -> Arm:
    arm = arm_from(toml.Table.parsed(f"{path} [arm]", str(stored["arm"])))
    tracked = str(stored["tracked"])
    if tracked not in (_JOINTS, _HAND):
        raise InvalidFile(path, f"does not hold an arm (it tracks the stiffness of {tracked!r})")
    return arm if tracked == _JOINTS else replace(arm, endpoint=arm.bodies.endpoint)


def _plant(path: str | Path, stored: dict[str, Array]) -> Plant:
    given = {name: f"plant_{name}" for name in NUMBERS}
    numbers: dict[str, Any] = {name: stored[key].tolist() for name, key in given.items() if key in stored}
    try:
        joint = machine_file.joint_from(toml.Table.parsed(f"{path} [joint]", str(stored["joint"])))
        return Plant(joint, **(numbers | {"lag": tuple(numbers["lag"])}))
    except (ValueError, TypeError) as error:  # of TOML or of this package
        raise InvalidFile(path, f"does not hold a plant ({error})") from None


def save_mcap(run: Run, path: str | Path, begin: int = 0) -> None:
    """Write a message per sample with the columns of `Run.to_dict`, which the schema names with their units.

    The first sample is at `begin` [ns] since 1970. NaN is left out of a message, since JSON cannot represent it. Raises
    `CannotWrite`, and `MissingPackage` without the package mcap.
    """
    from mcap.writer import Writer

    table = run.to_dict()
    names = [name for name in table if name != "t"]
    rows = np.stack([np.asarray(table[name], float) for name in names], axis=1)
    schema = {"type": "object", "properties": {name: {"type": "number"} for name in names}}
    with replacing(path) as draft, draft.open("wb") as stream:
        writer = Writer(stream)
        writer.start(library="antagonist")
        kind = writer.register_schema("antagonist.Joint", "jsonschema", json.dumps(schema).encode())
        channel = writer.register_channel(TOPIC, "json", kind)
        for t, row in zip(np.asarray(table["t"], float).tolist(), rows.tolist(), strict=True):
            time = begin + round(t * _NANO)
            message = {name: value for name, value in zip(names, row, strict=True) if np.isfinite(value)}
            writer.add_message(channel, time, json.dumps(message).encode(), time)
        writer.finish()
