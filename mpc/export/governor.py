"""Function `export_governor`: a pressure governor as a directory of C files."""

from os import PathLike
from pathlib import Path

import numpy as np

from allocator.calculus import Array
from allocator.compilation.printer import REAL, ArrayKind, Kind, Outside, StructKind, c_functions
from allocator.errors import InvalidInput
from mpc.export import text
from mpc.export.building import check, write
from mpc.export.parts import Files, build_words, copied, filled, is_single, machine_words, model_files
from mpc.governor import Interval, PressureGovernor, kernel
from mpc.governor.model import ends

_SEED = 20  # of the demonstration's commands


def export_governor(out: str | PathLike[str], governor: PressureGovernor, *, precision: str = "double") -> Path:
    """Write `governor` as plain C99 to the directory `out`, and return it.

    The C equals `PressureGovernor.govern`. Its kernel is printed from the Python source, and CasADi derives
    the formulas of this mechanism.

    Raises
    ------
    InvalidInput
        For anything but a governor, and a directory that is not empty. Nothing is written then.
    MissingBackend
        For an unknown `precision`, "double" or "single" (for a single-precision FPU).
    """
    if not isinstance(governor, PressureGovernor):
        raise InvalidInput(f"governor is a {type(governor).__name__}; expected a PressureGovernor")
    single = is_single(precision)
    check(Path(out))
    return write(_files(governor, single), out)


def _files(governor: PressureGovernor, single: bool) -> Files:
    own, made = dict(copied("governor", "")), governor.made
    functions = [
        (
            made.functions[0],
            "q, omega, P and a scene to omega', A, B of the forces A P + B, -l' of the muscles, gas, kinetic energy",
        ),
        (made.functions[1], "q and a scene to the energy of the muscles at rest, and of gravity"),
    ]
    return {
        **{name: own[name] for name in ("antagonist.h", "antagonist_governor.h", "main.c")},
        "CMakeLists.txt": dict(copied(".", ""))["CMakeLists.txt"],
        **{f"src/{name}": own[name] for name in ("formulas.h", "govern.c")},
        "src/real.h": dict(copied("allocate", ""))["real.h"],
        **kernel_files(single),
        **model_files(functions, single),
        "src/governor.h": numbers_file(made.rules, single),
        "antagonist_config.h": _config(governor, single),
        "src/demonstration.h": text.demonstration("q, omega, P, previous, command", _commands(governor), single),
        "README.md": _readme(governor, single),
    }


def _config(governor: PressureGovernor, single: bool) -> str:
    mechanism, scenes = governor.mechanism, governor.made.rules.scenes
    numbers: dict[str, tuple[float | int, str]] = {
        "JOINTS": (mechanism.n, "n"),
        "MUSCLES": (mechanism.m, "m"),
        "SCENES": (len(scenes), "s, corners of the uncertain numbers"),
        "SCENE": (len(scenes[0]), "k, numbers per corner"),
        "SUPPLY_LO": (mechanism.pressure_limits[0], "[Pa]"),
    }
    return text.config(numbers, single)


def _commands(governor: PressureGovernor) -> Array:
    """Return demonstration rows (q, ω, P, last command, next command) of an arm that is pushed faster and faster."""
    rng, rules = np.random.default_rng(_SEED), governor.made.rules
    n, m = governor.mechanism.n, governor.mechanism.m
    rows = []
    for speed in (0.0, 1.0, 3.0):
        omega, P = np.full(n, speed), np.round(rules.rest, -3)
        rows.append([*np.zeros(n), *omega, *P, *P, *np.round(P + rng.uniform(-1, 1, m) * 1e5, -3)])
    return np.array(rows)


def _shown(governor: PressureGovernor) -> list[str]:
    """Return the output of the demonstration, computed in Python."""
    n, m = governor.mechanism.n, governor.mechanism.m
    lines = []
    for row in _commands(governor):
        q, omega, P, previous, command = np.split(row, np.cumsum([n, n, m, m]))
        safe, status = governor.govern(q, omega, P, command, previous)
        lines.append(f"status {int(status)}, P {' '.join(f'{value:.6g}' for value in safe)} Pa")
    return lines


