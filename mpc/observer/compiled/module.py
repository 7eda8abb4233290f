"""What an observer estimates with becomes a module of compiled functions: the formulas of its plant and friction in
their template.

Observers that differ in their numbers only share it.
"""

from functools import cache
from hashlib import sha256
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.compilation.jit import register
from mpc.codegen.python_text import filling, translated
from mpc.model import compensation
from mpc.model.contact import Contact
from mpc.model.experiment import RESOLUTION
from mpc.model.plant import NU, NX
from mpc.observer import diagnosis, pressure_diagnosis, torque_diagnosis
from mpc.observer.compiled.layout import NUMBERS, Known, places
from mpc.observer.diagnosis import Diagnosis
from mpc.observer.filter import Filter
from mpc.tracking.compiled.module import imported, with_formulas

_HERE = Path(__file__).parent
_TEMPLATE = _HERE / "sample.py"
_PARTS = pressure_diagnosis, torque_diagnosis, diagnosis  # whose functions of numbers the template calls
_IMPORTS = "import math\n\n\n"


class CompiledFilter(NamedTuple):
    """A compiled filter is what is compiled for a family of observers, and the numbers of the formulas."""

    module: ModuleType  # `mpc.observer.compiled.sample` with the formulas
    c: Array


def compiled_filter(own: Filter) -> CompiledFilter:
    """Return the compiled functions of an observer's filter. Raises `Untranslatable` for formulas that are too long."""
    text, c = "", np.zeros(0)
    for name, (written, function) in _formulas(own).items():
        source = written(name, function, NUMBERS + c.size)
        text, c = text + f"@inlined\n{source.text}\n\n", np.concatenate([c, source.c])
    _register()
    return CompiledFilter(imported(f"# of {_parts()}\n" + with_formulas(_TEMPLATE, _IMPORTS + text)), c)


def _formulas(own: Filter) -> dict[str, tuple[Any, Any]]:
    """Return how they are written, and CasADi functions, by the names that they have in the template."""
    import casadi as ca

    plant, friction = own.plant, own.compensation.friction
    x, v, d = ca.SX.sym("x", NX), ca.SX.sym("v", NU), ca.SX.sym("d")
    contact, memory, motion = Contact(plant, x), ca.SX.sym("memory", friction.size), ca.SX.sym("motion")
    rate: Any = ca.vertcat(*plant.rate(x, v, d))
    slopes = ca.densify(ca.jacobian(rate, ca.vertcat(x, d)))
    felt, turned = friction.torque(memory, contact), friction.moved(memory, motion, contact)
    return {
        "rate_slopes": (translated, ca.Function("rate_slopes", [x, v, d], ca.cse([rate, slopes]))),
        "pulls": (translated, _simplified(diagnosis.pulling(plant))),
        "torque": (filling, ca.Function("torque", [x, memory], ca.cse([ca.densify(ca.SX(felt))]))),
        "moved": (filling, ca.Function("moved", [x, memory, motion], ca.cse([ca.densify(ca.SX(turned))]))),
    }


def _simplified(function: Any) -> Any:
    """Return the CasADi function of one input with its common terms reckoned once."""
    import casadi as ca

    x = ca.SX.sym("x", function.size_in(0))
    return ca.Function(function.name(), [x], ca.cse([function(x)]))


def known_of(own: Filter, judged: Diagnosis, c: Array) -> Known:
    """Return what is known of an observer's filter, whose formulas have the numbers `c`, and of its diagnosis."""
    gate, dt, joint, friction = own.gate, own.dt, judged.sound, own.compensation.friction
    substeps, (one, two) = own.plant.substeps(dt, RESOLUTION), (joint.first, joint.second)
    lengths = len(judged.pressures[0].numbers), len(judged.torque.numbers)
    return Known(
        np.array(own.inner), np.array(own.outer), own.Q, own.Q_rest, np.array([gate.lower, gate.upper]), dt,
        dt / substeps, substeps, judged.tolerance, own.compensation.dead_band, own.noise.theta, gate.floor[0],
        one.sigma, one.seen, np.array([one.quick, two.quick]), np.array([one.slow, two.slow]), joint.usual,
        places(friction.size, own.compensation.delay(dt), *lengths), c,
    )  # fmt: skip


@cache
def _register() -> None:
    """Teach numba the functions that Python runs as they are."""
    functions = [getattr(part, name) for part in _PARTS for name in part.__all__]
    register([function for function in functions if isinstance(function, FunctionType)], inline=False)


@cache
def _parts() -> str:
    """Return the hash of all that may be compiled into the template, so that a change of it is compiled, too."""
    files = *sorted(_HERE.parent.rglob("*.py")), Path(str(compensation.__file__))
    return sha256("".join(file.read_text(encoding="utf-8") for file in files).encode()).hexdigest()


__all__ = ["CompiledFilter", "compiled_filter", "known_of"]
