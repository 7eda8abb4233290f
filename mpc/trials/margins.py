"""Robustness margins of a closed loop at rest, from its response to one disturbed reading.

If no limit is active, a loop of controller, observer and nominal plant is linear. One angle reading is disturbed by a
small δ. The change of that and all later readings, divided by δ, is the impulse response of the sensitivity

    S(z) = 1/(1 + L(z)),      M_s = max |S(e^{jωdt})|,      L = 1/S - 1

so that its Fourier transform gives S at all frequencies, of any controller and any observer. 1/M_s is the distance of L
from -1. At crossover, |L| = 1, the phase margin is π + arg L and the delay margin is that over ω: with older readings
of the angle the loop is unstable. Names and signs are those of `control.stability_margins`; see Åström and
Murray, Feedback Systems, 2nd ed., 2020, section 10.3.

A payload adds inertia. With f times the inertia M(q), the surplus acts on the nominal loop as the torque
-(f - 1) M(q) ω', so that the loop is stable up to the least f > 1 with

    det(1 + (f - 1) M D(e^{jωdt})) = 0,      D: torque from outside ↦ ω' of the nominal loop

D is the Fourier transform of the response to a torque pulse of one sample. At the limit the loop rings with ω.

For an arm, the reading of each joint is disturbed in turn: S and L are matrices (n, n), |S| is the largest singular
value, and the other margins are those of L's eigenvalues, for a factor or a delay common to all joints; see Skogestad
and Postlethwaite, Multivariable Feedback Control, 2nd ed., 2005, sections 3.3 and 4.9.
"""

import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from math import inf, isnan, nan, pi
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from allocator import checks, stiffness_interval
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.joint.assumption import AssumedSlack, Extrapolated
from allocator.units import DEG
from mpc.model.arm.model import Arm
from mpc.model.compensation import Compensation
from mpc.model.experiment import Experiment
from mpc.model.friction.dahl import Friction
from mpc.model.machine import Machine
from mpc.model.plant import Plant
from mpc.model.real import real_of
from mpc.observer.base import Observer, check_observer
from mpc.tracking.base import BaseController

MachineT = TypeVar("MachineT", bound=Machine)
ROBUST = 2.0  # greatest M_s recommended by textbooks
SLACK = 0.1  # by which M_s may exceed it: default and tuned loops meet it at one posture
DELTA = 1e-5  # [rad], far below the observer's gates
SETTLE, SHORT, LISTEN = 0.2, 2.0, 8.0  # [s] before the disturbed reading and after it
_BRIEFEST, _LONGEST = 0.1, 60.0  # [s]
_FINE = 8  # resolution of the frequencies relative to 1/LISTEN
_DECAYED = 1e-2  # [-] of δ at the end; with more, the loop does not settle
_ALIKE = 1 + 1e-12  # ratio of equal lags; exactly 1 would be a formula compiled separately
UNHELD = "margins are left out: the machine holds none of its usual postures"
_SILENT = 1e-3  # [-] of δ at the end of the short response; with more, the long one is needed