def _readme(governor: PressureGovernor, single: bool) -> str:
    mechanism, counts = governor.mechanism, governor.made.rules.counts
    return filled(
        "governor",
        **build_words(single, _shown(governor)),
        **machine_words(mechanism),
        dt=governor.dt,
        most=int(counts[4] * (6 * (1 + counts[0] + counts[1] * (counts[2] - 1)) + 3)),
        known=_known(governor),
    )


def _known(governor: PressureGovernor) -> str:
    """Return sentences on the intervals within which the governor keeps the joint range."""
    fields = {"strength": "-", "damping": "N·m·s/rad", "lag": "s"}
    bounds = {name: ends(getattr(governor, name)) for name in fields}
    said = [f"{name} {_range(*bounds[name])} {unit}".removesuffix(" -") for name, unit in fields.items()]
    masses = isinstance(governor.inertia, Interval) or isinstance(governor.gravity, Interval)
    return (
        f"The joint range is kept by arms that are the model within these bounds: {'; '.join(said)}; masses "
        f"{'between the two given' if masses else 'as given'}. An arm outside them breaks it by some degrees."
    )


def _range(low: tuple[float, ...], high: tuple[float, ...]) -> str:
    """Return the bounds of each joint or muscle in their order, or once if they are the same."""
    each = [f"{least:g}" if least == most else f"{least:g} to {most:g}" for least, most in zip(low, high, strict=True)]
    return ", ".join(each if len(set(each)) > 1 else each[:1])


_N, _M = "ANT_JOINTS", "ANT_MUSCLES"
_SIZES = {"n": _N, "m": _M, "s": "ANT_SCENES", "k": "ANT_SCENE", "c": "1"}  # C's formulas contain their numbers


def kernel_files(single: bool) -> dict[str, str]:
    """Return the kernel's files, which are the same for every mechanism; antagonist_config.h defines the sizes."""
    rules = StructKind.of(kernel.Rules, "ant_rules", _SIZES, constant=True)
    memory = StructKind.of(kernel.Memory, "ant_memory", _SIZES, holds=True)
    outside = Outside({name: name for name in ("motion", "potential")})  # of formulas.h
    names = {"govern": "ant_kernel_govern"}
    made = c_functions(kernel.FUNCTIONS, _kinds(rules, memory), single, names, {}, outside)
    about = "A governor's kernel, printed from the Python source."
    includes = '#include "kernel.h"\n\n#include "formulas.h"\n#include "real.h"'
    return {
        "antagonist_memory.h": text.header("ANTAGONIST_MEMORY_H", _WORKS, memory.definition(), ["antagonist.h"]),
        "src/kernel.h": text.header(
            "ANT_KERNEL_H", about, f"{rules.definition()}\n\n{made.head}", ["antagonist_memory.h"]
        ),
        "src/kernel.c": "\n\n".join([f"/* {about} */\n{includes}", made.body]) + "\n",
    }


_WORKS = "Work space of ant_govern: one per thread, preferably static."


def _kinds(rules: StructKind, memory: StructKind) -> dict[str, Kind]:
    """Return the kinds of arguments, by their names in all functions."""
    given = {name: ArrayKind(REAL, (_M,), True) for name in ("P", "previous", "command")}
    given["scene"] = ArrayKind(REAL, (_SIZES["k"],), True)
    made = {name: memory.fields[name] for name in ("alpha", "gain", "force", "speed", "squeeze", "energy", "level")}
    ends = {"q": ArrayKind(REAL, (_N,), True), "omega": ArrayKind(REAL, (_N,), True), "safe": ArrayKind(REAL, (_M,))}
    return {"rules": rules, "memory": memory, **given, **made, **ends, "c": ArrayKind(REAL, ("1",), True), "mu": REAL}


def numbers_file(rules: kernel.Rules, single: bool) -> str:
    """Return the header with the numbers of a governor."""
    none = np.zeros(1)
    tables = rules._replace(motion=none, potential=none)._asdict()
    body = [f"static {text.table(f'ANT_RULES_{name.upper()}', values, single)}" for name, values in tables.items()]
    listed = ", ".join(f"ANT_RULES_{name.upper()}" for name in tables)
    body.append(f"static const ant_rules ANT_RULES = {{{listed}}};")
    about = "The governor's numbers, in SI units; see mpc/governor/kernel.py."
    return text.header("ANT_GOVERNOR_H", about, "\n\n".join(body), ["kernel.h", "real.h"])
