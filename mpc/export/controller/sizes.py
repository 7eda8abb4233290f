"""Sizes, numbers, tables and model of an exported controller and its observer."""

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.units import BAR
from mpc.export import text
from mpc.export.controller.demonstration import control_numbers
from mpc.export.controller.friction import (
    check_friction,
    friction_function,
    friction_numbers,
    friction_sizes,
    friction_tables,
)
from mpc.export.controller.recursions import EXCHANGES, items_in, recursion_files
from mpc.export.controller.tuning import tuning_constants, tuning_definition
from mpc.export.joint import Numbers
from mpc.export.parts import Files, Functions, copied, dense
from mpc.model import compensation
from mpc.model.plant import NU, NX
from mpc.observer import gating, kalman, rivalry
from mpc.observer.filter import OFFSET_TIME, SETTLED
from mpc.observer.kalman import KalmanObserver
from mpc.tracking import preview, resting
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.feedforward import InverseDynamics
from mpc.tracking.qp import certified


def check_pair(controller: TrackingMPC, observer: KalmanObserver) -> None:
    """Check that controller and observer match, and that C supports their settings. Raises `InvalidInput`."""
    if controller.budget is not None:
        raise InvalidInput(
            f"a controller with a budget of {controller.budget:g} s cannot be exported: the exported one has no clock; "
            "leave the budget away and bound the iterations of its QP solver instead"
        )
    if controller.plant.shares is not None:
        raise InvalidInput(
            f"a controller of the {controller.plant.kind.text} cannot be exported: the exported "
            "allocation gives the isobaric one; leave the plant's frequency away"
        )
    for name in ("plant", "dt", "compensation"):
        if getattr(controller, name) != getattr(observer, name):
            raise InvalidInput(f"controller and observer cannot be exported together: their {name} is not the same")
    check_friction(controller.compensation.friction)


def sizes_of(controller: TrackingMPC, single: bool) -> Numbers:
    """Return the sizes that antagonist_config.h defines."""
    blocks, known, dt = len(controller.problem.blocks), controller.compensation, controller.dt
    return {
        "HORIZON": (controller.N, "horizon in samples"),
        "BLOCKS": (blocks, "samples at which its commands may leave the previous plan"),
        "DELAY": (known.delay(dt), "dead time in samples"),
        "AGE": (known.age(dt), "age of the angle's readings in samples"),
        "AHEAD": (controller.ahead, "samples of reference after the present one"),
        "ITEMS": (items_in(blocks, single), "maximum number of limits that differ from those of a sweep"),
        "EXCHANGES": (
            EXCHANGES * 2 * blocks,
            "maximum number of exchanges in a QP; may be set smaller",
        ),
    } | friction_sizes(controller.compensation.friction)


def control_files(controller: TrackingMPC, observer: KalmanObserver, single: bool) -> Files:
    """Return the controller's files except those of the allocation and the model."""
    files = dict(copied("mpc", "src/")) | dict(copied("tuning", "src/"))
    files |= recursion_files(single)
    files["antagonist_controller.h"] = files.pop("src/antagonist_controller.h")
    numbers = text.defines(_numbers(controller, observer, single), single)
    files["src/settings.h"] = text.header(
        "ANT_SETTINGS_H", "The controller's numbers, in SI units.", numbers, ["joint.h"]
    )
    heads, bodies = [], []
    for name, meaning, values in _tables(controller, observer):
        heads.append(text.table_head(name, meaning, values))
        bodies.append(text.table(name, values, single))
    bodies.append(tuning_definition(controller, single))
    about = "The controller's tables."
    files["src/tables.h"] = text.header("ANT_TABLES_H", about, "\n".join(heads), ["antagonist.h"])
    files["src/tables.c"] = f'/* {about} */\n#include "tables.h"\n\n' + "\n\n".join(bodies) + "\n"
    return files


