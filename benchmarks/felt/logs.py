"""Stiffness of hidden joints from general logs: python -m benchmarks.felt logs.

The joints of `benchmarks.felt.hidden`; a minute each of random steps of both pressures, of noise between 0.3 and 4 Hz,
and of a slow sine of 15°, which must be refused.
"""

from typing import Literal, NamedTuple

import numpy as np

from allocator import BAR, DEG
from allocator.calculus import Array
from benchmarks.felt.hidden import DT, Hidden, hidden, truth
from mpc import Plant
from mpc.bench.measuring.log import Samples, from_log
from mpc.bench.measuring.result import MeasuredStiffness
from mpc.bench.measuring.simulation import Process
from mpc.bench.measuring.strengths import Known

Motion = Literal["steps", "noise", "sine"]
MOTIONS: tuple[Motion, ...] = ("steps", "noise", "sine")
_DURATION = 60.0  # [s]


class Rest(NamedTuple):
    """Rest of the model about which a joint moves."""

    plant: Plant
    theta: float  # [rad]
    K: float  # [N·m/rad]

    @property
    def state(self) -> Array:
        """State (4,) of the model at rest."""
        return self.plant.at_rest(self.theta, self.K)


def commands(rest: Rest, motion: Motion, n: int, rng: np.random.Generator) -> Array:
    """Return the commands (n, 2) [Pa] of a motion about a rest."""
    from scipy.signal import butter, lfilter

    t, P = DT * np.arange(n), rest.state[2:4]
    if motion == "sine":
        angles = 15 * DEG * np.sin(np.linspace(0, 2 * np.pi, 41))
        held = np.array([rest._replace(theta=float(angle)).state[2:4] for angle in angles])
        phase = 0.4 * t % 1 * 40
        return np.stack([np.interp(phase, np.arange(41), held[:, i]) for i in range(2)], axis=1)
    if motion == "noise":
        b, a = butter(2, [0.3 * 2 * DT, 4 * 2 * DT], "band")
        noise = lfilter(b, a, rng.standard_normal((n, 2)), axis=0)
        return np.asarray(P + noise / noise.std(axis=0) * 0.5 * BAR)
    ends = np.cumsum(rng.uniform(0.15, 1.0, n))
    levels = np.clip(P + rng.uniform(-1, 1, (n, 2)) * BAR, 1.0 * BAR, 4.8 * BAR)
    return np.asarray(levels[np.searchsorted(ends, t, side="right")])


def recorded(process: Process, rest: Rest, motion: Motion, seed: int, duration: float = _DURATION) -> Samples:
    """Return the log of a joint under a motion, with commands within the model's slew limit."""
    n, rng, step = round(duration / DT), np.random.default_rng([seed, 77]), rest.plant.slew * DT
    x = rest.state
    trial, sent, rows = process.begin(DT, x, seed), x[2:4], []
    for k, u in enumerate(commands(rest, motion, n, rng)):
        y = trial.measure()
        rows.append((k * DT, y[0], y[2], y[3]))
        sent = np.clip(u, sent - step, sent + step)
        trial.advance(sent)
    return Samples.of(*np.array(rows).T)


def rest_of(h: Hidden) -> Rest:
    """Return the rest of a hidden joint."""
    return Rest(h.real.nominal, h.theta, h.K)


def measured(h: Hidden, log: Samples) -> MeasuredStiffness:
    """Return the measurement from a log of a hidden joint with known inertia."""
    plant = h.real.nominal
    return from_log(plant, h.told.friction.loop, log, Known(plant.inertia, 0.0, h.told.reading_age))


def report(n: int = 40, first: int = 0) -> str:
    """Measure in the logs of n hidden joints and return the figures."""
    lines = []
    for motion in MOTIONS:
        found, felt = [], []
        for seed in range(first, first + n):
            h = hidden(seed)
            m = measured(h, recorded(h.real, rest_of(h), motion, seed))
            if m.refusal:
                continue
            K, of = truth(h, m)
            gains = zip(m.strengths, h.real.force_gains, strict=True)
            found.append((m.K / K - 1, m.K_std / K, *(g / true - 1 for g, true in gains)))
            felt += [(f.K / of(f.amplitude) - 1, f.K_std / f.K) for f in m.felt]
        lines.append(f"{motion}: {len(found)} of {n} measured" + _figures(np.array(found), np.array(felt)))
        print(lines[-1], flush=True)
    return "\n".join(lines)


def _figures(found: Array, felt: Array) -> str:
    if not found.size:
        return ""
    K, felt_error = (100 * np.quantile(np.abs(a[:, 0]), 0.9) for a in (found, felt))
    strengths = 100 * np.quantile(np.abs(found[:, 2:]), 0.9)
    covers, felt_covers = (100 * np.mean(np.abs(a[:, 0]) <= 1.96 * a[:, 1]) for a in (found, felt))
    return (
        f"; K: median error {100 * np.median(found[:, 0]):+.2f} %, nine in ten within {K:.1f} %, 95 % interval covers "
        f"{covers:.0f} %; strengths: nine in ten within {strengths:.1f} %; felt K at "
        f"1–8°: nine in ten within {felt_error:.0f} %, covered {felt_covers:.0f} %"
    )
