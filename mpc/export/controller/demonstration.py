"""README of an exported joint or controller, and demonstrations for its main.c with their expected output, computed by
Python.
"""

from collections.abc import Iterator
from dataclasses import replace
from math import pi

import numpy as np

from allocator import allocate, stiffness_interval
from allocator.calculus import Array
from allocator.joint.antagonist import AntagonistJoint
from mpc.export import text
from mpc.export.controller.certificate import COMPILER, certificate
from mpc.export.controller.recursions import exchanges_in, items_in
from mpc.export.controller.tuning import tuning_numbers
from mpc.export.parts import build_words, filled, machine_words
from mpc.model.arm.model import Arm
from mpc.model.machine import Machine
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.controller import TrackingMPC

_PLACES = (0.2, 0.5, 0.8)  # of the joint range
_SHARES = ((0.0, 0.3), (0.1, 0.7), (50.0, 0.4))  # torque [N·m], the last out of reach; share of the stiffness interval


def targets(joint: AntagonistJoint) -> Array:
    """Return target rows (θ, K, T) of the allocation demonstration."""
    left, right = joint.angle_range
    rows = []
    for place in _PLACES:
        theta = round(left + place * (right - left), 4)
        low, high = (float(end) for end in stiffness_interval(theta, 0.0, joint=joint))
        rows += [(theta, round(low + share * (high - low), 4), T) for T, share in _SHARES]
    return np.array(rows)


def allocation_table(joint: AntagonistJoint, single: bool, skipped: bool = False) -> str:
    """Return the header with the demonstration targets, or with none if the demonstration is `skipped`."""
    return text.demonstration("theta [rad], K [N*m/rad], T [N*m]", targets(joint), single, skipped)


def allocation_lines(joint: AntagonistJoint) -> Iterator[str]:
    """Yield the lines that main.c prints for the demonstration targets."""
    for theta, K, T in targets(joint).tolist():
        a = allocate(theta, K, T, joint=joint)
        yield (
            f"theta {theta:8.4f} rad, K {K:7.4f} N*m/rad, T {T:8.4f} N*m: "
            f"P1 {a.P1:8.1f} Pa, P2 {a.P2:8.1f} Pa, status {int(a.status)}, limits {int(a.limits)}"
        )


SAMPLES, SHOWN = 100, 10
_SWING, _FARTHEST = 0.15, 0.5  # of the joint range, and [rad]


def arm_at_rest(arm: Arm) -> tuple[Array, Array]:
    """Return the state (2n + m,) of an arm at rest in the middle of its ranges, and its target stiffness (k, k), that
    of all pressures in the middle of theirs.
    """
    middle, half = np.round(arm.middle, 6), np.full(arm.m, np.mean(arm.pressure_limits))
    K = np.round(arm.tracked_stiffness(np.concatenate([middle, np.zeros(arm.n), half])), 4)
    return arm.at_rest(middle, K), K


def control_tables(plant: Machine) -> list[tuple[str, str, Array]]:
    """Return the tables of the demonstration: a motion about the middle of the ranges at constant stiffness."""
    middle, span = np.round(np.atleast_1d(plant.middle), 6), np.subtract(*plant.angle_limits[::-1])
    if isinstance(plant, Arm):
        x, K = arm_at_rest(plant)
        entries = K[np.triu_indices(plant.tracked)]
    else:
        mean = round(float(np.mean(stiffness_interval(middle[0], 0.0, joint=plant.joint))), 4)
        x, entries = plant.at_rest(middle[0], mean), np.array([mean])
    return [
        ("ANT_DEMO_MIDDLE", "the demonstration's angles [rad]", middle),
        (
            "ANT_DEMO_SWING",
            "length of its motion [rad]",
            np.round(np.minimum(_SWING * np.atleast_1d(span), _FARTHEST), 4),
        ),
        ("ANT_DEMO_K", "[N*m/rad]", entries),
        ("ANT_DEMO_P", "pressures at its beginning [Pa]", x[2 * plant.n :]),
    ]


