"""Sizes, numbers and tables of an exported controller and its observer.

Rest mode as C (`resting.h`, `resting.c`), printed from the Python source that runs in Python.
"""

from collections.abc import Iterator
from functools import cache

import numpy as np

from allocator.calculus import Array
from allocator.compilation.printer import (
    REAL,
    ArrayKind,
    Kind,
    StructKind,
    c_functions,
    number,
    with_called,
)
from allocator.errors import InvalidInput
from allocator.units import BAR
from mpc.export import text
from mpc.export.controller.certificate import COMPILER, certificate
from mpc.export.controller.demonstration import control_tables
from mpc.export.controller.model import (
    check_frictions,
    friction_numbers,
    friction_sizes,
    friction_tables,
    variational_of,
)
from mpc.export.controller.recursions import items_in, recursion_files
from mpc.export.controller.tuning import tuning_constants, tuning_definition
from mpc.export.joint import Numbers
from mpc.export.parts import Files, copied
from mpc.model import compensation
from mpc.model.arm.compiled.module import moving
from mpc.model.arm.model import Arm
from mpc.model.experiment import RESOLUTION
from mpc.model.machine import Machine
from mpc.observer import gating, kalman, rivalry
from mpc.observer.filter import OFFSET_TIME, SETTLED
from mpc.observer.kalman import KalmanObserver
from mpc.tracking import preview, resting
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.feedforward import InverseDynamics
from mpc.tracking.qp.step import ACCURACY
from mpc.tracking.rest_memory import Memory, Rules

_N, _M, _SAMPLES = "ANT_JOINTS", "ANT_MUSCLES", "(ANT_HORIZON + 1)"
_ENTRIES = (
    resting.clear, resting.begin, resting.constant, resting.decided, resting.turn,
    resting.holds, resting.rings, resting.side, resting.pressure, resting.angle,
)  # fmt: skip


@cache
def resting_files(single: bool) -> dict[str, str]:
    """Return the files of the rest mode, which are the same for every machine; antagonist_config.h has the sizes."""
    memory = StructKind.of(Memory, "ant_rest", {"n": _N, "m": _M}, holds=True)
    rules = StructKind.of(Rules, "ant_rest_rules", {})
    names = {entry.__name__: f"ant_rest_{entry.__name__}" for entry in _ENTRIES}
    made = c_functions(with_called([*_ENTRIES]), _kinds(memory, rules), single, names, {})
    about = "Rest mode: commands that rest at a constant reference; printed from the Python source."
    head = "\n\n".join([memory.definition(), rules.definition(), made.head])
    return {
        "src/resting.h": text.header("ANT_RESTING_H", about, head),
        "src/resting.c": f'/* {about} */\n#include "antagonist.h"\n#include "real.h"\n\n{made.body}\n',
    }


def rest_rules(controller: TrackingMPC, single: bool) -> str:
    """Return the definition of `ANT_REST_RULES`."""
    listed = ",\n".join(
        f"    {number(float(value), single)} /* {name} */"
        for name, value in controller.rest_mode.rules._asdict().items()
    )
    return f"const ant_rest_rules ANT_REST_RULES = {{\n{listed}}};"


def _kinds(memory: StructKind, rules: StructKind) -> dict[str, Kind]:
    """Return the kinds of arguments, by their names in all functions."""
    preview, matrices = f"{_N} * {_SAMPLES}", f"{_N} * {_N} * {_SAMPLES}"
    given = {"theta": preview, "stiffness": matrices, "seen": "ANT_STATES", "expected": _N, "slopes": f"{_N} * {_M}"}
    arrays = {name: ArrayKind(REAL, (size,), True) for name, size in given.items()}
    return {"m": memory, "k": rules, **arrays}


