"""Robustness margins of a closed loop at rest, from its response to one disturbed reading.

Where no limit binds, a loop of controller, observer and nominal plant is linear. One angle reading is disturbed by a
small δ. The change of that and all later readings, divided by δ, is the impulse response of the sensitivity

    S(z) = 1/(1 + L(z)),      M_s = max |S(e^{jωdt})|,      L = 1/S - 1

so that its Fourier transform gives S at all frequencies, of any controller and any observer. 1/M_s is the distance of L
from -1. At crossover, |L| = 1, the phase margin is π + arg L and the delay margin is that over ω: with older readings
of the angle the loop is unstable. Names and signs are those of `control.stability_margins`; see Åström and
Murray, Feedback Systems, 2nd ed., 2020, section 10.3.
"""

import warnings
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, pi
from typing import Self

import numpy as np
from numpy.typing import NDArray

from allocator import checks, stiffness_interval
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.joint.assumption import AssumedSlack, Extrapolated
from allocator.units import DEG
from mpc.model.compensation import Compensation
from mpc.model.friction.dahl import Friction
from mpc.model.plant import Plant
from mpc.model.real_plant import RealPlant
from mpc.observer.base import Observer
from mpc.tracking.base import BaseController

ROBUST = 2.0  # M_s that textbooks ask for at most
DELTA = 1e-5  # [rad], far below the observer's gates
SETTLE, LISTEN = 0.2, 8.0  # [s] before the disturbed reading and after it
_FINE = 8  # how much finer than 1/LISTEN the frequencies are
_DECAYED = 1e-2  # of δ at the end; more is a loop that does not settle


@dataclass(frozen=True)
class Margins:
    """Margins of a loop at one posture and stiffness."""

    theta: float  # [rad]
    K: float  # [N·m/rad]
    frequency: Array  # (f,) [Hz]
    S: NDArray[np.complex128]  # (f,) sensitivity [-]
    stable: bool  # whether the loop settles

    @classmethod
    def of(cls, theta: float, K: float, response: Array, dt: float) -> Self:
        """Return the margins from the `response` (n,) of the readings to one that is disturbed by 1, every `dt` [s]."""
        points = _FINE * max(response.size, round(LISTEN / dt))
        frequency = np.asarray(np.fft.rfftfreq(points, dt)[1:], float)
        settled = bool(np.abs(response[-round(0.1 * response.size) :]).max() < _DECAYED)
        return cls(theta, K, frequency, np.fft.rfft(response, points)[1:], settled)

    @property
    def sensitivity_peak(self) -> float:
        """Return M_s; infinite for a loop that does not settle."""
        return float(np.abs(self.S).max()) if self.stable else inf

    @property
    def peak_frequency(self) -> float:
        """Return where |S| is greatest [Hz]."""
        return float(self.frequency[np.argmax(np.abs(self.S))])

    @property
    def L(self) -> NDArray[np.complex128]:
        """The loop transfer function L = 1/S - 1 (f,)."""
        return 1 / self.S - 1

    @cached_property
    def _control(self) -> tuple[Array, ...]:
        """Gain margins, phase margins [°] and stability margins, and their frequencies [rad/s]."""
        import control

        response = control.frd(self.L, 2 * pi * self.frequency, smooth=True)
        found: tuple[Array, ...] = control.stability_margins(response, returnall=True)
        return found

    @property
    def gain_margin(self) -> float:
        """Return the least factor above 1 of the loop's gain that makes it unstable; inf where none does."""
        factors = self._control[0]
        return float(factors[factors > 1].min(initial=inf)) if self.stable else 1.0

    @property
    def phase_margin(self) -> float:
        """Return the least phase margin [rad]; inf where |L| crosses 1 nowhere."""
        return float(np.abs(self._control[1]).min(initial=inf)) * DEG if self.stable else 0.0

    @property
    def delay_margin(self) -> float:
        """Return the least age of the angle's readings that makes the loop unstable [s]; inf where none does."""
        _, phase, _, _, crossover, _ = self._control
        return float((phase % 360 * DEG / crossover).min(initial=inf)) if self.stable else 0.0

    def __str__(self) -> str:
        """Return the margins in a line."""
        at = f"θ = {self.theta / DEG:.0f}°, K = {self.K:.1f} N·m/rad"
        if not self.stable:
            return f"{at}: the loop does not settle"
        return (
            f"{at}: M_s = {self.sensitivity_peak:.2f} at {self.peak_frequency:.1f} Hz, gain margin "
            f"{self.gain_margin:.1f}, delay margin {1e3 * self.delay_margin:.0f} ms"
        )

    @property
    def advice(self) -> str:
        """Advice in a sentence, or "" for a robust loop."""
        if self.sensitivity_peak <= ROBUST + 0.05:  # the accuracy of `robust_weights`
            return ""
        return f"M_s is above {ROBUST:g}: take lower gains or slower weights (`antagonist tune`), or less dead time"


