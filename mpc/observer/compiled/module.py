"""Compiled module of an observer: the template with the formulas of its plant.

Observers that differ only in their numbers and their friction share it.
"""

from functools import cache
from hashlib import sha256
from pathlib import Path
from types import FunctionType, ModuleType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba.extending import register_jitable

from allocator.calculus import Array
from allocator.compilation.linked import INNER
from mpc.codegen.graphs import Untranslatable
from mpc.codegen.modules import imported, with_formulas
from mpc.codegen.python_text import IMPORTS, translated
from mpc.model.compiled_friction import friction_numbers
from mpc.model.experiment import RESOLUTION
from mpc.model.plant import NU, NX, Plant
from mpc.observer import diagnosis, pressure_diagnosis, ringing, torque_diagnosis
from mpc.observer.compiled.layout import Made, made
from mpc.observer.diagnosis import Diagnosis
from mpc.observer.filter import OFFSET_TIME, Filter
from mpc.observer.pulling import pulling

if TYPE_CHECKING:
    from casadi import Function

_HERE = Path(__file__).parent
_TEMPLATE = _HERE / "sample.py"
_PARTS = pressure_diagnosis, torque_diagnosis, ringing, diagnosis  # modules with functions that the template calls


class CompiledFilter(NamedTuple):
    """Compiled functions for a family of observers, and the numbers of the formulas."""

    module: ModuleType  # `mpc.observer.compiled.sample` with the formulas
    c: Array
    friction: Array  # numbers of `mpc.model.compiled_friction`


def compiled_filter(own: Filter) -> CompiledFilter:
    """Return the compiled functions of an observer's filter. Raises `Untranslatable` if they cannot be compiled."""
    friction = friction_numbers(own.compensation.friction)
    if friction is None:
        raise Untranslatable(f"{own.compensation.friction!r} is not a friction model that can be compiled")
    text, c = "", np.zeros(0)
    for name, function in _formulas(own.plant).items():
        source = translated(name, function, c.size)
        text, c = text + f"@inlined\n{source.text}\n\n", np.concatenate([c, source.c])
    _register()
    module = imported(f"# of {_parts()}\n" + with_formulas(_TEMPLATE, IMPORTS + text))
    return CompiledFilter(module, c, friction)


def _formulas(plant: Plant) -> dict[str, "Function"]:
    """Return CasADi functions by their names in the template."""
    import casadi as ca

    x, v, d = ca.SX.sym("x", NX), ca.SX.sym("v", NU), ca.SX.sym("d")
    rate = ca.SX(ca.vertcat(*plant.rate(x, v, d)))
    slopes = ca.densify(ca.jacobian(rate, ca.vertcat(x, d)))
    muscles = ca.densify(ca.vertcat(pulling(plant)(x), plant.isobaric(x)))
    return {
        "rate_slopes": ca.Function("rate_slopes", [x, v, d], ca.cse([rate, slopes])),
        "muscles": ca.Function("muscles", [x], ca.cse([muscles])),
    }


def made_of(compiled: CompiledFilter, own: Filter, judged: Diagnosis) -> Made:
    """Return the data for samples of an observer's `compiled` filter and of its diagnosis."""
    gate, dt, substeps = own.gate, own.dt, own.plant.substeps(own.dt, RESOLUTION)
    (one, two), (usual,), (inertia,) = judged.sound
    known = {
        "inner": own.inner, "outer": own.outer, "Q": own.Q, "Q_rest": own.Q_rest, "possible": (gate.lower, gate.upper),
        "dt": dt, "h": dt / substeps, "substeps": substeps, "tolerance": judged.tolerance,
        "dead_band": own.compensation.dead_band, "learning": own.dt / OFFSET_TIME,
        "most_offset": own.noise.offset, "theta_noise": own.noise.theta, "theta_floor": gate.floor[0],
        "sigma": one.sigma, "seen": one.seen, "quick": (one.quick, two.quick), "slow": (one.slow, two.slow),
        "usual": usual, "inertia": inertia,
    }  # fmt: skip
    lengths = (len(part.numbers) for part in judged.parts)
    age = own.compensation.age(dt)
    sizes = own.compensation.friction.size, NU * (own.compensation.delay(dt) + age + 1), NU * (age + 1), *lengths
    return made(known, compiled.c, compiled.friction, sizes)


@cache
def _register() -> None:
    """Register functions with numba that Python runs unchanged."""
    for part in _PARTS:
        for name, function in vars(part).items():
            if not isinstance(function, FunctionType) or function.__module__ != part.__name__ or name.startswith("_"):
                continue
            register_jitable(error_model="numpy", **INNER)(function)


@cache
def _parts() -> str:
    """Return the hash of all parts that may be compiled into the template, so that their changes are compiled."""
    files = sorted(_HERE.parent.rglob("*.py"))
    return sha256("".join(file.read_text(encoding="utf-8") for file in files).encode()).hexdigest()