@dataclass(frozen=True)
class Margins:
    """Margins of a loop at one posture and stiffness."""

    theta: Value  # [rad], (n,) for an arm
    K: Value  # [N·m/rad], tracked (k, k) for an arm
    frequency: Array  # (f,) [Hz]
    S: NDArray[np.complex128]  # (f,) sensitivity [-], (f, n, n) for an arm
    stable: bool  # whether the loop settles
    inertial: NDArray[np.complex128] | None = None  # (f, n, n) M D [-]; None: not computed

    @classmethod
    def of(cls, theta: Value, K: Value, response: Array, dt: float, swing: Array | None = None) -> Self:
        """Return the margins from the `response` of the readings to one disturbed by 1, every `dt` [s].

        It is (samples,), or (samples, n, n) for an arm: the readings of each joint by the disturbed one. The `swing`
        (samples, n, n) is that of the angles by a pulse of torque, a sample long, that would accelerate one joint by 1.
        """
        points = _FINE * max(len(response), round(LISTEN / dt))
        frequency = np.asarray(np.fft.rfftfreq(points, dt)[1:], float)
        S, stable = np.fft.rfft(response, points, axis=0)[1:], _left(response) < _DECAYED
        if swing is None:
            return cls(theta, K, frequency, S, stable)
        # M ω' of a central difference, at the middle of the sample in which the torque acts
        turn = 2 * pi * frequency * dt
        twice = (np.exp(1j * turn) - 2 + np.exp(-1j * turn)) * np.exp(1j * turn / 2)
        inertial = twice[:, None, None] * np.fft.rfft(swing, points, axis=0)[1:]
        return cls(theta, K, frequency, S, stable, inertial / dt**2)

    @cached_property
    def magnitude(self) -> Array:
        """Largest singular value of S (f,), |S| for a joint."""
        return np.asarray(np.linalg.svd(self._matrices, compute_uv=False)[:, 0], float)

    @property
    def _matrices(self) -> NDArray[np.complex128]:
        return self.S.reshape(self.frequency.size, np.size(self.theta), -1)

    @property
    def sensitivity_peak(self) -> float:
        """M_s; infinite for a loop that does not settle."""
        return float(self.magnitude.max()) if self.stable else inf

    @property
    def peak_frequency(self) -> float:
        """Frequency of the greatest |S| [Hz]."""
        return float(self.frequency[np.argmax(self.magnitude)])

    @cached_property
    def L(self) -> NDArray[np.complex128]:
        """Eigenvalues (n, f) of the loop transfer function L = S⁻¹ - 1, each continuous along the frequency."""
        return _loci(np.asarray(np.linalg.inv(self._matrices) - np.eye(np.size(self.theta)), complex))

    @cached_property
    def _crossovers(self) -> tuple[Array, Array]:
        """Phases above -π [rad] and frequencies [rad/s] at which an eigenvalue of L has the magnitude 1."""
        omega, least = 2 * pi * self.frequency, np.finfo(float).tiny  # without feedback L is 0
        found = [_at_zeros(np.log(np.maximum(np.abs(locus), least)), locus, omega) for locus in self.L]
        return np.angle(-np.concatenate([locus for locus, _ in found])), np.concatenate([at for _, at in found])

    @property
    def gain_margin(self) -> float:
        """Least factor above 1 of the loop's gain that makes it unstable; inf if none does."""
        real = np.concatenate([_at_zeros(locus.imag, locus.real)[0] for locus in self.L] + [self.L[:, -1].real])
        return float(np.min(-1 / real[(real > -1) & (real < 0)], initial=inf)) if self.stable else 1.0

    @property
    def phase_margin(self) -> float:
        """Least phase margin [rad]; inf if |L| never crosses 1."""
        return float(np.abs(self._crossovers[0]).min(initial=inf)) if self.stable else 0.0

    @property
    def delay_margin(self) -> float:
        """Least age of the angle's readings that makes the loop unstable [s]; inf if none does."""
        phase, omega = self._crossovers
        return float((phase % (2 * pi) / omega).min(initial=inf)) if self.stable else 0.0

    @cached_property
    def _heaviest(self) -> tuple[float, float]:
        """Inertia margin, and the frequency [Hz] with which the loop rings there; NaN if it was not computed."""
        if self.inertial is None or not self.stable:
            return (1.0 if self.inertial is not None else nan), nan
        found = [_at_zeros(locus.imag, locus.real, self.frequency) for locus in _loci(self.inertial)]
        real, frequency = (np.concatenate(parts) for parts in zip(*found, strict=True))
        if not (unstable := real < 0).any():
            return inf, nan
        least = int(np.argmin(real[unstable]))
        return float(1 - 1 / real[unstable][least]), float(frequency[unstable][least])

    @property
    def inertia_margin(self) -> float:
        """Least factor above 1 of the inertia, of an arm of all masses, that makes the loop unstable; inf if none does.

        NaN if it was not computed.
        """
        return self._heaviest[0]

    @property
    def inertia_frequency(self) -> float:
        """Frequency [Hz] with which the loop rings at its inertia margin; NaN without one."""
        return self._heaviest[1]

    def __repr__(self) -> str:
        return f"Margins: {self}"

    def __str__(self) -> str:
        """Return the margins in a line."""
        at = self.place
        if not self.stable:
            return f"{at}: the loop does not settle"
        return (
            f"{at}: M_s = {self.sensitivity_peak:.2f} at {self.peak_frequency:.1f} Hz, gain margin "
            f"{self.gain_margin:.1f}, delay margin {1e3 * self.delay_margin:.0f} ms"
            + ("" if isnan(self.inertia_margin) else f", inertia margin {self.inertia_margin:.1f}")
        )

    @property
    def place(self) -> str:
        """Posture and stiffness in words; the diagonal of a stiffness matrix."""
        angles, stiff = np.atleast_1d(self.theta) / DEG, np.diag(np.atleast_2d(self.K))
        unit = "N·m/rad" if angles.size == 1 else "tracked"
        return f"θ = {'/'.join(f'{a:.0f}' for a in angles)}°, K = {'/'.join(f'{k:.1f}' for k in stiff)} {unit}"

    @property
    def advice(self) -> str:
        """Advice in a sentence, or "" for a robust loop."""
        if self.sensitivity_peak <= ROBUST + SLACK:
            return ""
        return f"M_s is above {ROBUST:g}: use lower gains or slower weights (`antagonist tune`), or less dead time"

    @property
    def sentences(self) -> list[str]:
        """Margins and advice, each in a sentence."""
        return [f"margins on the model at {self}", *([self.advice] if self.advice else [])]


