"""Run the controller in a loop of your own, a hundred times a second, with two functions that reach the hardware.

`read` and `write` here reach a simulated joint; put your encoder, sensors and regulators in their place.
"""

from itertools import count
from time import perf_counter, sleep

import numpy as np

from allocator import BAR, DEG
from mpc import KalmanObserver, RealPlant, TrackingMPC, robust_weights
from mpc.trials import point_to_point

DT = 0.01  # [s]
SECONDS = 5.0

joint = RealPlant.standard()
known = joint.known()
weights = robust_weights(joint.nominal, dt=DT, N=20, compensation=known)
controller = TrackingMPC(joint.nominal, dt=DT, N=20, weights=weights, compensation=known)
observer = KalmanObserver(joint.nominal, dt=DT, compensation=known)
reference = point_to_point(rest=0.5).resampled(DT)
experiment = joint.begin(DT, joint.at_rest(float(reference.theta[0]), float(reference.K[0])), 0)


def read():
    """Return angle [rad], velocity [rad/s], both pressures [Pa]; NaN for what is not measured."""
    theta, _, P1, P2 = experiment.measure()
    return np.array([theta, np.nan, P1, P2])


def write(u):
    """Send two commands [Pa] to the regulators."""
    experiment.advance(u)


sent, late, began = read()[2:], 0, perf_counter()
for k in count():
    if k * DT >= SECONDS:
        break
    measured = read()
    x, d = observer.estimate(measured, sent)
    plan = controller.step(x, *reference.preview(k, controller.ahead), d)
    sent = plan.u[0]
    write(sent)
    left = began + (k + 1) * DT - perf_counter()  # deadlines do not drift
    late += left < 0
    sleep(max(left, 0.0))

theta = float(read()[0])
print(f"{theta / DEG:.1f}° at the end, {sent / BAR} bar, {late} samples late; {observer.health}")
