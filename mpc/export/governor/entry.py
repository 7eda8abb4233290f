"""`export_governor` writes a governor as a directory of C files."""

from os import PathLike
from pathlib import Path

import numpy as np

from allocator.calculus import Array
from allocator.compilation.printer import number
from allocator.errors import InvalidInput
from mpc.export import text
from mpc.export.directory import check, write
from mpc.export.governor.kernel import kernel_files, numbers_file
from mpc.export.parts import BUILD, Files, copied, is_single, model_files
from mpc.governor import Interval, PressureGovernor
from mpc.governor.interval import ends

_SEED = 20  # of the demonstration's commands


def export_governor(out: str | PathLike[str], governor: PressureGovernor, *, precision: str = "double") -> Path:
    """Write `governor` as plain C99 to the directory `out`, and return it.

    The C says what `PressureGovernor.govern` says. Its kernel is printed from the text that Python runs, its formulas
    by CasADi for this mechanism.

    Raises
    ------
    InvalidInput
        For anything but a governor, and a directory that is not empty. Nothing is written then.
    MissingBackend
        For an unknown `precision`, "double" or "single" (for an FPU without double).
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
            "q, omega, P and a scene to omega', A, B of the forces A P + B, -l' of the muscles, kinetic energy",
        ),
        (made.functions[1], "q and a scene to the energy of the muscles at rest, and of gravity"),
    ]
    return {
        **{name: own[name] for name in ("antagonist.h", "antagonist_governor.h", "main.c")},
        "CMakeLists.txt": dict(copied(".", ""))["CMakeLists.txt"],
        "src/govern.c": own["govern.c"],
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
        "SCENES": (len(scenes), "s, corners of what is uncertain"),
        "SCENE": (len(scenes[0]), "k, numbers of each"),
        "SUPPLY_LO": (mechanism.pressure_limits[0], "[Pa]"),
    }
    return text.config(numbers, single)


def _commands(governor: PressureGovernor) -> Array:
    """Return rows (q, ω, P, the last command, the next) to show: an arm that is pushed faster and faster."""
    rng, rules = np.random.default_rng(_SEED), governor.made.rules
    n, m = governor.mechanism.n, governor.mechanism.m
    rows = []
    for speed in (0.0, 1.0, 3.0):
        omega, P = np.full(n, speed), np.round(rules.rest, -3)
        rows.append([*np.zeros(n), *omega, *P, *P, *np.round(P + rng.uniform(-1, 1, m) * 1e5, -3)])
    return np.array([[float(number(v, False)) for v in row] for row in np.array(rows).tolist()])


def _shown(governor: PressureGovernor) -> list[str]:
    """Return what the demonstration prints, according to Python."""
    n, m = governor.mechanism.n, governor.mechanism.m
    lines = []
    for row in _commands(governor):
        q, omega, P, previous, command = np.split(row, np.cumsum([n, n, m, m]))
        safe, status = governor.govern(q, omega, P, command, previous)
        lines.append(f"status {int(status)}, P {' '.join(f'{value:.6g}' for value in safe)} Pa")
    return lines


_README = (
    """\
# A governor of pressures in C

Exported from the Python package `antagonist`, in {precision} precision: {n} joints ({joints}), {m} muscles
({muscles}), every {dt:g} s. Plain C99; no heap, no global state, nothing but `math.h`, every loop bounded: at most
{most} evaluations of the arm's motion. All units are SI. Written for this governor: `antagonist_config.h`,
`src/governor.h`, `src/model.c`, `src/demonstration.h`; `src/kernel.c` is printed from the text that Python runs.

"""
    + BUILD
    + """\

{known}

`ant_govern` (`antagonist_governor.h`) takes the state of the arm, the commands given last and those that somebody would
like to give, and fills in those to be given, as `mpc.governor.PressureGovernor.govern` does. All memory is in
`ant_memory`, of fixed size.
"""
)


def _readme(governor: PressureGovernor, single: bool) -> str:
    mechanism, counts = governor.mechanism, governor.made.rules.counts
    return _README.format(
        precision="single" if single else "double",
        n=mechanism.n,
        m=mechanism.m,
        dt=governor.dt,
        joints=", ".join(mechanism.joint_names),
        muscles=", ".join(mechanism.muscle_names),
        most=int(counts[4] * (6 * (1 + counts[0] + counts[1] * (counts[2] - 1)) + 3)),
        rounded=" (single precision differs in the last digits)" if single else "",
        printed="\n".join(_shown(governor)),
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
    least, greatest = min(low), max(high)
    return f"{least:g}" if least == greatest else f"{least:g} to {greatest:g}"
