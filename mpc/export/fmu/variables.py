"""Variables of an FMU: one list from which modelDescription.xml and the table in C are made."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.compilation.printer import number
from mpc.export import text
from mpc.model.real_plant import RealPlant
from mpc.tracking.controller import TrackingMPC

_SET = {"input": 2, "parameter": 1, "output": 0}


class Variable(NamedTuple):
    """Variable of an FMU: a number, or a row of numbers."""

    name: str
    causality: str  # "input", "parameter" or "output"
    unit: str | None  # one of `UNITS`; None: an integer
    about: str
    start: float | Sequence[float] = 0.0  # ignored for outputs, which are computed
    finite: bool = False  # NaN and infinity are refused; otherwise the unit handles them

    @property
    def starts(self) -> tuple[float, ...]:
        """Start values."""
        return tuple(float(value) for value in np.atleast_1d(self.start))

    @property
    def is_row(self) -> bool:
        """Whether the variable is a row of numbers."""
        return np.ndim(self.start) == 1


UNITS: dict[str, dict[str, int]] = {  # exponents of the base units
    "rad": {"rad": 1},
    "rad/s": {"rad": 1, "s": -1},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "N": {"kg": 1, "m": 1, "s": -2},
    "N.m": {"kg": 1, "m": 2, "s": -2},
    "N.m/rad": {"kg": 1, "m": 2, "s": -2, "rad": -1},
    "s": {"s": 1},
}


def plant_variables(real: RealPlant, x0: Array) -> list[Variable]:
    """Return the variables of a plant that begins in `x0` (4,)."""
    theta, omega, P1, P2 = map(float, x0)
    variables = [
        Variable("u1", "input", "Pa", "commanded pressure of the agonist", P1),
        Variable("u2", "input", "Pa", "commanded pressure of the antagonist", P2),
        Variable("d", "input", "N.m", "torque from outside"),
        Variable("theta_start", "parameter", "rad", "joint angle at the beginning", theta),
        Variable("omega_start", "parameter", "rad/s", "its rate at the beginning", omega),
        Variable("P1_start", "parameter", "Pa", "pressure of the agonist at the beginning, and its command before", P1),
        Variable("P2_start", "parameter", "Pa", "pressure of the antagonist at the beginning", P2),
        Variable("theta", "output", "rad", "joint angle"),
        Variable("omega", "output", "rad/s", "its rate"),
        Variable("P1", "output", "Pa", "pressure of the agonist, gauge"),
        Variable("P2", "output", "Pa", "pressure of the antagonist, gauge"),
        Variable(
            "theta_measured", "output", "rad", f"joint angle as an encoder of {real.encoder:g} rad a step reads it"
        ),
        Variable("K", "output", "N.m/rad", "stiffness"),
        Variable("T", "output", "N.m", "torque of the muscles"),
        Variable("F1", "output", "N", "force of the agonist; negative: slack"),
        Variable("F2", "output", "N", "force of the antagonist; negative: slack"),
    ]
    return [variable._replace(finite=variable.causality != "output") for variable in variables]


def controller_variables(controller: TrackingMPC, x0: Array) -> list[Variable]:
    """Return the variables of a controller and its observer, with the initial state `x0` (4,), at rest."""
    theta, _, P1, P2 = map(float, x0)
    K = float(controller.plant.stiffness(x0))
    samples = controller.ahead + 1
    return [
        Variable("theta", "input", "rad", "measured joint angle; NaN: not measured", theta),
        Variable("P1", "input", "Pa", "measured pressure of the agonist, gauge; NaN: not measured", P1),
        Variable("P2", "input", "Pa", "measured pressure of the antagonist, gauge; NaN: not measured", P2),
        Variable(
            "theta_ref", "input", "rad", "reference of the angle, now and at the samples to come", [theta] * samples
        ),
        Variable(
            "K_ref", "input", "N.m/rad", "reference of the stiffness, now and at the samples to come", [K] * samples
        ),
        Variable("u1", "output", "Pa", "command for the agonist"),
        Variable("u2", "output", "Pa", "command for the antagonist"),
        Variable("status", "output", None, "of the plan, as PlanStatus"),
        Variable("rung", "output", None, "of the plan, as Rung"),
    ]


def variables_header(variables: Sequence[Variable], dt: float, token: str) -> str:
    """Return unit_variables.h."""
    lines = [
        f'#define UNIT_TOKEN "{token}"',
        f"#define UNIT_DT {number(dt, single=False)} /* sample time [s] */",
        f"#define UNIT_VARIABLES {len(variables)}",
        f"#define UNIT_VALUES {sum(len(variable.starts) for variable in variables)}",
        "enum {",
        *(f"    UNIT_{v.name.upper()} = {first}, /* [{v.unit or '-'}] {v.about} */" for v, first in _placed(variables)),
        "};",
        "#define UNIT_STARTS {" + ", ".join(number(x, single=False) for v in variables for x in v.starts) + "}",
        "#define UNIT_TABLE {" + ", ".join(_row(v, first) for v, first in _placed(variables)) + "}",
    ]
    return text.header(
        "ANT_UNIT_VARIABLES_H", "The variables of this FMU, as in modelDescription.xml.", "\n".join(lines)
    )


def _placed(variables: Sequence[Variable]) -> Iterator[tuple[Variable, int]]:
    """Yield the variables and the positions of their first values."""
    first = 0
    for variable in variables:
        yield variable, first
        first += len(variable.starts)


def _row(variable: Variable, first: int) -> str:
    whole, count = int(variable.unit is None), len(variable.starts)
    return f"{{{whole}, {first}, {count}, {_SET[variable.causality]}, {int(variable.finite)}}}"
