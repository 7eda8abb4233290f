"""Excitations that must be refused: python -m benchmarks.felt refusals.

Excitation below the encoder's resolution, and rate-dependent rubber: a Maxwell element (a spring of 0.8 K in series
with a damper, relaxing at 0.8 Hz) parallel to the joint.
"""

from dataclasses import replace

import numpy as np

from allocator import DEG
from allocator.calculus import Array
from benchmarks.felt.hidden import Hidden, hidden, measured, shaken
from mpc import RealPlant
from mpc.bench.measuring.experiment import Tones
from mpc.model.friction.dahl import Friction
from mpc.model.real_experiment import RealExperiment

SHARE, RELAXING = 0.8, 0.8  # spring [K], frequency [Hz]


class Rubber(RealPlant):
    """Real plant with a spring and a damper in series, parallel to its muscles."""

    def begin(self, dt: float, x0: Array, seed: int) -> "RubberTrial":
        """Begin an experiment."""
        return RubberTrial(self, dt, x0, seed)


class RubberTrial(RealExperiment):
    """Experiment with the state of rubber, in steps of a sample."""

    def __init__(self, real: RealPlant, dt: float, x0: Array, seed: int) -> None:
        super().__init__(real, dt / 5, x0, seed)
        self._spring = SHARE * float(real.isobaric(x0))
        self._stretch, self._before = 0.0, float(x0[0])

    def advance(self, u: Array, d: float = 0.0) -> None:
        """Advance by one sample with the rubber's torque."""
        for _ in range(5):
            theta = float(self.x[0])
            self._stretch += theta - self._before - self._stretch * 2 * np.pi * RELAXING * self.dt
            self._before = theta
            super().advance(u, d - self._spring * self._stretch)


def report(n: int = 10, first: int = 120) -> str:
    """Return the numbers refused of each kind."""
    counts = {"too small": 0, "rubber": 0, "rubber, shaken": 0}
    for seed in range(first, first + n):
        h = hidden(seed)
        calm = replace(h.real, friction=Friction(), encoder=0.1 * DEG)
        told = replace(h.told, friction=Friction())
        cases = {
            "too small": (Hidden(calm, told, h.theta, h.K), Tones(0.1 * DEG, series=())),
            "rubber": (Hidden(Rubber(**vars(replace(calm, encoder=0.02 * DEG))), told, h.theta, h.K), Tones()),
        }
        for name, (joint, tones) in cases.items():
            m = measured(joint, seed, tones).measured
            counts[name] += bool(m.refusal)
            print(seed, name, m.sentence, flush=True)
        noisy = shaken(cases["rubber"][0], seed).measured
        counts["rubber, shaken"] += bool(noisy.refusal)
        print(seed, "rubber, shaken", noisy.sentence, flush=True)
    return "; ".join(f"{name}: {count} of {n} refused" for name, count in counts.items())