def margins(
    controller: BaseController,
    observer: Observer,
    postures: Iterable[tuple[Value, Value]] | None = None,
    *,
    listen: float | None = None,
    inertia: bool = True,
) -> tuple[Margins, ...]:
    """Return the margins of the loop of `controller` and `observer` on its own model, including dead time and gas.

    `postures` are pairs (θ [rad], K [N·m/rad]), (n,) and (k, k) for an arm; by default those of `usual_postures`. The
    response is computed for `listen` [s], by default for 2 s, or 8 s if it has not decayed by then. The margin of the
    `inertia` takes further runs, which can be left out. Controller and
    observer are used and reset; rest mode is off meanwhile. They need a compensation without friction and dead band,
    and a model whose pressures rise and fall alike: the others are nonlinear. Raises `InvalidInput` for other
    compensations and models, for other types, for angles outside the joint's range, and for an observer with another
    sample time.
    """
    checks.instance("controller", controller, BaseController, "a controller, such as a TrackingMPC")
    check_observer(observer, controller.dt)
    plant, told = controller.plant, controller.compensation
    if told != linear(told) or plant != linear_model(plant):
        raise InvalidInput(
            "margins are those of a joint that slides: build controller and observer with `linear(compensation)` of "
            "mpc.trials, which is without friction and dead band, for its `linear_model(plant)`, whose pressures rise "
            "and fall alike"
        )
    if listen is not None and not _BRIEFEST <= checks.number("listen", listen, "s") <= _LONGEST:
        raise InvalidInput(f"listen = {listen:g} s has to lie between {_BRIEFEST:g} and {_LONGEST:g} s")
    places = usual_postures(plant) if postures is None else _checked(plant, postures)
    rests, controller.rest = controller.rest, False
    try:
        return tuple(_at(controller, observer, theta, K, listen, inertia) for theta, K in places)
    finally:
        controller.rest = rests
        controller.reset()
        observer.reset()


