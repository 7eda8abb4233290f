"""Simulated measurement of stiffness: settle the joint under control, freeze its pressures, push, and read the angle.

From the time of freezing on, both regulators hold their pressures, or are shut (`Cycle.shut`), which gives another
stiffness if the plant has gas. Then a slow sine of external torque T_e pushes both ways, while the encoder is read.
Friction opposes the motion, s = ±1: T_e = -T(θ) + s T_f(θ), so that half the sum of the two branches of a cycle is the
elastic torque, and half their distance the friction. Both are fitted together to the samples at which the joint has
turned by more than its presliding since the last reversal:

    T_e = c_0 + K ψ + c_2 ψ² + c_3 ψ³ + s (f_0 + f_1 ψ + f_2 ψ²),      ψ = θ - θ_0

K is the slope at the angle θ_0 at which the joint rested before the push. The difference between wanted and measured
stiffness is split by cause; each step changes one thing, and they add up:

    saturation    K_feasible - K_asked       the nearest feasible one of the model's joint under the estimated torque
    dynamics      K_modelled - K_feasible    the model at the frozen state: pressures and angle are not (yet) as planned
    mismatch      K_true - K_modelled        the joint's own law at the same state
    gas           K_shut - K_true            with shut valves: the stiffness of the trapped gas
    measurement   K_measured - K_true, - K_shut  the experiment's own error

`felt` finds the felt stiffness at a frequency: it freezes the commands and shakes the joint instead. Trapped gas
stiffens a joint while its regulators cannot follow, so that K depends on the frequency, and on whether the motion
leaves their dead band:

    K(s) = K + Σ_i κ (P_i + p_a) g_i²/V_i^eff · s τ_i/(1 + s τ_i),    s = 2πi f                                   (G4)

A sine of external torque, increased smoothly to avoid transients, is held for whole periods. With the first harmonics
T̂ of the torque and θ̂ of the angle

    K_measured(f) = T̂/θ̂ + J (2πf)² - 2πi f b - m g l cos(θ_0 - θ_h)

inertia, damping and gravity being those of the model. Friction is part of the felt stiffness. The torque is constant
over each sample h, so that T̂ is that of the sine times exp(-πi f h) sin(πfh)/(πfh).
"""

from dataclasses import dataclass, replace
from math import ceil, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allocator import allocate, checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.units import DEG
from mpc.model.faults import StuckValve
from mpc.model.plant import NX, Plant
from mpc.model.real import RealPlant
from mpc.model.real_experiment import RealExperiment
from mpc.observer.base import Observer
from mpc.tracking.plan import Plan
from mpc.trials.motions.reference import Reference, min_jerk
from mpc.trials.simulation import Controller, Run, simulate

REST = 1.0  # [s] between freezing and pushing, for the joint to come to rest
_TURNED = 10 * DEG  # after a reversal, until friction has reversed, see `mpc.model.friction.maxwell_slip`
_LEAST = 2.4  # times that: least swing of the joint


@dataclass(frozen=True)
class Push:
    """Result of a push; stiffness in N·m/rad."""

    theta: float  # θ_0, for all of them [rad]
    asked: float
    feasible: float
    modelled: float
    estimated: float  # the model at the observer's state
    true: float
    measured: float
    friction: float  # f_0 [N·m]
    gas: float = 0.0  # of trapped gas with shut valves

    @property
    def causes(self) -> dict[str, float]:
        """Causes of the difference between measured and wanted stiffness [N·m/rad], which add up to it."""
        return {
            "saturation": self.feasible - self.asked,
            "dynamics": self.modelled - self.feasible,
            "mismatch": self.true - self.modelled,
            "gas": self.gas,
            "measurement": self.measured - (self.true + self.gas),
        }


class Cycle(NamedTuple):
    """Settings of a slow push."""

    torque: float = 2.0  # amplitude of T_e [N·m]: within the presliding of friction a joint seems stiffer
    period: float = 16.0  # [s]; inertia makes the joint seem softer by J (2π/period)²
    shut: bool = False  # whether the valves are shut after the freezing; else the regulators hold the pressures