def check_pair(controller: TrackingMPC, observer: KalmanObserver) -> None:
    """Check that controller and observer match, and that C supports their settings. Raises `InvalidInput`."""
    if controller.budget is not None:
        raise InvalidInput(
            f"a controller with a budget of {controller.budget:g} s cannot be exported: the exported one has no clock; "
            "leave the budget away and bound the exchanges of its QP solver instead"
        )
    if getattr(controller.plant, "shares", None) is not None:
        raise InvalidInput(
            f"a controller of the {controller.plant.kind.text} cannot be exported: the exported "
            "allocation gives the isobaric one; leave the plant's frequency away"
        )
    for name in ("plant", "dt", "compensation"):
        if getattr(controller, name) != getattr(observer, name):
            raise InvalidInput(f"controller and observer cannot be exported together: their {name} is not the same")
    check_frictions(controller.compensation, controller.plant.n)


def sizes_of(controller: TrackingMPC, single: bool) -> Numbers:
    """Return the sizes that antagonist_config.h defines."""
    blocks, known, dt = len(controller.problem.blocks), controller.compensation, controller.dt
    plant, bounds = controller.plant, certificate(controller, single)
    return (
        {
            "JOINTS": (plant.n, "n"),
            "MUSCLES": (plant.m, "m"),
            "STIFFNESSES": (plant.stiffnesses, "entries of a stiffness"),
            "HORIZON": (controller.N, "horizon in samples"),
            "BLOCKS": (blocks, "samples at which its commands may leave the previous plan"),
            "DELAY": (known.delay(dt), "dead time in samples"),
            "AGE": (known.age(dt), "age of the angle's readings in samples"),
            "OLDER": (known.older(dt), "rest of that age [s]"),
            "SUBSTEPS": (plant.substeps(dt, RESOLUTION), "integration steps per sample"),
            "AHEAD": (controller.ahead, "samples of reference after the present one"),
            "ITEMS": (
                items_in(plant.n, plant.m, blocks, single),
                "maximum number of limits that differ from those of a sweep",
            ),
            "EXCHANGES": (bounds.exchanges, "maximum number of exchanges in a QP; may be set smaller"),
            "QP_SWEEPS": (f"({bounds.sweeps - bounds.exchanges} + ANT_EXCHANGES)", "maximum number of sweeps in a QP"),
            "QP_MULTIPLICATIONS": (
                f"({bounds.begin} + {bounds.exchange}LL * ANT_EXCHANGES)",
                "maximum number of multiplications and divisions in a QP",
            ),
            "STACK": (bounds.stack, f"bytes of the stack of ant_step, measured with {COMPILER}"),
        }
        | friction_sizes(known.of_joints(plant.n))
        | _sizes_of_kind(plant)
    )


def _sizes_of_kind(plant: Machine) -> Numbers:
    if isinstance(plant, Arm):
        gas = {} if plant.gas is None else {"GAS": (1, "motion compresses the gas in the muscles")}
        integrated = (moving(plant), "entries of a state that are integrated")
        return {"ARM": (1, "a machine of any number of joints and muscles"), "MOVING": integrated, **gas}
    varied = plant.size + variational_of(plant).nnz_in(1)
    return {"VARIED": (varied, "numbers of a motion with its derivatives, see motion.h")}


def control_files(controller: TrackingMPC, observer: KalmanObserver, single: bool) -> Files:
    """Return the controller's files except those of the allocation and the model."""
    files = dict(copied("mpc", "src/")) | dict(copied("tuning", "src/"))
    arm = isinstance(controller.plant, Arm)
    files |= dict(copied("arm" if arm else "pair", "src/"))
    files |= recursion_files(controller.plant, single) | resting_files(single)
    for header in ("antagonist_control.h", "antagonist_controller.h"):
        files[header] = files.pop(f"src/{header}")
    numbers = text.defines(_numbers(controller, observer, single), single)
    files["src/settings.h"] = text.header(
        "ANT_SETTINGS_H", "The controller's numbers, in SI units.", numbers, ["mechanism.h" if arm else "joint.h"]
    )
    heads, bodies = ["extern const ant_rest_rules ANT_REST_RULES;"], [rest_rules(controller, single)]
    for name, meaning, values in _tables(controller, observer):
        heads.append(text.table_head(name, meaning, values))
        bodies.append(text.table(name, values, single))
    bodies.append(tuning_definition(controller, single))
    about = "The controller's tables."
    files["src/tables.h"] = text.header("ANT_TABLES_H", about, "\n".join(heads), ["antagonist.h"])
    files["src/tables.c"] = f'/* {about} */\n#include "tables.h"\n\n' + "\n\n".join(bodies) + "\n"
    return files


