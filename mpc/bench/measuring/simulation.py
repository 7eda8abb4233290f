"""Measurements on simulated joints: any process with `begin`, sample by sample, without a clock."""

from typing import Protocol

import numpy as np

from allocator.calculus import Array
from mpc.bench.cycle import CommandSource, Tick
from mpc.bench.device import Reading
from mpc.bench.rows import Pressures
from mpc.bench.safety import Guard, Watchdog
from mpc.model import experiment
from mpc.model.plant import Plant


class Process(Protocol):
    """Simulated joint."""

    def begin(self, dt: float, x0: Array, seed: int) -> experiment.Experiment:
        """Begin an experiment from the state `x0` (4,) with commands every `dt` [s]."""


def driven(process: Process, source: CommandSource, plant: Plant, theta: float, seed: int = 0) -> Array:
    """Drive a process by a source from rest at its first pressures; return the rows (t, θ, P1, P2, u1, u2).

    Commands are limited to the supply and the slew of `plant`. Raises `Stopped` if a reading violates a limit, like a
    loop on a device.
    """
    dt, watchdog = source.dt, Watchdog()
    guard = Guard(plant, dt, watchdog, watchdog.angle_margin)
    trial = process.begin(dt, np.array([theta, 0.0, *source.first]), seed)
    sent: Pressures = source.first
    rows: list[tuple[float, ...]] = []
    k = 0
    while True:
        y = trial.measure()
        reading = Reading(k * dt, float(y[0]), (float(y[2]), float(y[3])))
        if wrong := guard.broken(reading):
            raise wrong
        decision = source.decide(Tick(k, 0, reading, sent, k * dt))
        if decision is None:
            return np.array(rows)
        sent = guard.command(decision.u, sent)
        rows.append((reading.t, reading.theta, *reading.P, *sent))
        trial.advance(np.array(sent))
        k += 1