def model_functions(controller: TrackingMPC) -> Functions:
    """Return the CasADi functions of the plant and its friction, each with its description."""
    import casadi as ca

    plant, dt = controller.plant, controller.dt
    x, u, d = ca.SX.sym("x", NX), ca.SX.sym("u", NU), ca.SX.sym("d")
    later = plant.discrete(dt)(x, u, d)
    A, B, by_d = (ca.jacobian(later, v).T for v in (x, u, d))  # CasADi stores columns, C rows
    K, F = ca.SX(plant.stiffness(x)), ca.vertcat(*plant.forces(x))
    C, D = ca.gradient(K, x), ca.jacobian(F, x).T
    gains = [ca.SX(side.torque_gain(P)) for side, P in zip(plant.joint.sides(x[0]), (x[2], x[3]), strict=True)]

    state, stage = {"x": x}, {"x": x, "u": u, "d": d}
    return [
        (dense("stage", stage, {"later": later}), "the state after a sample"),
        (
            dense("slopes", stage, {"later": later, "A": A, "B": B, "by_d": by_d}),
            "the same with its derivatives by x (4, 4), u (4, 2) and d (4)",
        ),
        (dense("outputs", state, {"K": K, "F": F}), "stiffness and both forces"),
        (dense("gradients", state, {"C": C, "D": D}), "their derivatives by x, (4) and (2, 4)"),
        (dense("gains", state, {"gains": ca.vertcat(*gains)}), "derivatives of both torques by the pressures"),
        friction_function(controller.compensation.friction, plant),
        (
            dense("expansion", state, {"q": ca.SX(ca.vertcat(*plant.expansion(x)))}),
            "pressure loss by expansion of the muscles [Pa/s]",
        ),
    ]


def _numbers(controller: TrackingMPC, observer: KalmanObserver, single: bool) -> Numbers:
    plant, known, ladder = controller.plant, controller.compensation, controller.ladder
    late = 1 + (1e-4 if single else 1e-9)  # rounding of a time that is summed from samples
    dt = controller.dt
    return (
        tuning_constants(controller)
        | friction_numbers(known.friction)
        | _rest(controller)
        | control_numbers(plant)
        | {
            "DT": (dt, "sample time [s]"),
            "BAR": (BAR, "[Pa]"),
            "ITERATIONS": (controller.iterations, "QPs per step"),
            "PATIENCE": (controller.patience * late, "longest time without a measured angle [s]"),
            "HOLDING": (ladder.holding, "time that the last rung holds the pressures [s]"),
            "VENTING": (ladder.venting, "rate at which they fall afterwards [Pa/s]"),
            "ACCURACY": (certified.ACCURACY, "greatest distance of an answer's changes to the solution's [bar]"),
            "LONG": (2**30, "samples, upper end of every counter"),
            "INERTIA": (plant.inertia, "[kg*m^2]"),
            "DAMPING": (plant.damping, "[N*m*s/rad]"),
            "GRAVITY": (plant.gravity_torque, "m g l [N*m]"),
            "JITTER": (compensation.JITTER, "smaller motions count as angle noise [rad]"),
            "CORRECTED": (preview.CORRECTED, "share of an angle's error that counts as motion [-]"),
            "DEAD_BAND": (known.dead_band, "total dead band of the regulators [Pa]"),
            "SOFT": (compensation.SOFT, "smoothing width of the dead-band inverse [Pa]"),
            "TOLERANCE": (observer.tolerance, "longest time that a sensor may be silent or frozen [s]"),
            "TOLERANCE_END": (observer.tolerance * late, "the same, rounded up [s]"),
            "SIGMAS": (gating.SIGMAS, "standard deviations beyond which a reading is rejected"),
            "ROUGH": (gating.ROUGH, "standard deviations of the noise within which no reading is rejected"),
            "MOST_TURNS": (gating.MOST_TURNS, "upper bound of the whole turns of an encoder error"),
            "NEAR_A_TURN": (
                gating.NEAR_A_TURN,
                "distance from the expected angle up to which whole turns are removed [rad]",
            ),
            "GATE_GROWTH": (
                observer.dt / observer.gate.widening,
                "growth per sample of the width of a gate that rejects [-]",
            ),
            "MAX_SPEED": (observer.gate.max_speed, "greatest estimated speed [rad/s]"),
            "MAX_TORQUE": (observer.gate.max_torque, "greatest estimated disturbance torque [N*m]"),
            "HESITATION": (observer.rivalry.hesitation, "samples in which a rival has to explain rejected readings"),
            "GATE_PATIENCE": (observer.rivalry.patience, "the same after a jump"),
            "CROSSING": (observer.rivalry.crossing, "samples without a rejection after which there is no rival"),
            "FIRST": (kalman.FIRST, "first samples, in which rejected readings may be right"),
            "REPEATED": (rivalry.ONCE * observer.dt, "longest repetition of an angle reading at a reversal [s]"),
            "COARSEST": (kalman.COARSEST, "greatest resolution step of an encoder [rad]"),
            "LEARNING": (observer.dt / OFFSET_TIME, "share of an innovation that is added to a pressure offset"),
            "SETTLED": (SETTLED, "distance to the command within which a pressure shows its offset [Pa]"),
            "MOST_OFFSET": (observer.noise.offset, "greatest offset of a pressure sensor to its regulator [Pa]"),
            "ENCODER_NOISE": (observer.noise.theta, "least standard deviation of the angle noise [rad]"),
            "DOUBT": (gating.DOUBT, "standard deviations from which a repeated reading is rejected"),
        }
    )