def _numbers(controller: TrackingMPC, observer: KalmanObserver, single: bool) -> Numbers:
    """Return the numbers of settings.h."""
    late = 1 + (1e-4 if single else 1e-9)  # rounding of a time that is summed from samples
    friction = friction_numbers(controller.compensation.of_joints(controller.plant.n))
    return tuning_constants(controller) | friction | _of_controller(controller, late) | _of_observer(observer, late)


def _of_controller(controller: TrackingMPC, late: float) -> Numbers:
    return {
        "DT": (controller.dt, "sample time [s]"),
        "BAR": (BAR, "[Pa]"),
        "ITERATIONS": (controller.iterations, "QPs per step"),
        "PATIENCE": (controller.patience * late, "longest time without a measured angle [s]"),
        "HOLDING": (controller.ladder.holding, "time that the last rung holds the pressures [s]"),
        "VENTING": (controller.ladder.venting, "rate at which they fall afterwards [Pa/s]"),
        "ACCURACY": (ACCURACY, "greatest distance of an answer's changes to the solution's [bar]"),
        "LONG": (2**30, "samples, upper end of every counter"),
        "RESTS": (int(controller.rests), "whether commands come to rest at a constant reference"),
        "JITTER": (compensation.JITTER, "smaller motions count as angle noise [rad]"),
        "CORRECTED": (preview.CORRECTED, "share of an angle's error that counts as motion [-]"),
        "DEAD_BAND": (controller.compensation.dead_band, "total dead band of the regulators [Pa]"),
        "SOFT": (compensation.SOFT, "smoothing width of the dead-band inverse [Pa]"),
    }


def _of_observer(observer: KalmanObserver, late: float) -> Numbers:
    """Return the numbers of the observer, its gates and its rivals."""
    gate, rival, dt = observer.gate, observer.rivalry, observer.dt
    return {
        "TOLERANCE": (observer.tolerance, "longest time that a sensor may be silent or frozen [s]"),
        "TOLERANCE_END": (observer.tolerance * late, "the same, rounded up [s]"),
        "SIGMAS": (gating.SIGMAS, "standard deviations beyond which a reading is rejected"),
        "ROUGH": (gating.ROUGH, "standard deviations of the noise within which no reading is rejected"),
        "MOST_TURNS": (gating.MOST_TURNS, "upper bound of the whole turns of an encoder error"),
        "NEAR_A_TURN": (
            gating.NEAR_A_TURN,
            "distance from the expected angle up to which whole turns are removed [rad]",
        ),
        "GATE_GROWTH": (dt / gate.widening, "growth per sample of the width of a gate that rejects [-]"),
        "MAX_SPEED": (gate.max_speed, "greatest estimated speed [rad/s]"),
        "MAX_TORQUE": (gate.max_torque, "greatest estimated disturbance torque [N*m]"),
        "HESITATION": (rival.hesitation, "samples in which a rival has to explain rejected readings"),
        "GATE_PATIENCE": (rival.patience, "the same after a jump"),
        "CROSSING": (rival.crossing, "samples without a rejection after which there is no rival"),
        "FIRST": (kalman.FIRST, "first samples, in which rejected readings may be right"),
        "REPEATED": (rivalry.ONCE * dt, "longest repetition of an angle reading at a reversal [s]"),
        "COARSEST": (kalman.COARSEST, "greatest resolution step of an encoder [rad]"),
        "ROUNDING": (gating.ROUNDING, "change of an angle up to which it is no step of an encoder [rad]"),
        "LEARNING": (dt / OFFSET_TIME, "share of an innovation that is added to a pressure offset"),
        "SETTLED": (SETTLED, "distance to the command within which a pressure shows its offset [Pa]"),
        "MOST_OFFSET": (observer.noise.offset, "greatest offset of a pressure sensor to its regulator [Pa]"),
        "ENCODER_NOISE": (observer.noise.theta, "least standard deviation of the angle noise [rad]"),
        "DOUBT": (gating.DOUBT, "standard deviations from which a repeated reading is rejected"),
    }