def _checked(plant: Machine, postures: Iterable[tuple[Value, Value]]) -> list[tuple[Value, Value]]:
    """Return the postures as a list of pairs. Raises `InvalidInput`."""
    known = "has to be a pair (θ [rad], K [N·m/rad])"
    checks.instance("postures", postures, Iterable, "a list of pairs (θ [rad], K [N·m/rad])")
    pairs = [checks.pair("postures: an entry", one, known) for one in postures]
    found = [(checks.angle("theta", theta)[()], checks.real("K", K, "N·m/rad")[()]) for theta, K in pairs]
    for theta, _ in found:
        if not in_range(plant, theta):
            low, high = (np.round(end / DEG, 1) for end in plant.angle_limits)
            raise InvalidInput(f"theta = {np.round(theta / DEG, 1)}° is outside the joint's range {low} … {high}°")
    return found


def in_range(plant: Machine, theta: Value) -> bool:
    """Return whether angles [rad] are within the range of the joints; True for another number of them."""
    low, high = plant.angle_limits
    return bool(np.shape(theta) != np.shape(low) or (np.all(low <= theta) and np.all(theta <= high)))


def linear(told: Compensation) -> Compensation:
    """Return the compensation without friction and dead band."""
    return replace(told, friction=Friction(), frictions=(), dead_band=0.0)


def linear_model(plant: MachineT) -> MachineT:
    """Return the model with one lag for rising and falling pressures."""
    model: Any = plant
    return replace(model, venting=_ALIKE) if isinstance(plant, Plant) and plant.venting != 1 else plant


def usual_postures(plant: Machine) -> list[tuple[Value, Value]]:
    """Return up to three postures with the middle of the stiffness of each, at 15, 50 and 85 % of the joint range.

    For an arm they are its middle and a quarter of the ranges to both sides, with the stiffness at half the supply.
    Those that the joint cannot hold against gravity, and of an arm those that are not stable, are left out.
    """
    low, high = plant.angle_limits
    if isinstance(plant, Arm):
        postures = [plant.middle + share * (high - low) for share in (-0.25, 0.0, 0.25)]
        P = np.full(plant.m, np.mean(plant.pressure_limits))
        found = [(q, plant.tracked_stiffness(np.concatenate([q, 0 * q, P]))) for q in postures]
        return [(q, K) for q, K in found if np.linalg.eigvalsh(K).min() > 0]
    angles = low + np.array([0.15, 0.5, 0.85]) * (high - low)
    with warnings.catch_warnings():  # only postures are taken from it
        for assumed in (AssumedSlack, Extrapolated):
            warnings.simplefilter("ignore", assumed)
        least, greatest = stiffness_interval(angles, plant.gravity.moment(angles), joint=plant.joint)
    return [(float(a), float(K)) for a, K in zip(angles, (least + greatest) / 2, strict=True) if np.isfinite(K)]


def middle_posture(plant: Machine) -> tuple[Value, Value] | None:
    """Return the one of the `usual_postures` that is nearest to the middle of the ranges, or None without any."""
    middle = np.mean(plant.angle_limits, axis=0)
    return min(usual_postures(plant), key=lambda one: float(np.abs(one[0] - middle).max()), default=None)


def _at_zeros(values: Array, *along: NDArray[Any]) -> list[NDArray[Any]]:
    """Return other values `along` the same points at the zeros of `values`, linear between the points."""
    (at,) = np.nonzero(np.diff(np.signbit(values)))
    share = values[at] / (values[at] - values[at + 1])
    return [a[at] + share * (a[at + 1] - a[at]) for a in along]


def _left(response: Array) -> float:
    """Return the greatest value in the last tenth of a response."""
    return float(np.abs(response[-round(0.1 * len(response)) :]).max())


