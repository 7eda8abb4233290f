"""Presets are weights and noise for arms that are not what their model says."""

from allocator.units import BAR, DEG
from mpc.observer.filter import Noise
from mpc.tracking.weights import Weights

CALM = Weights(theta=1 / (0.234 * DEG) ** 2, omega=1 / (10.07 * DEG) ** 2, rate=1 / (1.526 * BAR) ** 2)
"""Weights for an arm with dead time, noise and muscles some percent off, found by `benchmarks.arm.rough`."""

CALM_NOISE = Noise(theta=0.02 / 12**0.5 * DEG, d_walk=2.09, pressure_walk=0.00501 * BAR)
"""What an observer of such an arm thinks of encoders with steps of 0.02° and of sensors with noise of 0.02 bar.

It takes the regulators nearly at their word: most of the sensors' noise would else come back as commands.
"""