def push(
    real: RealPlant,
    model: Plant,
    loop: tuple[Controller, Observer],
    reference: Reference,
    at: float,
    cycle: Cycle | None = None,
    seed: int = 0,
) -> Push:
    """Let `loop`, whose model is `model`, follow `reference` up to `at` [s] from its start; then freeze and push.

    Raises InvalidInput if the joint turns too little, and for plants whose stiffness is not the isobaric one; `felt`
    measures that at a frequency.
    """
    if real.nominal.shares or model.shares:
        raise InvalidInput(f"a slow push cannot find the {(model if model.shares else real.nominal).kind.text}")
    cycle = Cycle() if cycle is None else cycle
    controller, observer = loop
    dt = controller.dt
    freeze, begin = round(at / dt), round((at + REST) / dt)
    end = begin + round(1.25 * cycle.period / dt)
    encoder = _Reading(observer)
    shut = tuple(StuckValve(freeze * dt, muscle=muscle) for muscle in (1, 2)) if cycle.shut else ()
    run = simulate(
        replace(real, torque_profile=_torques(real, cycle, begin, end, dt), faults=real.faults + shut),
        Freezing(controller, freeze),
        held(reference.resampled(dt), end),
        observer=encoder,
        seed=seed,
    )
    T_e = cycle.torque * np.sin(2 * pi / cycle.period * dt * np.arange(end - begin))
    read = np.array(encoder.angles)[:end]
    theta = float(read[begin - round(REST / 2 / dt) : begin].mean())
    K, friction = slope(read[begin:] - theta, T_e)
    found = _compared(real, model, run, freeze, np.array([theta, 0.0, *run.P[begin]]), K, friction)
    return replace(found, gas=float(sum(real.trapped(run.x[begin])))) if cycle.shut else found