def _loci(matrices: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return the eigenvalues (n, f) of `matrices` (f, n, n), each continuous along the frequency."""
    from scipy.optimize import linear_sum_assignment

    found = np.linalg.eigvals(matrices)
    for before, now in pairwise(found):
        now[:] = now[linear_sum_assignment(np.abs(before[:, None] - now))[1]]
    return np.asarray(found.T, complex)


def _at(
    controller: BaseController, observer: Observer, theta: Value, K: Value, listen: float | None, inertia: bool
) -> Margins:
    """Return the margins at one posture."""
    loop = _Loop(controller, observer, theta, K)
    response = loop.response(SHORT if listen is None else listen)
    if listen is None and not _left(response) < _SILENT:
        response = loop.response(LISTEN)
    swing = loop.swing() if inertia else None
    return Margins.of(theta, K, response if np.ndim(theta) else response[:, 0, 0], controller.dt, swing)


class _Loop:
    """Closed loop at rest in a posture, for its responses to small disturbances."""

    def __init__(self, controller: BaseController, observer: Observer, theta: Value, K: Value) -> None:
        self.controller, self.observer, self.theta, self.K = controller, observer, theta, K
        self.dt, self.n = controller.dt, controller.plant.n
        self.at_rest = controller.plant.at_rest(theta, K)
        self._begin = _beginner(controller, self.at_rest)

    def response(self, listen: float) -> Array:
        """Return the readings (samples, n, n) [-] of each joint by the one whose reading is disturbed by 1."""
        samples, still = round(listen / self.dt), np.zeros(self.n)
        self._quiet = self._run(samples, still, still)
        found = [self._run(samples, DELTA * unit, still)[0] - self._quiet[0] for unit in np.eye(self.n)]
        return np.asarray(np.stack(found, axis=2) / DELTA)

    def swing(self) -> Array:
        """Return the angles (samples, n, n) of each joint by a pulse of torque that would accelerate one of them by 1
        rad/s², for as long as the last response.
        """
        readings, angles = self._quiet
        still, M = np.zeros(self.n), mass_matrix(self.controller.plant, self.theta)
        pulse = DELTA / self.dt**2  # [rad/s²], which turns a joint by about DELTA
        found = [self._run(len(readings), still, pulse * column)[1] - angles for column in M.T]
        return np.asarray(np.stack(found, axis=2) / pulse)

    def _run(self, samples: int, delta: Array, torque: Array) -> tuple[Array, Array]:
        """Return readings and angles (samples, n) from the sample on whose readings are disturbed by `delta` (n,) [rad]
        and in which a `torque` (n,) [N·m] acts from outside.
        """
        controller, observer, n = self.controller, self.observer, self.n
        controller.reset()
        observer.reset()
        trial, u, readings, angles = self._begin(), self.at_rest[2 * n :], [], []
        first = round(SETTLE / self.dt)
        for k in range(first + samples):
            y = trial.measure()
            y[:n] += delta * (k == first)
            readings.append(y[:n].copy())
            angles.append(trial.x[:n])
            x, d = observer.estimate(y, u)
            u = controller.step(x, self.theta, self.K, d).u[0]
            trial.advance(u, torque * (k == first))
        return np.array(readings[first:]), np.array(angles[first:])


def mass_matrix(plant: Machine, theta: Value) -> Array:
    """Return the mass matrix (n, n) [kg·m²] at the angles `theta` [rad], (n,) for an arm."""
    q, still = np.atleast_1d(theta), np.zeros(plant.n)
    rest = plant.torque_for(q, still, still)
    return np.stack([plant.torque_for(q, still, unit) - rest for unit in np.eye(plant.n)], axis=1)


def _beginner(controller: BaseController, x: Array) -> Callable[[], Experiment]:
    """Return a function that begins the controller's model at `x`, with its known dead time and reading age."""
    plant, told, dt = controller.plant, controller.compensation, controller.dt
    trial = real_of(plant, dead_time=told.dead_time, reading_age=told.reading_age).begin(dt, x, 0)
    start = trial.memory

    def begin() -> Experiment:
        trial.recall(start, 0)
        return trial

    return begin
