"""Variables of an FMU: one list from which modelDescription.xml and the table in C are made."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.compilation.printer import number
from mpc.export import text
from mpc.export.parts import names_of
from mpc.model.machine import Machine
from mpc.model.plant import Plant
from mpc.model.real_experiment import RealMachine
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


def plant_variables(real: RealMachine, x0: Array) -> list[Variable]:
    """Return the variables of a plant that begins in `x0` (2n + m,), in the order of plant_unit.c."""
    n = real.nominal.n
    joints, muscles = _labels(real.nominal)
    theta, omega, P = (values.tolist() for values in np.split(np.asarray(x0, float), [n, 2 * n]))
    at_joints = [(i, name, *start) for (i, name), *start in zip(joints, theta, omega, strict=True)]
    at_muscles = [(j, name, start) for (j, name), start in zip(muscles, P, strict=True)]
    step = f"as an encoder of {real.encoder:g} rad a step reads it"
    entries = [f"{a}{b}" for a, b in zip(*(1 + np.array(np.triu_indices(n))), strict=True)] if n > 1 else [""]
    variables = [
        *(Variable(f"u{j}", "input", "Pa", f"commanded pressure of {name}", start) for j, name, start in at_muscles),
        *(Variable(f"d{i}", "input", "N.m", f"torque from outside on {name}") for i, name in joints),
        *(Variable(f"theta{i}_start", "parameter", "rad", f"angle of {name}", q) for i, name, q, _ in at_joints),
        *(Variable(f"omega{i}_start", "parameter", "rad/s", f"rate of {name}", rate) for i, name, _, rate in at_joints),
        *(
            Variable(f"P{j}_start", "parameter", "Pa", f"pressure of {name} at the beginning, and its command", start)
            for j, name, start in at_muscles
        ),
        *(Variable(f"theta{i}", "output", "rad", f"angle of {name}") for i, name in joints),
        *(Variable(f"omega{i}", "output", "rad/s", f"rate of {name}") for i, name in joints),
        *(Variable(f"P{j}", "output", "Pa", f"pressure of {name}, gauge") for j, name in muscles),
        *(Variable(f"theta{i}_measured", "output", "rad", f"angle of {name} {step}") for i, name in joints),
        *(Variable(f"K{entry}", "output", "N.m/rad", "stiffness of the joint" + "s" * (n > 1)) for entry in entries),
        *(Variable(f"T{i}", "output", "N.m", f"torque of the muscles about {name}") for i, name in joints),
        *(Variable(f"F{j}", "output", "N", f"force of {name}; negative: slack") for j, name in muscles),
    ]
    return [variable._replace(finite=variable.causality != "output") for variable in variables]


def controller_variables(controller: TrackingMPC, x0: Array) -> list[Variable]:
    """Return the variables of a controller and its observer, with the initial state `x0` (2n + m,), at rest.

    Rows of references have sample after sample; a stiffness matrix is its upper triangle, row after row.
    """
    plant, samples = controller.plant, controller.ahead + 1
    joints, muscles = _labels(plant)
    theta, P = x0[: plant.n], x0[2 * plant.n :]
    K = np.atleast_2d(plant.tracked_stiffness(x0))
    entries = K[np.triu_indices(len(K))]
    of_K = "reference of the stiffness" + ", upper triangles" * (plant.n > 1)
    return [
        *(
            Variable(f"theta{i}", "input", "rad", f"measured angle of {name}; NaN: not measured", start)
            for (i, name), start in zip(joints, theta.tolist(), strict=True)
        ),
        *(
            Variable(f"P{i}", "input", "Pa", f"measured pressure of {name}, gauge; NaN: not measured", start)
            for (i, name), start in zip(muscles, P.tolist(), strict=True)
        ),
        Variable(
            "theta_ref", "input", "rad", "reference of the angles, now and at the samples to come",
            np.tile(theta, samples).tolist(),
        ),
        Variable(
            "K_ref", "input", "N.m/rad", f"{of_K}, now and at the samples to come", np.tile(entries, samples).tolist()
        ),
        *(Variable(f"u{i}", "output", "Pa", f"command for {name}") for i, name in muscles),
        Variable("status", "output", None, "of the plan, as PlanStatus"),
        Variable("rung", "output", None, "of the plan, as Rung"),
    ]  # fmt: skip


def _labels(plant: Machine) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
    """Return suffixes and names of the joints and of the muscles."""
    joints, muscles = (list(enumerate(names, 1)) for names in names_of(plant))
    suffixes = [""] if isinstance(plant, Plant) else [str(i) for i, _ in joints]
    return [(i, name) for i, (_, name) in zip(suffixes, joints, strict=True)], [(str(j), name) for j, name in muscles]


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
