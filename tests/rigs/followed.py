"""How far pressures are from those that a feed-forward aims at, when its commands drive a plant without feedback."""

import numpy as np

from mpc.codegen.buffered import Buffered
from mpc.model.experiment import FINE
from mpc.tracking.feedforward import InverseDynamics


def missed(plant, model, theta, K, dt):
    """The greatest distance [Pa] at the end of the references, with the feed-forward of `model`."""
    step, feed = Buffered(plant.discrete(dt, FINE)), InverseDynamics(model, dt, len(theta) - 1)(theta, K)
    x = feed.x[0]
    for u in feed.u:
        x = step(x, u, 0.0)[0][0]
    return np.abs(x - feed.x[-1])[2:].max()