def _integration(plant: Machine, dt: float) -> Iterator[tuple[str, str, Array]]:
    """Yield the remaining shares of pressure errors at beginning, middle and end of an arm's integration steps."""
    if isinstance(plant, Arm):
        times = dt / (count := plant.substeps(dt, RESOLUTION)) * (np.arange(count)[:, None] + [0.0, 0.5, 1.0])
        yield (
            "ANT_DECAY",
            "remaining shares of pressure errors along a sample [-]",
            np.exp(-times.reshape(-1, 1) / plant.lags),
        )


def _factors(plant: Machine) -> Array:
    """Return the factors of the entries of svec K."""
    return plant.entries[2] if isinstance(plant, Arm) else np.ones(1)


def _tables(controller: TrackingMPC, observer: KalmanObserver) -> list[tuple[str, str, Array]]:
    plant, dt, starts = controller.plant, controller.dt, np.asarray(controller.problem.starts)
    inverse = InverseDynamics(plant, dt, controller.N)
    acting = np.searchsorted(starts, np.arange(controller.N), side="right")
    return [
        ("ANT_WAY_LAGS", "time constants of rising and of falling pressures [s]", inverse.lags),
        ("ANT_WAY_KEPT", "remaining shares of their errors after a sample [-]", inverse.alpha),
        ("ANT_KEPT", "remaining share of a pressure error after a sample [-]", np.exp(-dt / np.array(plant.lags))),
        ("ANT_REACH", "errors at which pressures rise and fall the fastest [Pa]", observer.filter.reach),
        ("ANT_SHARES", "shares of a step that a quick and a slow one follow in a sample [-]", observer.filter.shares),
        ("ANT_STARTS", "samples at which blocks of commands begin", starts),
        ("ANT_ACTING", "blocks that have begun by a sample", acting),
        ("ANT_Q_NOISE", "variance of the model's errors over a sample", np.diag(observer.filter.Q)),
        ("ANT_Q_REST", "the same for each sensor that repeats itself", np.diagonal(observer.filter.Q_rest, 0, 1, 2)),
        ("ANT_LEAST_ANGLE", "ends of the joint ranges [rad]", np.atleast_1d(plant.angle_limits[0])),
        ("ANT_MOST_ANGLE", "[rad]", np.atleast_1d(plant.angle_limits[1])),
        ("ANT_SVEC", "factors of a stiffness' entries in the cost [-]", _factors(plant)),
        ("ANT_R_NOISE", "variance of the sensors of angles and pressures", np.diag(observer.filter.R)),
        ("ANT_GATE_LOWER", "least possible readings of angles and pressures", np.array(observer.gate.lower)),
        ("ANT_GATE_UPPER", "greatest possible readings", np.array(observer.gate.upper)),
        ("ANT_GATE_FLOOR", "distances from expected readings that are accepted", np.array(observer.gate.floor)),
        ("ANT_GATE_JUMP", "distances accepted only after a jump's patience", np.array(observer.gate.jump)),
        ("ANT_UNSURE", "variance of an estimate from the readings alone", np.diag(observer.filter.unsure)),
        ("ANT_COVARIANCE", "initial covariance of the observer", observer.filter.stationary),
        *control_tables(plant),
        *_integration(plant, dt),
        *friction_tables(controller.compensation.of_joints(plant.n)),
    ]
