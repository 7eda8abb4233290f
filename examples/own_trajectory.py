"""Let the MPC follow a trajectory of your own on a joint that is not what its model says."""

import numpy as np

from allocator import DEG
from mpc import KalmanObserver, RealPlant, Reference, TrackingMPC, metrics, robust_weights, simulate

t = np.arange(0.0, 6.0, 0.02)  # [s]
theta = 25 * DEG * np.sin(np.pi * np.clip((t - 1) / 4, 0, 1)) ** 2  # there and back
K = np.full(t.size, 5.5)  # [N·m/rad]

joint = RealPlant.standard()  # hysteresis, dead time, dead band, noise, muscles 10 % off
known = joint.known()  # what the controller is told of it
weights = robust_weights(joint.nominal, dt=0.01, N=20, compensation=known)
controller = TrackingMPC(joint.nominal, dt=0.01, N=20, weights=weights, compensation=known)
observer = KalmanObserver(joint.nominal, dt=0.01, compensation=known)
run = simulate(joint, controller, Reference(t, theta, K), observer=observer)

m = metrics(run)
print(f"angle {m.after_rest.theta_rms:.2f}° RMS after the first rest, limits kept: {m.limits_kept}")
