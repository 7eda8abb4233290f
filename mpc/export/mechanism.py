"""Function `export_mechanism`: the allocation of a mechanism as a directory of C files."""

import ast
from collections.abc import Iterator
from os import PathLike
from pathlib import Path

import numpy as np

from allocator.allocation import allocate
from allocator.allocation.box.kernel import batch, data, levels
from allocator.allocation.status import CLOSED_FORM
from allocator.allocation.two_muscles.kernels import source
from allocator.calculus import Array
from allocator.compilation.printer import (
    INT,
    REAL,
    ArrayKind,
    Kind,
    Outside,
    StructKind,
    c_functions,
    parsed,
)
from allocator.errors import InvalidInput
from allocator.mechanism import Mechanism
from allocator.mechanism.formulas import map_function
from mpc.export import text
from mpc.export.building import check, write
from mpc.export.joint import C_NAMES, Numbers
from mpc.export.parts import Files, Functions, build_words, copied, filled, is_single, machine_words, model_files

_FREE = 4 * np.pi  # [rad] of a joint without end stops
_SEED = 19  # of the demonstration's targets
_TRIES = 200
_HOLDS = 1e-3  # least eigenvalue of a demonstrated stiffness, over its greatest entry


def export_mechanism(out: str | PathLike[str], mechanism: Mechanism, *, precision: str = "double") -> Path:
    """Write the allocation of `mechanism` as plain C99 to the directory `out`, and return it.

    The C equals `allocate` with priority "torque" or "stiffness". Its kernel is printed from the
    Python source, and CasADi derives the formulas of this mechanism.

    Raises
    ------
    InvalidInput
        For muscles that are not affine in the pressure, routes without formulas (tables) and a directory that is not
        empty. Nothing is written then.
    MissingBackend
        For an unknown `precision`, "double" or "single" (for a single-precision FPU).
    """
    if not isinstance(mechanism, Mechanism):
        raise InvalidInput(f"mechanism is a {type(mechanism).__name__}; expected a Mechanism")
    single = is_single(precision)
    check(Path(out))
    files = mechanism_files(mechanism, single) | model_files(mechanism_functions(mechanism), single)
    return write(
        files
        | {
            "antagonist_config.h": text.config(mechanism_sizes(mechanism), single),
            "README.md": _readme(mechanism, single),
        },
        out,
    )


def mechanism_functions(mechanism: Mechanism) -> Functions:
    """Return the CasADi functions of the allocation, with descriptions."""
    return [(map_function(mechanism), "q [rad] to the muscles at q and y0 + M P, see allocate.c")]


def mechanism_files(mechanism: Mechanism, single: bool, alone: bool = False) -> Files:
    """Return the files of the allocation without model, sizes and README; `alone` leaves its demonstration out."""
    return {
        **dict(copied("mechanism", "")),
        "CMakeLists.txt": dict(copied(".", ""))["CMakeLists.txt"],
        **dict(copied("mechanism/src", "src/")),
        "src/real.h": dict(copied("allocate", ""))["real.h"],
        **kernel_files(single),
        "src/mechanism.h": _numbers(mechanism, single),
        "src/demonstration.h": text.demonstration("q [rad], T [N*m], K [N*m/rad]", _targets(mechanism), single, alone),
    }


def mechanism_sizes(mechanism: Mechanism) -> Numbers:
    """Return the sizes that antagonist_config.h defines."""
    n, m = mechanism.n, mechanism.m
    rows = n + n * (n + 1) // 2
    return {
        "JOINTS": (n, "n"),
        "MUSCLES": (m, "m"),
        "STIFFNESSES": (rows - n, "entries of a stiffness"),
        "ROWS": (rows, "torques and stiffnesses"),
        "VARIABLES": (m, "of the kernel"),
        "LINES": (rows, "of the kernel"),
        "LEVELS": (2, "priorities: the first and the second objective"),
    }


