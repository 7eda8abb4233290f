"""Presets are weights and noise for arms that are not what their model says."""

from allocator.units import BAR, DEG
from mpc.observer.filter import Noise
from mpc.tracking.weights import Weights

CALM = Weights(theta=1 / (0.08 * DEG) ** 2, omega=1 / (10 * DEG) ** 2, rate=1 / (1 * BAR) ** 2)
"""Weights for an arm with dead time, noise and muscles some percent off; `benchmarks.arm.rough` tunes them."""

CALM_NOISE = Noise(theta=0.006 * DEG)
"""What an observer of such an arm thinks of encoders with steps of 0.02° and of sensors with noise of 0.02 bar."""

__all__ = ["CALM", "CALM_NOISE"]
