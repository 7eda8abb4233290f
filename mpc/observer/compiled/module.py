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
from mpc.codegen.text import IMPORTS, filling, translated
from mpc.model.arm.compiled.module import compiled_motion
from mpc.model.arm.model import Arm
from mpc.model.compiled_friction import friction_numbers
from mpc.model.experiment import RESOLUTION
from mpc.model.friction.contact import loads_function
from mpc.model.machine import Machine
from mpc.model.plant import NU, NX, Plant
from mpc.observer import diagnosis, pressure_diagnosis, ringing, torque_diagnosis
from mpc.observer.compiled.layout import Made, Numbers, made
from mpc.observer.diagnosis import Diagnosis
from mpc.observer.filter import OFFSET_TIME, Filter
from mpc.observer.pressure_diagnosis import Sound
from mpc.observer.pulling import pulling

if TYPE_CHECKING:
    from casadi import Function

_HERE = Path(__file__).parent
_TEMPLATE, _JOINT, _ARM = (_HERE / f"{name}.py" for name in ("sample", "joint", "arm"))
_SOUND = f"from {Sound.__module__} import Sound"
_GAINS = (
    "quick", "slow", "quick_down", "slow_down", "quick_free", "slow_free", "most_quick", "most_slow", "swelling",
)  # fmt: skip
_PARTS = pressure_diagnosis, torque_diagnosis, ringing, diagnosis  # modules with functions that the template calls


class CompiledFilter(NamedTuple):
    """Compiled functions for a family of observers, and the numbers of one of them."""

    module: ModuleType  # `mpc.observer.compiled.sample` with the formulas
    numbers: Numbers


def compiled_filter(own: Filter) -> CompiledFilter:
    """Return the compiled functions of an observer's filter. Raises `Untranslatable` if they cannot be compiled."""
    frictions = [friction_numbers(one) for one in own.frictions]
    known = [one for one in frictions if one is not None]
    if len(known) < len(frictions):
        raise Untranslatable(f"{own.frictions!r} are not friction models that can be compiled")
    motion, c, decay = _motion(own.plant, own.dt)
    text = f"{IMPORTS}from {motion.__name__} import advance\n{_SOUND}\n\n\n"
    for name, function in _formulas(own.plant).items():
        source = filling(name, function, c.size)
        text, c = text + f"@inlined\n{source.text}\n\n", np.concatenate([c, source.c])
    _register()
    text += _tuples(own.plant.n, own.plant.m)
    sized = with_formulas(_TEMPLATE, text).replace("n, m = 1, 2\n", f"n, m = {own.plant.n}, {own.plant.m}\n")
    module = imported(f"# of {_parts()}\n{sized}")
    return CompiledFilter(module, Numbers(c, decay, known))


def _motion(plant: Machine, dt: float) -> tuple[ModuleType, Array, Array]:
    """Return the motion's module, the numbers of its formulas, and the remainders of pressure errors of an arm."""
    if isinstance(plant, Arm):
        arm = compiled_motion(plant, dt, external=True)
        own = arm.module.__name__
        names = f"from {own} import COLUMNS, MOVING, m, n\nfrom {own} import advance as move\n\n"
        return imported(with_formulas(_ARM, names)), arm.c, arm.decay
    source = translated("rate_slopes", _rate_slopes(plant))
    text = f"{IMPORTS}@inlined\n{source.text}\n\n"
    return imported(with_formulas(_JOINT, text)), source.c, np.zeros(0)


def _rate_slopes(plant: Plant) -> "Function":
    import casadi as ca

    x, v, d = ca.SX.sym("x", NX), ca.SX.sym("v", NU), ca.SX.sym("d")
    rate = ca.SX(ca.vertcat(*plant.rate(x, v, d)))
    slopes = ca.densify(ca.jacobian(rate, ca.vertcat(x, d)))
    return ca.Function("rate_slopes", [x, v, d], ca.cse([rate, slopes]))


def _formulas(plant: Machine) -> dict[str, "Function"]:
    """Return CasADi functions of the state by their names in the template."""
    import casadi as ca

    x = ca.SX.sym("x", plant.size)
    values = {"pulls": pulling(plant)(x), "pressing": loads_function(plant)(x)}
    return {name: ca.Function(name, [x], ca.cse([ca.densify(value)])) for name, value in values.items()}


def _tuples(n: int, m: int) -> str:
    """Return functions of the template that return a tuple with an entry for each muscle or joint."""
    gains = ", ".join(f"k.{name}[{{0}}]" for name in _GAINS)
    sound = f"Sound({gains}, k.dead_band / 2, k.dt, k.sigma, k.seen[{{0}}])"
    made = {
        "regulators(p)": ("floats(p.parts[{0}])", range(m)),
        "loops(p)": ("floats(p.parts[{0}])", range(m + 1, m + 1 + n)),
        "sounds(k)": (sound, range(m)),
    }
    return "".join(
        f"@inlined\ndef {name}:\n    return ({', '.join(map(entry.format, places))},)\n\n\n"
        for name, (entry, places) in made.items()
    )


def made_of(compiled: CompiledFilter, own: Filter, judged: Diagnosis) -> Made:
    """Return the data for samples of an observer's `compiled` filter and of its diagnosis."""
    gate, dt, n, m, muscles = own.gate, own.dt, own.plant.n, own.plant.m, judged.sound.muscles
    substeps = own.plant.substeps(dt, RESOLUTION)
    known = {
        "inner": own.inner, "outer": own.outer, "Q": own.Q, "Q_rest": own.Q_rest, "possible": (gate.lower, gate.upper),
        "dt": dt, "h": dt / substeps, "substeps": substeps, "tolerance": judged.tolerance,
        "dead_band": own.compensation.dead_band, "older": own.older, "reach": own.reach, "share": own.share,
        "shares": own.shares,
        "learning": dt / OFFSET_TIME, "most_offset": own.noise.offset,
        "theta_noise": own.noise.theta, "theta_floor": gate.floor[:n], "sigma": muscles[0].sigma,
        "usual": judged.sound.usual, "inertia": judged.sound.inertia,
        **{name: [getattr(one, name) for one in muscles] for name in ("seen", *_GAINS)},
    }  # fmt: skip
    age = own.compensation.age(dt)
    sizes = [one.size for one in own.frictions]
    sizes += [m * (own.compensation.delay(dt) + age + 1), m * (age + 1), *(len(part.numbers) for part in judged.parts)]
    return made(known, compiled.numbers, sizes, n, m)


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