def _rest(controller: TrackingMPC) -> Numbers:
    rules = controller.rest_mode.rules
    return {
        "RESTS": (int(controller.rests), "whether commands come to rest at a constant reference"),
        "REST_SAME_THETA": (resting.SAME[0], "a preview that varies less is constant [rad]"),
        "REST_SAME_K": (resting.SAME[1], "[N*m/rad]"),
        "REST_DWELL": (rules.dwell, "samples of constant preview before a rest"),
        "REST_START": (resting.START, "greatest mean error at the start of a rest [rad]"),
        "REST_GROWTH": (resting.GROWTH * controller.dt, "growth of that per sample [rad]"),
        "REST_MEAN": (resting.MEAN, "upper bound of that [rad]"),
        "REST_SWING": (resting.SWING, "greatest peak-to-peak motion for a rest [rad]"),
        "REST_FAR": (resting.FAR, "errors above restart the dwell time [rad]"),
        "REST_RINGING": (resting.RINGING, "errors to both sides that show missing friction [rad]"),
        "REST_DEAD_ZONE": (resting.DEAD_ZONE, "smaller errors are not corrected [rad]"),
        "REST_STILL": (resting.STILL, "greatest peak-to-peak motion over half a period of a still joint [rad]"),
        "REST_FIRST": (resting.FIRST, "gain of the first correction, of the stiffness [-]"),
        "REST_STIFFEST": (resting.STIFFEST, "the greatest one [-]"),
        "REST_RESOLUTION": (resting.RESOLUTION, "accuracy of a correction's known effect [rad]"),
        "REST_OVERSHOOT": (resting.OVERSHOOT, "greatest overshoot of a correction [rad]"),
        "REST_MOST": (resting.MOST, "greatest correction [Pa]"),
        "REST_JOLT": (resting.JOLT, "distance from the predicted angle that shows a push [rad]"),
        "REST_UNUSUAL": (resting.UNUSUAL, "multiple of the usual prediction error that shows a push [-]"),
        "REST_PUSH": (resting.PUSH, "distance from the mean angle that shows a push [rad]"),
        "REST_EDGE": (resting.EDGE, "greatest rotation by regulators that cross their dead band [rad]"),
        "REST_LEAK": (resting.LEAK, "distance of a held pressure that shows a leak [Pa]"),
        "REST_PRESSURE_NOISE": (resting.NOISE, "noise of a mean pressure [Pa]"),
        "REST_SETTLING": (rules.settling, "settling time of a correction in samples"),
        "REST_QUARTER_LEAST": (float(rules.shortest), "quarter of the joint's period in samples, least and greatest"),
        "REST_QUARTER_MOST": (float(rules.longest), ""),
    }


def _tables(controller: TrackingMPC, observer: KalmanObserver) -> list[tuple[str, str, Array]]:
    plant, dt, starts = controller.plant, controller.dt, np.asarray(controller.problem.starts)
    inverse = InverseDynamics(plant, dt, controller.N)
    acting = np.searchsorted(starts, np.arange(controller.N), side="right")
    return [
        ("ANT_D1", "derivative of a spline through the samples of a preview [1/s]", inverse.slopes[0]),
        ("ANT_D2", "and its second derivative [1/s^2]", inverse.slopes[1]),
        ("ANT_LAG", "time constants of the pressures [s]", inverse.lags),
        ("ANT_KEPT", "remaining share of a pressure error after a sample [-]", inverse.alpha),
        ("ANT_STARTS", "samples at which blocks of commands begin", starts),
        ("ANT_ACTING", "blocks that have begun by a sample", acting),
        ("ANT_Q_NOISE", "variance of the model's errors over a sample", np.diag(observer.filter.Q)),
        ("ANT_Q_REST", "the same where a sensor repeats itself", np.diag(observer.filter.Q_rest)),
        ("ANT_R_NOISE", "variance of the sensors theta, P1, P2", np.diag(observer.filter.R)),
        ("ANT_GATE_LOWER", "least possible readings of theta, P1, P2", np.array(observer.gate.lower)),
        ("ANT_GATE_UPPER", "greatest possible readings", np.array(observer.gate.upper)),
        ("ANT_GATE_FLOOR", "distances from expected readings that are accepted", np.array(observer.gate.floor)),
        ("ANT_GATE_JUMP", "distances accepted only after a jump's patience", np.array(observer.gate.jump)),
        ("ANT_UNSURE", "variance of an estimate from the readings alone", np.diag(observer.filter.unsure)),
        ("ANT_COVARIANCE", "initial covariance of the observer", observer.filter.stationary),
        *friction_tables(controller.compensation.friction),
    ]
