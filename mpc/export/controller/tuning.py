"""Tuning of an exported controller on the bench: weights, slack prices, slew and least force, as numbers for C.

The terminal cost follows from the weights by an algebraic Riccati equation of the plant at the sample time. Python
solves it, and C takes all numbers together, in the order of `ant_tuning`. Two numbers precede them and must equal those
of the build: the sample time, and a number of the plant.
"""

from dataclasses import replace
from os import PathLike

import numpy as np

from allocator.calculus import Array
from allocator.compilation.printer import number
from allocator.errors import InvalidInput
from allocator.files.atomic import write_text
from allocator.shell.options import numbers, within
from allocator.units import BAR, DEG
from mpc.export.joint import Numbers
from mpc.model.arm.model import Arm
from mpc.model.machine import Machine
from mpc.tracking.compiled.factory import setting
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.cost import Weights

Entry = tuple[str, Array]  # description and values


def plant_number(plant: Machine, dt: float) -> float:
    """Return a number that identifies the plant of a tuning: a weighted sum of its motion in one sample."""
    (left, right), most, n, m = map(np.atleast_1d, plant.angle_limits), plant.pressure_limits[1], plant.n, plant.m
    x = np.concatenate([left + 0.6 * (right - left), np.ones(n), most * np.linspace(0.4, 0.7, m)])
    moved = np.array(plant.discrete(dt)(x, most * np.linspace(0.8, 0.5, m), np.full(n, 0.3))).ravel() - x
    weights = np.concatenate([1.0 + np.arange(n), 2.0 + np.arange(n), (1.0 + np.arange(m)) / BAR])
    return float(moved @ weights / dt)


def tuning_numbers(controller: TrackingMPC) -> list[Entry]:
    """Return the fields of `ant_tuning`, in their order."""
    problem, limits = controller.problem, controller.limits
    made = setting(problem, in_bar=isinstance(controller.plant, Arm))
    return [
        ("weights of angles, their rates, pressures", made.cost.x),
        ("of the outputs, stiffness and forces", made.cost.y),
        ("of the commands away from the feed-forward [1/bar^2]", made.cost.e),
        ("and of their changes [1/bar^2]", made.cost.change),
        ("of the state at the end of the horizon, rows", made.cost.end),
        ("prices of the slacks [1/rad], [1/rad^2], [1/N], [1/N^2]", made.slack),
        ("curvature of the cost [1/bar^2]", np.array([problem.curvature])),
        ("greatest change of a command in a sample [Pa]", np.array([limits.step])),
        ("least force of the muscles [N]", np.array([limits.min_force])),
    ]


def tuning_definition(controller: TrackingMPC, single: bool) -> str:
    """Return the definition of `ANT_TUNING`, the initial tuning of the build."""
    lines = [f"    /* {what} */\n    {_listed(values, single)}," for what, values in tuning_numbers(controller)]
    return "\n".join(["const ant_tuning ANT_TUNING = {", *lines, "};"])


def _listed(values: Array, single: bool) -> str:
    """Return an initialiser; a single number has no braces."""
    if values.ndim == 2:
        return "{" + ",\n     ".join(_listed(row, single) for row in values) + "}"
    listed = ", ".join(number(value, single) for value in values.tolist())
    return listed if values.size == 1 else f"{{{listed}}}"


def tuning_constants(controller: TrackingMPC) -> Numbers:
    """Return the definitions by which the build recognises its tunings."""
    return {"PLANT": (plant_number(controller.plant, controller.dt), "a tuning's second number, see tuning.c")}


def tuning_text(controller: TrackingMPC) -> str:
    """Return the numbers for `ant_tuning_from` as text, one per line, with descriptions after `#`."""
    entries = [
        ("sample time [s], that of the build", np.array([controller.dt])),
        ("of the plant, that of the build", np.array([plant_number(controller.plant, controller.dt)])),
        *tuning_numbers(controller),
    ]
    lines = ["# A tuning for a controller in C, see ant_tuning_from in antagonist.h"]
    for what, values in entries:
        first, *others = (repr(float(value)) for value in np.ravel(values))
        lines += [f"{first}  # {what}", *others]
    return "\n".join(lines) + "\n"


_ERRORS = {"theta": DEG, "omega": DEG, "K": 1.0, "u": BAR, "rate": BAR}  # SI value of the unit of each error


def write_tuning(path: str | PathLike[str], controller: TrackingMPC) -> None:
    """Write a tuning that gives an exported controller other weights without a compiler.

    `controller` may differ from that of the build only in `weights`, `min_force` and the plant's `slew`. The file has
    one number per line, for `ant_tuning_from`, and suits both precisions. Raises `CannotWrite`.
    """
    write_text(path, tuning_text(controller))


def weights_from(errors: str) -> Weights:
    """Return the default weights of the export, some changed by errors that cost one half: "theta=0.1,rate=0.3".

    Units are degrees, degrees/s, N·m/rad, bar and bar/s. Raises `InvalidInput`.
    """
    changed = {}
    for part in errors.split(","):
        name, _, value = (piece.strip() for piece in part.partition("="))
        if name not in _ERRORS:
            raise InvalidInput(f"--errors {part.strip()!r}: expected NAME=ERROR, NAME being {', '.join(_ERRORS)}")
        [error] = numbers(f"--errors {name}", value, 1, 1, f"{name}=0.5")
        within(f"--errors {name}", error, "(an error that costs one half)", 1e-9, 1e9)
        changed[name] = 1 / (error * _ERRORS[name]) ** 2
    return replace(Weights.calm(), **changed)
