"""The demonstration drives the exported controller with its own model as the joint; here it is done in Python."""

from collections.abc import Iterator
from dataclasses import replace
from math import cos, pi

import numpy as np

from allocator import stiffness_interval
from mpc.model.plant import Plant
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.controller import TrackingMPC

SAMPLES, SHOWN = 100, 10
_SWING = 0.15  # of the joint range


def numbers(plant: Plant) -> dict[str, tuple[float | int, str]]:
    """Return what settings.h defines for the demonstration."""
    left, right = plant.joint.angle_range
    middle = round((left + right) / 2, 6)
    K = round(float(np.mean(stiffness_interval(middle, 0.0, joint=plant.joint))), 4)
    x = plant.at_rest(middle, K)
    return {
        "DEMO_MIDDLE": (middle, "the demonstration's angle [rad]"),
        "DEMO_SWING": (round(_SWING * (right - left), 4), "and how far it swings [rad]"),
        "DEMO_K": (K, "[N*m/rad]"),
        "DEMO_P1": (float(x[2]), "[Pa]"),
        "DEMO_P2": (float(x[3]), "[Pa]"),
    }


def lines(controller: TrackingMPC, observer: KalmanObserver) -> Iterator[str]:
    """Yield the lines that the demonstration prints."""
    plant, dt, known = controller.plant, controller.dt, controller.compensation
    driver = replace(controller)  # the same anew: the one that was given keeps its memory
    own = KalmanObserver(plant, dt, observer.noise, known, observer.tolerance, compiled=False)
    turned = plant.discrete(dt)
    middle, swing, K, *P = (float(value) for value, _ in numbers(plant).values())
    x, u = np.array([middle, 0.0, *P]), np.array(P)
    waiting = [u] * known.delay(dt)
    samples = [min(k, SAMPLES) for k in range(SAMPLES + driver.ahead)]
    theta = np.array([middle + swing * (1 - cos(2 * pi * k / SAMPLES)) / 2 for k in samples])
    for k in range(SAMPLES):
        estimated, d = own.estimate(np.array([x[0], np.nan, x[2], x[3]]), u)
        plan = driver.step(estimated, theta[k : k + driver.ahead + 1], np.full(driver.ahead + 1, K), d)
        u = plan.u[0]
        if k % SHOWN == 0:
            yield (
                f"sample {k:3d}, theta {x[0]:7.4f} rad of {theta[k]:7.4f}: "
                f"u1 {u[0]:8.1f} Pa, u2 {u[1]:8.1f} Pa, status {int(plan.status)}, rung {int(plan.rung)}"
            )
        waiting.append(u)
        x = np.array(turned(x, known.after_dead_band(waiting.pop(0), x[2:]), 0.0)).ravel()