def control_lines(controller: TrackingMPC, observer: KalmanObserver) -> Iterator[str]:
    """Yield the lines that the demonstration prints."""
    plant, dt, known = controller.plant, controller.dt, controller.compensation
    driver = replace(controller)  # a fresh copy, so that the state of the given controller is kept
    own = KalmanObserver(plant, dt, observer.noise, known, observer.tolerance, compiled=False)
    turned, n = plant.discrete(dt), plant.n
    middle, swing, entries, P = (values for _, _, values in control_tables(plant))
    x, u = np.concatenate([middle, np.zeros(n), P]), P
    waiting, angles = [u] * known.delay(dt), [middle] * known.age(dt)
    samples = np.minimum(np.arange(SAMPLES + driver.ahead), SAMPLES)[:, None]
    theta = middle + swing * (1 - np.cos(2 * pi * samples / SAMPLES)) / 2
    K = np.broadcast_to(_square(plant, entries), (driver.ahead + 1, *plant.stiffness_shape))
    for k in range(SAMPLES):
        angles.append(x[:n])
        estimated, d = own.estimate(np.concatenate([angles.pop(0), np.full(n, np.nan), x[2 * n :]]), u)
        ahead = theta[k : k + driver.ahead + 1].reshape(-1, *plant.angle_shape)
        plan = driver.step(estimated, ahead, K, d)
        u = plan.u[0]
        if k % SHOWN == 0:
            shown, wanted = ("".join(f" {value:7.4f}" for value in row) for row in (x[:n], theta[k]))
            sent = "".join(f" {value:8.1f}" for value in u)
            yield (
                f"sample {k:3d}, theta{shown} rad of{wanted}: u{sent} Pa, "
                f"status {int(plan.status)}, rung {int(plan.rung)}"
            )
        waiting.append(u)
        x = np.array(turned(x, known.after_dead_band(waiting.pop(0), x[2 * n :]), np.zeros(n))).ravel()


def _square(plant: Machine, entries: Array) -> Array:
    """Return the stiffness with these entries of its upper triangle, as the machine takes it."""
    k = plant.tracked if isinstance(plant, Arm) else 1
    K = np.zeros((k, k))
    K[np.triu_indices(k)] = K.T[np.triu_indices(k)] = entries
    return K.reshape(plant.stiffness_shape)


_COST = {
    "tondu": """A call costs at most 7 square roots, about 40
divisions and 4 steps of Newton's method; there is no other loop.
""",
    "affine": """A call costs one evaluation of the
joint's formulas (`src/model.c`) and about a dozen operations; there is no loop.
""",
}


def readme(
    joint: AntagonistJoint, kernel: str, single: bool, printed: list[str], controller: TrackingMPC | None = None
) -> str:
    """Return the README; `printed` is the expected output of the demonstration, computed in Python."""
    muscles = " and ".join(type(muscle).__name__ for muscle in (joint.agonist, joint.antagonist))
    written = ["antagonist_config.h", "src/joint.h", "src/stiffness_model.c", "src/demonstration.h"]
    written += ["src/model.c"] if kernel == "affine" or controller else []
    written += ["src/settings.h", "src/tables.c"] if controller else []
    head = filled(
        "joint",
        **build_words(single, printed),
        joint=f"{muscles} on a {type(joint.geometry).__name__}",
        written=", ".join(f"`{name}`" for name in written),
        single=filled("single") if single else "",
        cost=_COST[kernel],
    )
    return head if controller is None else head + _control(controller, single)


def arm_readme(controller: TrackingMPC, single: bool, printed: list[str]) -> str:
    """Return the README of an arm's controller; `printed` is the expected output of the demonstration."""
    head = filled("arm", **build_words(single, printed), **machine_words(controller.plant.mechanism))
    return head + _control(controller, single)


def _control(controller: TrackingMPC, single: bool) -> str:
    from mpc.tracking.compiled.structured_qp.barrier import TURNS
    from mpc.tracking.compiled.structured_qp.exchange import CROWDED
    from mpc.tracking.compiled.structured_qp.solve import PATIENCE

    N, blocks = controller.N, len(controller.problem.blocks)
    delay, qps = controller.ahead - N, controller.iterations
    n, m, bounds = controller.plant.n, controller.plant.m, certificate(controller, single)
    moves = m * blocks
    return filled(
        "control",
        count=2 + sum(values.size for _, values in tuning_numbers(controller)),
        dt=controller.dt,
        plant=controller.plant.summary,
        N=N,
        moves=moves,
        items=min(CROWDED, items_in(n, m, blocks, single) - 2),
        patience=PATIENCE,
        turns=TURNS,
        each=exchanges_in(1),
        rows=2 * (n + m) * N,
        sweeps=qps * bounds.sweeps,
        qps=qps,
        exchanges=qps * bounds.exchanges,
        **{name: getattr(bounds, name) for name in ("begin", "exchange", "plain", "stack")},
        compiler=COMPILER,
        stages=delay + qps * N + 5 * N,  # the dead time, every QP, every rung
        usual_stages=delay + (qps + 1) * N,
        slopes=qps * N + 4,  # the observer's, with one estimate per sensor that may repeat itself
        usual_slopes=qps * N + 1,
        allocations=N + 1,
        single=filled("single_control") if single else "",
    )