def _numbers(mechanism: Mechanism, single: bool) -> str:
    lo, hi = mechanism.pressure_limits
    met, binds, trusted, stretched = (1e-5, 1e-6, 1e-3, 1e-6) if single else (*CLOSED_FORM, 1e-7, 1e-9)
    numbers: dict[str, tuple[float | int, str]] = {
        "UNIT": (hi, "pressures are solved for in this unit [Pa]"),
        "SUPPLY_LO": (lo, "[Pa]"),
        "SUPPLY_HI": (hi, "[Pa]"),
        "MET": (met, "greatest miss of a met target, over the torque or stiffness scale [-]"),
        "BINDS": (binds, "distance to a bound, over the unit, at which a pressure lies on it [-]"),
        "NEAR": (binds * (hi - lo), "the same [Pa]"),
        "TRUSTED": (trusted, "an answer with a greater residual is a failure [-]"),
        "LEAST_CONTRACTION": (mechanism.min_contraction - stretched, "below it no muscle's model is valid [-]"),
    }
    ends = np.array([(-_FREE, _FREE)] * mechanism.n if mechanism.angle_limits is None else mechanism.angle_limits)
    rows, columns = mechanism.upper_triangle
    weights = np.concatenate([np.ones(mechanism.n), np.where(rows == columns, 1.0, np.sqrt(2.0))])
    tables = {
        "ANT_HI": np.array([min(hi, muscle.max_pressure) for muscle in mechanism.muscles]),
        "ANT_LEFT": ends[:, 0],
        "ANT_RIGHT": ends[:, 1],
        "ANT_WEIGHT": weights,
    }
    about = "The mechanism's numbers, in SI units: greatest pressures, ends of the joints, roots of the weights."
    body = [text.defines(numbers, single), *(f"static {text.table(name, v, single)}" for name, v in tables.items())]
    return text.header("ANT_MECHANISM_H", about, "\n\n".join(body), ["antagonist.h"])


def _targets(mechanism: Mechanism) -> Array:
    """Return demonstration targets as rows (q, T, K): of random taut pressures, the last one out of reach.

    Raises `InvalidInput` if the mechanism hardly ever holds itself.
    """
    rng = np.random.default_rng(_SEED)
    rows = []
    for far in (1.0, 1.0, 1.0, 3.0):
        reach = 0.3 if mechanism.angle_limits is None else 0.4 * np.array(mechanism.angle_limits)[:, 1]
        for _ in range(_TRIES):
            q = np.round(rng.uniform(-1, 1, mechanism.n) * reach, 3)
            P = rng.uniform(*mechanism.pressure_box(q))
            K = mechanism.stiffness(q, P)
            if np.linalg.eigvalsh(K)[0] > _HOLDS * np.abs(K).max():
                break
        else:
            raise InvalidInput(
                f"mechanism: none of {_TRIES} random pressures holds it, its muscles only destabilise it"
            )
        rows.append([*q, *(far * mechanism.torque(q, P)), *K[mechanism.upper_triangle]])
    return np.asarray(np.round(rows, 4))


def mechanism_lines(mechanism: Mechanism) -> list[str]:
    """Return the output of the demonstration, computed in Python."""
    lines, n = [], mechanism.n
    for row in _targets(mechanism):
        q, T, entries = row[:n], row[n : 2 * n], row[2 * n :]
        K = np.zeros((n, n))
        K[mechanism.upper_triangle] = K.T[mechanism.upper_triangle] = entries
        a = allocate(q, K, T, joint=mechanism)
        listed = [" ".join(f"{value:.6g}" for value in values) for values in (T, entries, a.P)]
        lines.append(f"T {listed[0]} N*m, K {listed[1]} N*m/rad: P {listed[2]} Pa, status {int(a.status)}")
    return lines


def _readme(mechanism: Mechanism, single: bool) -> str:
    return filled(
        "mechanism",
        **build_words(single, mechanism_lines(mechanism)),
        **machine_words(mechanism),
        most=MOST_ROUNDS + MOST_FIRST,
    )