def slope(psi: Array, T_e: Array) -> tuple[float, float]:
    """Return K [N·m/rad] and f_0 [N·m] from the angles ψ (n,) [rad] under the torque T_e (n,) [N·m] of a cycle and a
    quarter.

    Raises InvalidInput if the joint moved too little for its friction to reverse.
    """
    top = int(np.argmax(T_e[: T_e.size // 2]))
    bottom = top + int(np.argmin(T_e[top:]))
    falling, rising = slice(top, bottom), slice(bottom, T_e.size)
    down = np.flatnonzero(psi[top] - psi[falling] > _TURNED) + top
    up = np.flatnonzero(psi[rising] - psi[bottom] > _TURNED) + bottom
    if (swing := psi[top] - psi[bottom]) < _LEAST * _TURNED:
        needed = f"it takes {_LEAST * _TURNED / DEG:g}° to separate elasticity from friction: push harder"
        raise InvalidInput(f"pushed both ways the joint turned by {swing / DEG:.2g}° in all; {needed}")
    kept = np.concatenate([down, up])
    s, x = np.repeat([-1.0, 1.0], [down.size, up.size]), psi[kept]
    terms = np.stack([np.ones_like(x), x, x**2, x**3, s, s * x, s * x**2], axis=1)
    found = np.linalg.lstsq(terms, T_e[kept], rcond=None)[0]
    return float(found[1]), float(found[4])


def _compared(real: RealPlant, model: Plant, run: Run, freeze: int, x: Array, K: float, friction: float) -> Push:
    """Compare with the state `x` (4,) at which the joint rested, frozen at the sample `freeze`."""
    theta_ref, asked = float(run.theta_ref[freeze]), float(run.K_ref[freeze])
    seen, d = run.estimate[freeze, :NX], float(run.estimate[freeze, NX])
    held = allocate(theta_ref, asked, model.torque_for(theta_ref, 0.0, 0.0, d), joint=model.joint)
    return Push(
        theta=float(x[0]),
        asked=asked,
        feasible=float(held.K),
        modelled=float(model.stiffness(x)),
        estimated=float(model.stiffness(seen)),
        true=float(real.stiffness(x)),
        measured=K,
        friction=friction,
    )


def _torques(real: RealPlant, cycle: Cycle, begin: int, end: int, dt: float) -> tuple[tuple[float, float], ...]:
    """Return the torques of the plant up to the sample `begin`; from then on the last of them and the cycle."""
    before = tuple(entry for entry in real.torque_profile if entry[0] < begin * dt)
    load = before[-1][1] if before else 0.0
    k = np.arange(begin, end)
    pushed = load + cycle.torque * np.sin(2 * pi / cycle.period * dt * (k - begin))
    return before + tuple(zip((k * dt).tolist(), pushed.tolist(), strict=True))


def held(reference: Reference, steps: int) -> Reference:
    """Return `reference` over `steps` samples; its last is held."""
    there = np.minimum(np.arange(steps + 1), reference.t.size - 1)
    dt = reference.t[1] - reference.t[0]
    return Reference(reference.t[0] + dt * np.arange(steps + 1), reference.theta[there], reference.K[there])


class Freezing:
    """Controller that is `controller` up to the sample `after` and then commands the pressures measured there."""

    def __init__(self, controller: Controller, after: int) -> None:
        self.controller, self.after, self.dt = controller, after, controller.dt

    @property
    def ahead(self) -> int:
        """Samples of preview for the controller."""
        return self.controller.ahead

    def reset(self) -> None:
        """Forget the past samples and the freezing."""
        self.controller.reset()
        self._sample = 0
        self._frozen: Plan | None = None

    def step(self, x: ArrayLike, theta_ref: ArrayLike, K_ref: ArrayLike, d: ArrayLike = 0.0) -> Plan:
        """Return the controller's plan, or that of the freezing."""
        self._sample += 1
        if self._frozen is None:
            plan = self.controller.step(x, theta_ref, K_ref, d)
            if self._sample <= self.after:
                return plan
            self._frozen = replace(plan, u=np.broadcast_to(np.array(x)[2:], plan.u.shape))
        return self._frozen


class _Reading:
    """Observer `observer` with a record of all encoder readings."""

    def __init__(self, observer: Observer) -> None:
        self.observer = observer

    def reset(self) -> None:
        self.observer.reset()
        self.angles: list[float] = []

    def estimate(self, y: Array, u: Array) -> tuple[Array, float]:
        self.angles.append(float(y[0]))
        return self.observer.estimate(y, u)


_SAMPLES = 400  # per period, at least: the aliases of the held torque move the link by less than 1e-7 of the motion
_SWELL = 6.0  # [s] least time in which the sine grows
_PERIODS, _LONG = 1, 2.0  # evaluated whole periods, and their least duration [s]
_FREQUENCIES = 1e-3, 1e3  # [Hz]


@dataclass(frozen=True)
class Shake:
    """Settings of a shake: a sine that turns the joint by about `angle`, according to its model."""

    frequency: float  # f [Hz]
    angle: float = 1 * DEG  # amplitude [rad]
    shut: bool = False  # whether the valves are shut; else the regulators follow the frozen commands

    def __post_init__(self) -> None:
        low, high = _FREQUENCIES
        if not low <= checks.number("frequency", self.frequency, "Hz") <= high:
            raise InvalidInput(f"frequency = {self.frequency:g} Hz has to be between {low:g} and {high:g} Hz")
        if not 0 < checks.number("angle", self.angle, "rad") <= 0.5:
            raise InvalidInput(f"angle = {self.angle:g} rad has to be above 0, and 0.5 at most")


@dataclass(frozen=True)
class Felt:
    """Felt complex stiffness [N·m/rad]: storage in phase with the angle, loss 90° ahead."""

    frequency: float  # [Hz]
    theta: float  # θ_0, at which the joint was frozen [rad]
    P: tuple[float, float]  # pressures there [Pa]
    isobaric: float  # the plant's K there
    expected: complex  # (G4) of the plant there; with all of the gas for shut valves
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

    `model` has inertia, damping and gravity, and determines the torque for the wanted angle.
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
    """Return the contribution of link and gravity to the felt stiffness."""
    omega = 2 * pi * f
    return -model.inertia * omega**2 + 1j * omega * model.damping + float(model.gravity.stiffness(x[0]))


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
    """Return the first harmonic of whole periods, fitted with a drift and a second harmonic."""
    t = np.linspace(-1, 1, phase.size)
    waves = [wave(n * phase) for n in (1, 2) for wave in (np.cos, np.sin)]
    found = np.linalg.lstsq(np.stack([*waves, np.ones_like(t), t], axis=1), read, rcond=None)[0]
    return complex(found[0], -found[1])
