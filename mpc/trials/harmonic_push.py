"""The stiffness that is felt at a frequency is found here: settle the joint under control, freeze its commands, shake.

Gas that is trapped stiffens a joint while its regulators cannot follow, so that K depends on the frequency, and on
whether the motion leaves their dead band:

    K(s) = K + Σ_i κ (P_i + p_a) g_i²/V_i^eff · s τ_i/(1 + s τ_i),    s = 2πi f                                   (G4)

A sine of external torque, swelled smoothly so that nothing else is shaken, is held for whole periods. With the first
harmonics T̂ of the torque and θ̂ of the angle

    K_measured(f) = T̂/θ̂ + J (2πf)² - 2πi f b - m g l cos θ_0

inertia, damping and gravity being those of the model. Friction is part of what is felt. The torque is constant over
each sample h, so that T̂ is that of the sine times exp(-πi f h) sin(πfh)/(πfh).
"""

from dataclasses import dataclass, replace
from math import ceil, cos, pi

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.units import DEG
from mpc.model.plant import Plant
from mpc.model.real_plant import RealExperiment, RealPlant
from mpc.observer.base import Observer
from mpc.trials.push import REST, Freezing, held
from mpc.trials.reference import Reference
from mpc.trials.simulation import Controller, simulate
from mpc.trials.trajectories import min_jerk

_SAMPLES = 400  # of a period at least: the aliases of the held torque move the link less than 1e-7 as far
_SWELL = 6.0  # [s] at least, in which the sine swells
_PERIODS, _LONG = 1, 2.0  # that are evaluated: whole ones, for so long [s] at least
_FREQUENCIES = 1e-3, 1e3  # [Hz]


@dataclass(frozen=True)
class Shake:
    """A shake says how to push: a sine that turns the joint by about `angle`, as far as its model can say."""

    frequency: float  # f [Hz]
    angle: float = 1 * DEG  # amplitude [rad]
    shut: bool = False  # whether the valves are shut; else the regulators follow the frozen commands

    def __post_init__(self) -> None:
        """Check the numbers."""
        low, high = _FREQUENCIES
        if not low <= checks.number("frequency", self.frequency, "Hz") <= high:
            raise InvalidInput(f"frequency = {self.frequency:g} Hz has to be between {low:g} and {high:g} Hz")
        if not 0 < checks.number("angle", self.angle, "rad") <= 0.5:
            raise InvalidInput(f"angle = {self.angle:g} rad has to be above 0, and 0.5 at most")


@dataclass(frozen=True)
class Felt:
    """What is felt is a complex stiffness: storage in phase with the angle, loss ahead of it; N·m/rad."""

    frequency: float  # [Hz]
    theta: float  # θ_0, at which the joint was frozen [rad]
    P: tuple[float, float]  # pressures there [Pa]
    isobaric: float  # the plant's K there
    expected: complex  # (G4) of the plant there; all of the gas where the valves were shut
    measured: complex
    angle: float  # amplitude |θ̂| [rad]


def felt(
    real: RealPlant,
    model: Plant,
    loop: tuple[Controller, Observer],
    reference: Reference,
    at: float,
    shake: Shake,
    seed: int = 0,
) -> Felt:
    """Let `loop`, whose model is `model`, follow `reference` up to `at` [s] from its start; then freeze and shake.

    `model` says inertia, damping and gravity, and how hard to shake for the angle that is wanted.
    """
    (controller, observer), dt = loop, loop[0].dt
    freeze, end = round(at / dt), round((at + REST) / dt)
    frozen = Freezing(controller, freeze)
    run = simulate(real, frozen, held(reference.resampled(dt), end), observer=observer, seed=seed)
    x, u = run.x[-1], run.u[-1]
    load = real.torque_profile[-1][1] if real.torque_profile else 0.0
    still = replace(real, torque_profile=(), shut=(True, True) if shake.shut else real.shut)
    torque = shake.angle * abs(_passive(model, x, shake.frequency) + float(model.stiffness(x)))
    theta, T = _shaken(still, x, u, load, torque, dt, shake.frequency, seed)
    K = T / theta - _passive(model, x, shake.frequency)
    return Felt(
        frequency=shake.frequency,
        theta=float(x[0]),
        P=(float(x[2]), float(x[3])),
        isobaric=float(real.isobaric(x)),
        expected=still.dynamic_stiffness(x, shake.frequency),
        measured=K,
        angle=abs(theta),
    )


def _passive(model: Plant, x: Array, f: float) -> complex:
    """Return what link and gravity add to the stiffness that is felt."""
    omega = 2 * pi * f
    return -model.inertia * omega**2 + 1j * omega * model.damping + model.gravity_torque * cos(x[0])


def _shaken(
    real: RealPlant, x: Array, u: Array, load: float, torque: float, dt: float, f: float, seed: int
) -> tuple[complex, complex]:
    """Return the first harmonics of angle and torque, as an experiment every `h` ≤ `dt` [s] reads them."""
    per_period = max(ceil(1 / (f * dt)), _SAMPLES)
    h, swell = 1 / (f * per_period), ceil(_SWELL * f) * per_period
    kept = max(_PERIODS, ceil(_LONG * f)) * per_period
    experiment: RealExperiment = real.begin(h, x, seed)
    phase = 2 * pi / per_period * np.arange(swell + kept)
    pushed = load + torque * min_jerk(np.arange(swell + kept) / swell) * np.sin(phase)
    read = np.empty(swell + kept)
    for k, T_e in enumerate(pushed.tolist()):
        read[k] = experiment.measure()[0]
        experiment.advance(u, T_e)
    held = np.exp(-1j * pi * f * h) * np.sinc(f * h)
    return _harmonic(read[swell:], np.asarray(phase[swell:], float)), -1j * torque * held


def _harmonic(read: Array, phase: Array) -> complex:
    """Return the first harmonic of whole periods, beside a drift and a second harmonic."""
    t = np.linspace(-1, 1, phase.size)
    waves = [wave(n * phase) for n in (1, 2) for wave in (np.cos, np.sin)]
    found = np.linalg.lstsq(np.stack([*waves, np.ones_like(t), t], axis=1), read, rcond=None)[0]
    return complex(found[0], -found[1])
