"""Plants as C, for simulated boards on a PC and for FMUs."""

import numpy as np
from numpy.typing import ArrayLike

from allocator.calculus import Array
from allocator.compilation.printer import number
from allocator.errors import InvalidInput
from mpc.codegen.text import c_function, c_prototype
from mpc.export import text
from mpc.export.controller.demonstration import arm_at_rest
from mpc.export.joint import Numbers
from mpc.export.parts import Files, Functions, copied, dense
from mpc.model.arm.model import Arm
from mpc.model.machine import Machine
from mpc.model.real import real_of
from mpc.model.real_experiment import RealMachine, delayed, fine_steps
from mpc.trials.simulation import state

_PLAIN = """\
typedef double ant_real;
#define ANT_F(function) function
#define ANT_NAN NAN
#define ANT_INFINITY INFINITY
#define ant_equal(a, b) ((a) <= (b) && (a) >= (b))
"""


def real_machine(process: Machine | RealMachine) -> RealMachine:
    """Return `process` as a real machine that C can simulate.

    Raises InvalidInput for faults, a torque profile, delayed readings, pressure offsets and arms without formulas.
    """
    real = real_of(process)
    if real.faults:
        raise InvalidInput(f"a plant with faults ({len(real.faults)} of them) cannot be exported; leave them away")
    if real.reading_age or any(real.pressure_offset):
        raise InvalidInput("a plant with reading_age or pressure_offset cannot be exported; leave them away")
    if real.torque_profile:
        raise InvalidInput(
            f"a plant with torque_profile = {real.torque_profile} cannot be exported: its torque comes from outside, "
            "as the input d [N·m]; leave the profile away"
        )
    return real


def plant_files(process: Machine | RealMachine, dt: float, directory: str = "") -> Files:
    """Return the C files of a plant with steps of `dt` [s], with paths below `directory`."""
    real = real_machine(process)
    heads, bodies = [], []
    for function, about in _functions(real):
        heads.append(f"{c_prototype(function)}; /* {about} */")
        bodies.append(c_function(function, about, single=False))
    about = "The plant's formulas, derived by CasADi."
    body = f'/* {about} */\n#include "plant_model.h"\n\n#include <math.h>\n\n' + "\n\n".join(bodies) + "\n"
    head = text.header("ANT_PLANT_MODEL_H", about, _PLAIN + "\n" + "\n".join(heads), ["math.h"])
    return dict(copied("plant", directory)) | {
        f"{directory}plant_model.h": head,
        f"{directory}plant_model.c": body,
        f"{directory}plant_numbers.h": _numbers(real, dt),
    }


def _functions(real: RealMachine) -> Functions:
    import casadi as ca

    size = real.nominal.size
    full, start = ca.SX.sym("full", _states(real)), ca.SX.sym("start", size)
    u, d, h = ca.SX.sym("u", real.nominal.m), ca.SX.sym("d", real.nominal.n), ca.SX.sym("h")
    later = ca.vertcat(*real.stepped(full[:size], full[size:], u, d, h))
    memories = []
    for i, friction in enumerate(real.frictions):
        at_0, at_1 = (np.atleast_1d(friction.begun(angle)) for angle in (0.0, 1.0))  # affine in the angle
        memories.append(ca.DM(at_0) + ca.DM(at_1 - at_0) * start[i])
    begun = ca.vertcat(start, *memories)
    outputs = dict(zip("KTF", real.symbolic_outputs(full[:size]), strict=True))

    return [
        (
            dense("plant_begin", {"start": start}, {"full": begun}),
            "the initial state, from angles, rates, pressures",
        ),
        (
            dense("plant_step", {"full": full, "u": u, "d": d, "h": h}, {"later": later}),
            "the state after h [s]",
        ),
        (dense("plant_outputs", {"full": full}, outputs), "stiffness by its upper triangle, torques and forces"),
    ]


def _states(real: RealMachine) -> int:
    """Return the number of states, with the memory of the frictions."""
    return int(real.nominal.size + sum(friction.size for friction in real.frictions))


def _numbers(real: RealMachine, dt: float) -> str:
    """Return plant_numbers.h, with the dead time divided into samples as in the Python simulation."""
    pieces, waiting = delayed(real.dead_time, dt)
    numbers: Numbers = {
        "PLANT_JOINTS": (real.nominal.n, "n"),
        "PLANT_MUSCLES": (real.nominal.m, "m"),
        "PLANT_STATES": (_states(real), "numbers of the state"),
        "PLANT_WAITING": (waiting, "commands in transit between two samples"),
        "PLANT_PIECES": (len(pieces), "of a sample in which the command is another"),
        "PLANT_DT": (dt, "sample time [s]"),
        "PLANT_ENCODER": (real.encoder, "step of the encoder, 0 if it has none [rad]"),
        "PLANT_NOISE": (real.pressure_noise, "standard deviation of the pressure sensors [Pa]"),
    }
    durations = ", ".join(number(piece, single=False) for piece in pieces)
    steps = ", ".join(map(str, fine_steps(real, dt, pieces)))
    body = (
        f"{text.defines(numbers, single=False)}\n#define ANT_PLANT_DURATIONS {{{durations}}} /* of the pieces [s] */"
        f"\n#define ANT_PLANT_STEPS {{{steps}}} /* of integration in each of them */"
    )
    return text.header("ANT_PLANT_NUMBERS_H", "The plant's sizes and numbers, in SI units.", body)


def start_of(real: RealMachine, x0: ArrayLike | None = None) -> Array:
    """Return the initial state `x0` (2n + m,), by default at rest in the middle of the ranges, with the stiffness of
    mid supply. Raises InvalidInput.
    """
    if x0 is None:
        return _middle(real)
    return state(x0, real.nominal.size, real.nominal.n)


def _middle(real: RealMachine) -> Array:
    if isinstance(real.nominal, Arm):
        return arm_at_rest(real.nominal)[0]
    joint = real.nominal.joint
    low, high = joint.pressure_limits
    middle = float(np.mean(joint.angle_range))
    K = float(real.nominal.stiffness(np.array([middle, 0.0, (low + high) / 2, (low + high) / 2])))
    return real.at_rest(middle, K)
