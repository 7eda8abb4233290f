"""Demonstrations for main.c of an export, and their expected output, computed by Python."""

from collections.abc import Iterator
from dataclasses import replace
from math import cos, pi

import numpy as np

from allocator import allocate, stiffness_interval
from allocator.calculus import Array
from allocator.joint.antagonist import AntagonistJoint
from mpc.export import text
from mpc.model.plant import Plant
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
_SWING = 0.15  # of the joint range


def control_numbers(plant: Plant) -> dict[str, tuple[float | int, str]]:
    """Return the definitions of the demonstration in settings.h."""
    left, right = plant.joint.angle_range
    middle = round((left + right) / 2, 6)
    K = round(float(np.mean(stiffness_interval(middle, 0.0, joint=plant.joint))), 4)
    x = plant.at_rest(middle, K)
    return {
        "DEMO_MIDDLE": (middle, "the demonstration's angle [rad]"),
        "DEMO_SWING": (round(_SWING * (right - left), 4), "length of its motion [rad]"),
        "DEMO_K": (K, "[N*m/rad]"),
        "DEMO_P1": (float(x[2]), "[Pa]"),
        "DEMO_P2": (float(x[3]), "[Pa]"),
    }


def control_lines(controller: TrackingMPC, observer: KalmanObserver) -> Iterator[str]:
    """Yield the lines that the demonstration prints."""
    plant, dt, known = controller.plant, controller.dt, controller.compensation
    driver = replace(controller)  # a fresh copy, so that the state of the given controller is kept
    own = KalmanObserver(plant, dt, observer.noise, known, observer.tolerance, compiled=False)
    turned = plant.discrete(dt)
    middle, swing, K, *P = (float(value) for value, _ in control_numbers(plant).values())
    x, u = np.array([middle, 0.0, *P]), np.array(P)
    waiting, angles = [u] * known.delay(dt), [x[0]] * known.age(dt)
    samples = [min(k, SAMPLES) for k in range(SAMPLES + driver.ahead)]
    theta = np.array([middle + swing * (1 - cos(2 * pi * k / SAMPLES)) / 2 for k in samples])
    for k in range(SAMPLES):
        angles.append(x[0])
        estimated, d = own.estimate(np.array([angles.pop(0), np.nan, x[2], x[3]]), u)
        plan = driver.step(estimated, theta[k : k + driver.ahead + 1], np.full(driver.ahead + 1, K), d)
        u = plan.u[0]
        if k % SHOWN == 0:
            yield (
                f"sample {k:3d}, theta {x[0]:7.4f} rad of {theta[k]:7.4f}: "
                f"u1 {u[0]:8.1f} Pa, u2 {u[1]:8.1f} Pa, status {int(plan.status)}, rung {int(plan.rung)}"
            )
        waiting.append(u)
        x = np.array(turned(x, known.after_dead_band(waiting.pop(0), x[2:]), 0.0)).ravel()
