"""Plants as C, for simulated boards on a PC and for FMUs."""

import numpy as np

from allocator.calculus import Array
from allocator.compilation.printer import number
from allocator.errors import InvalidInput
from mpc.codegen import c_text
from mpc.export import text
from mpc.export.joint import Numbers
from mpc.export.parts import Files, Functions, copied, dense
from mpc.model.plant import NU, NX, Plant
from mpc.model.real_experiment import delayed, fine_steps
from mpc.model.real_plant import RealPlant

_PLAIN = (
    "typedef double ant_real;\n#define ANT_F(function) function\n#define ANT_NAN NAN\n#define ANT_INFINITY INFINITY\n"
)


def real_plant(process: Plant | RealPlant) -> RealPlant:
    """Return `process` as a real plant that C can simulate.

    Raises InvalidInput for faults, a torque profile, delayed readings and pressure offsets.
    """
    real = RealPlant(process) if isinstance(process, Plant) else process
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


def plant_files(process: Plant | RealPlant, dt: float, directory: str = "") -> Files:
    """Return the C files of a plant with steps of `dt` [s], with paths below `directory`."""
    real = real_plant(process)
    heads, bodies = [], []
    for function, about in _functions(real):
        heads.append(f"{c_text.prototype(function)}; /* {about} */")
        bodies.append(c_text.function(function, about, single=False))
    about = "The plant's formulas, derived by CasADi."
    body = f'/* {about} */\n#include "plant_model.h"\n\n#include <math.h>\n\n' + "\n\n".join(bodies) + "\n"
    head = text.header("ANT_PLANT_MODEL_H", about, _PLAIN + "\n" + "\n".join(heads), ["math.h"])
    return dict(copied("plant", directory)) | {
        f"{directory}plant_model.h": head,
        f"{directory}plant_model.c": body,
        f"{directory}plant_numbers.h": _numbers(real, dt),
    }


def _functions(real: RealPlant) -> Functions:
    import casadi as ca

    n = NX + real.friction.size
    full, u, d, h = ca.SX.sym("full", n), ca.SX.sym("u", NU), ca.SX.sym("d"), ca.SX.sym("h")
    x, start = full[:NX], ca.SX.sym("start", NX)
    later = ca.vertcat(*real.stepped(x, full[NX:], u, d, h))
    at_0, at_1 = (np.atleast_1d(real.friction.begun(angle)) for angle in (0.0, 1.0))  # affine in the angle
    begun = ca.vertcat(start, ca.DM(at_0) + ca.DM(at_1 - at_0) * start[0])
    outputs = {"K": ca.SX(real.stiffness(x)), "T": ca.SX(real.torque(x)), "F": ca.vertcat(*real.forces(x))}

    return [
        (
            dense("plant_begin", {"start": start}, {"full": begun}),
            "the initial state, from theta, rate, P1, P2",
        ),
        (
            dense("plant_step", {"full": full, "u": u, "d": d, "h": h}, {"later": later}),
            "the state after h [s]",
        ),
        (dense("plant_outputs", {"full": full}, outputs), "stiffness, torque and both forces"),
    ]


def _numbers(real: RealPlant, dt: float) -> str:
    """Return plant_numbers.h, with the dead time divided into samples as in the Python simulation."""
    pieces, waiting = delayed(real.dead_time, dt)
    numbers: Numbers = {
        "PLANT_STATES": (NX + real.friction.size, "numbers of the state"),
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


def start_of(real: RealPlant) -> Array:
    """Return the initial state (4,): at rest in the middle of the joint range, with both pressures in mid supply."""
    joint = real.nominal.joint
    low, high = joint.pressure_limits
    middle = float(np.mean(joint.angle_range))
    K = float(real.nominal.stiffness(np.array([middle, 0.0, (low + high) / 2, (low + high) / 2])))
    return real.at_rest(middle, K)