def margins(
    controller: BaseController,
    observer: Observer,
    postures: Iterable[tuple[float, float]] | None = None,
    *,
    listen: float = LISTEN,
) -> tuple[Margins, ...]:
    """Return the margins of the loop of `controller` and `observer` on its own model, dead time and gas included.

    `postures` are pairs (θ [rad], K [N·m/rad]); by default three angles, each at the middle of the stiffness that it
    can have. The response is computed for `listen` [s]. Both are used and reset; rest mode is off meanwhile. The joint
    slides and its regulators move, so both need a compensation without friction and dead band, which are not linear.
    Raises `InvalidInput` for controllers of arms, and for a compensation with friction or a dead band.
    """
    plant, told = controller.plant, controller.compensation
    if plant.angle_shape != ():
        raise InvalidInput("margins are those of one joint; an arm has none yet")
    if told != linear(told):
        raise InvalidInput(
            "margins are those of a joint that slides: build controller and observer with `linear(compensation)`, "
            "which is without friction and dead band"
        )
    places = usual_postures(plant) if postures is None else postures
    rests, controller.rest = controller.rest, False
    try:
        at = [(checks.number("theta", theta, "rad"), checks.number("K", K, "N·m/rad")) for theta, K in places]
        return tuple(_at(controller, observer, theta, K, listen) for theta, K in at)
    finally:
        controller.rest = rests
        controller.reset()
        observer.reset()


def linear(told: Compensation) -> Compensation:
    """Return the compensation without friction and dead band."""
    return replace(told, friction=Friction(), dead_band=0.0)


def usual_postures(plant: Plant) -> list[tuple[float, float]]:
    """Return three angles, at 15, 50 and 85 % of the joint range, with the middle of the stiffness of each."""
    low, high = plant.angle_limits
    angles = low + np.array([0.15, 0.5, 0.85]) * (high - low)
    with warnings.catch_warnings():  # only places to look at are taken from it
        for assumed in (AssumedSlack, Extrapolated):
            warnings.simplefilter("ignore", assumed)
        least, greatest = stiffness_interval(angles, plant.gravity_torque * np.sin(angles), joint=plant.joint)
    return [(float(a), float(K)) for a, K in zip(angles, (least + greatest) / 2, strict=True) if np.isfinite(K)]


def _at(controller: BaseController, observer: Observer, theta: float, K: float, listen: float) -> Margins:
    """Return the margins at one posture."""
    dt, plant = controller.dt, controller.plant
    first, samples = round(SETTLE / dt), round((SETTLE + listen) / dt)
    at_rest = plant.at_rest(theta, K)
    told = controller.compensation
    trial = RealPlant(plant, dead_time=told.dead_time, reading_age=told.reading_age).begin(dt, at_rest, 0)
    start = trial.memory

    def readings(delta: float) -> Array:
        """Return the angle's readings from the one that `delta` [rad] is added to on."""
        controller.reset()
        observer.reset()
        trial.recall(start, 0)
        u, angles = at_rest[2:], []
        for k in range(samples):
            y = trial.measure()
            y[0] += delta * (k == first)
            angles.append(y[0])
            x, d = observer.estimate(y, u)
            u = controller.step(x, theta, K, d).u[0]
            trial.advance(u)
        return np.array(angles[first:])

    return Margins.of(theta, K, (readings(DELTA) - readings(0.0)) / DELTA, dt)