_SIZES = {"m": "ANT_VARIABLES", "p": "ANT_LINES", "K": "ANT_LEVELS"}
_SIDE = "signed char"
_ELEMENTS = {"floats": REAL, "places": INT, "signs": _SIDE}

MOST_ROUNDS, MOST_FIRST = 1000, 200  # in C they bound the longest call
SINGLE = {  # tolerances for rounding in single precision
    "GAP": 3e2,
    "POSITIVE": 1e-6,
    "RANK": 1e-9,
    "MISSED": 1e-6,
    "CANCELS": 3e-5,
    "OUTSIDE": 1e-6,
    "EXCEEDED": 1e-4,
}
ENTRIES = {name: f"ant_kernel_{name}" for name in ("prepare", "scale", "solve", "residual")}


def kernel_files(single: bool) -> dict[str, str]:
    """Return the kernel's files, which are the same for every mechanism; antagonist_config.h defines the sizes."""
    structs = _structs()
    functions = (*levels.FUNCTIONS, *batch.PROOF, source.interval)
    numbers = {"MOST_ROUNDS": MOST_ROUNDS, "MOST_FIRST": MOST_FIRST} | (SINGLE if single else {})
    outside = Outside(C_NAMES, {("low", "high", "status"): "ant_bounds"})
    made = c_functions(functions, _kinds(structs), single, ENTRIES | {"interval": "ant_interval"}, numbers, outside)
    about = "Lexicographic least squares in a box, printed from the Python source."
    head = "\n\n".join([*(struct.definition() for struct in structs.values()), made.head])
    body = "\n\n".join([f'/* {about} */\n#include "antagonist.h"\n#include "real.h"', made.body])
    return {
        "src/kernel.h": text.header("ANT_KERNEL_H", about, head),
        "src/kernel.c": f"{body}\n",
    }


def _structs() -> dict[str, StructKind]:
    """Return the C structs of the named tuples."""
    m, p, K = _SIZES.values()
    rows = {
        "A": ArrayKind(REAL, (p, m), True),
        "b": ArrayKind(REAL, (p,), True),
        "onesided": ArrayKind(_SIDE, (p,), True),
        "ends": ArrayKind(INT, (K,), True),
    }
    bounds = {name: ArrayKind(REAL, (m,), True) for name in data.Box._fields}
    memory = dict(zip(data.Work._fields, _memory(), strict=True))
    return {
        "levels": StructKind("ant_levels", rows, False),
        "box": StructKind("ant_box", bounds, False),
        "work": StructKind("ant_work", memory, True),
    }


def _memory() -> Iterator[ArrayKind]:
    """Yield the arrays that `carved` takes from flat ones, in their order."""
    for node in ast.walk(parsed(data.carved)):
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Call) and isinstance(node.targets[0], ast.Tuple):
            flat, *sizes = node.value.args
            yield ArrayKind(_ELEMENTS[ast.unparse(flat)], tuple(map(_size, sizes)))


def _size(node: ast.expr) -> str:
    return " ".join(_SIZES.get(part, part) for part in ast.unparse(node).split())


def _kinds(structs: dict[str, StructKind]) -> dict[str, Kind]:
    """Return the kinds of arguments, by their names in all functions."""
    m, p, K = _SIZES.values()
    memory = structs["work"].fields
    return {
        **structs,
        **{name: memory[name] for name in ("B", "Q", "L", "right", "tries")},
        "x": ArrayKind(REAL, (m,)),
        "centre": ArrayKind(REAL, (m,), True),
        "side": ArrayKind(_SIDE, (f"{m} + {p}",)),
        "held": ArrayKind(_SIDE, (f"{m} + {p}",)),
        "mu": ArrayKind(REAL, (f"{K} + 1", p)),
        "ends": ArrayKind(INT, (K,), True),
        "bounds": ArrayKind(REAL, ("6",), True),
        **dict.fromkeys(("longest", "pull", "near", "to_centre", "greatest"), REAL),
    }
