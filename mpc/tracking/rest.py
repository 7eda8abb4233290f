"""In rest mode, where the reference is constant, the commands come to rest, instead of hunting.

A loop that knows friction, dead time and dead band makes valves chatter at rest out of nothing but sensor noise, and
where the friction that it was told of is not there, it swings for ever. But with friction such as Dahl's or Maxwell
slip, which has no peak at standstill, *any constant commands are a rest*, and a dead band is a play: commands
u = P + side · band/2, with both regulators on the same edge of it, hold the pressures P exactly, and raise (side +1) or
lower them (-1) without crossing the band. So the pressures are held at the mean P̄ of the hunting, and an angle that is
left over is corrected by a sampled integral with a dead zone. With e = θ - θ*, means over quarters of the joint's free
period 2π √(J/K*), and the model's stiffness K and torque slopes a_i = ∂T/∂P_i there,

    enter    the preview has been constant and |e| ≤ FAR for `DWELL`, |mean e| ≤ START + GROWTH · (time beyond),
             swing ≤ SWING; P̄ is the mean over half a period. On their way to the edges the regulators may turn the
             joint by EDGE
    correct  once the last correction has acted: |m| > DEAD_ZONE, m = mean e over the last quarter, or over the
             last period if the joint still swings: one of the pressures moves by ΔT/a_i, ΔT = -g m,
             g = K if it swings, else half the secant -ΔT_last/Δm, because friction before sliding makes the joint
             several times as stiff as its muscles are; bounded by g ≤ K (1 + OVERSHOOT/|m|): it may begin to slide.
             A pressure that was above the held one when the rest began is within the play, and moves from there; one
             that rose since is on the edge of a narrower band, or of a regulator with another offset
    leave    the preview changes, a state is not measured, θ is off its prediction by more than JOLT (a push, seen
             within a sample), e off its mean by more than PUSH + swing, or a pressure is off by LEAK

A loop that swings about its reference by more than `RINGING` to both sides, again and again, counts with friction that
is not there. Then the controller takes what friction there is as constant until the reference moves, rests as soon as
the swing allows it at the mean over a whole period, and corrects only errors of more than two dead zones.
"""

from math import ceil, pi, sqrt

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR, DEG
from mpc.deferred import Deferred
from mpc.model.compensation import Compensation
from mpc.model.machine import Machine
from mpc.model.plant import NU, NX, Plant
from mpc.tracking.limits import Limits
from mpc.tracking.preview import Task

SAME = 1e-3 * DEG, 1e-3  # [rad], [N·m/rad]: a preview that varies less is constant
DWELL = 1.5  # [s] of constant preview before a rest, and after a push
START, GROWTH, MEAN = 0.05 * DEG, 0.2 * DEG, 0.3 * DEG  # [rad], [rad/s], [rad] |mean e| to rest at, MEAN if it rings
SWING = 2.0 * DEG  # [rad] peak to peak, the most to rest at
FAR = 1.0 * DEG  # [rad] of e, from where on the time counts anew
RINGING = 0.5 * DEG  # [rad] to both sides within a period, again and again
DEAD_ZONE = 0.045 * DEG  # [rad]
STILL = 0.06 * DEG  # [rad] peak to peak over half a period
FIRST, STIFFEST = 1.6, 3.0  # [-] of K: the gain before there is a secant, the greatest
RESOLUTION = 0.015 * DEG  # [rad] to which the effect of a correction is known
OVERSHOOT = 0.15 * DEG  # [rad]
MOST = 0.1 * BAR  # [Pa] of a correction
JOLT, PUSH = 0.045 * DEG, 0.12 * DEG  # [rad]
EDGE = 0.5 * DEG  # [rad] by which the regulators' way to their edges may turn the joint
LEAK = 0.1 * BAR  # [Pa] beyond the dead band
NOISE = 0.005 * BAR  # [Pa] of a pressure's mean
QUARTER = 0.1, 0.5  # [s] least and most of a quarter of a period

_QUARTERS, _HALF = 4, 2
_SWINGS = _QUARTERS + _HALF  # a load that throws the joint off is in _QUARTERS of them
_E, _P, _LOW, _HIGH = 0, slice(1, 3), 3, 4  # columns


class RestMode(Deferred):
    """Rest mode decides when a controller of `plant` rests, and which pressures are held then."""

    _put_off = "reference", "resting", "ringing"  # what else begins anew, `pressures` looks at after these

    def __init__(self, plant: Plant, dt: float, compensation: Compensation, limits: Limits) -> None:
        self.plant, self.dt, self.compensation, self.limits = plant, dt, compensation, limits
        # without friction and dead band a loop does not hunt
        self.worthwhile = not (compensation.friction.absent and compensation.dead_band == 0)
        settling = compensation.dead_time + compensation.reading_age + 2 * max(plant.lags)  # [s]
        self.settling, self.dwell = round(settling / dt), round(DWELL / dt)
        self.quarter_range = tuple(max(round(t / dt), 1) for t in QUARTER)  # [samples]
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.catch_up()
        self.reference = np.full(2, np.nan)  # θ* [rad] and K* [N·m/rad] while they stand still
        self.ringing = False
        self._quarter = 1  # of the joint's free period [samples]
        self._p, self.side = np.zeros(NU), 0.0  # pressures that are held [Pa], edge of the dead band
        self._began = np.zeros(NU)  # pressures when the rest began, or as they were corrected [Pa]
        self._since = 0  # quarters since the last correction
        self._torque = self._error = 0.0  # ΔT [N·m] of that and the m [rad] that it was for
        self._free = 0.0  # how far it would turn a joint without friction [rad]
        self.begin()

    def begin(self) -> None:
        """Begin to wait for a rest."""
        self.resting = False
        self._samples = 0  # of constant preview
        self._quarters = np.zeros((_QUARTERS, 5))  # the last ones: means of e, P1, P2, least and greatest e
        self._counted = 0  # of them
        self._swings = 0  # over how many of them e has swung to both sides
        self._sum, self._in_sum = np.zeros(1 + NU), 0  # of e, P1, P2 in the quarter that runs, and of how many samples
        self._low, self._high = np.inf, -np.inf  # e there [rad]

    def go_on(self, theta: float, K: float) -> None:
        """Take note of a sample whose preview was not constant, beginning with `theta` [rad] and `K` [N·m/rad]."""
        self._follow(theta, K)
        self.begin()

    def pressures(self, task: Task) -> Array | None:
        """Return the pressures (2,) [Pa] to hold in the situation of `task`, to be called at every sample; None: no
        rest.
        """
        known = task.measured and not task.refused
        if not (known and self._constant(task.theta, task.K)) or self._pushed(task):
            self.begin()
            return None
        self._samples += 1
        if self._quarter_ended(task.seen):
            if self.resting:
                self._correct()
            elif self._counted == _QUARTERS:
                self._check()
        return self._p if self.resting else None

    # --- to be quiet or not -----------------------------------------------------------------------------------------

    def _constant(self, theta: Array, K: Array) -> bool:
        if np.abs(theta - self.reference[0]).max() <= SAME[0] and np.abs(K - self.reference[1]).max() <= SAME[1]:
            return True
        self._follow(float(theta[0]), float(K[0]))
        return False

    def _follow(self, theta: float, K: float) -> None:
        """Follow a reference that has moved to `theta` [rad] and `K` [N·m/rad]."""
        self.reference = np.array([theta, K])
        least, most = self.quarter_range
        quarter = pi / 2 * sqrt(self.plant.inertia / K) / self.dt
        self._quarter = int(min(max(quarter, least), most) + 0.5)
        self.ringing = False

    def _pushed(self, task: Task) -> bool:
        if not self.resting:
            return False
        mean, swing = self._swing(_QUARTERS)
        away = abs(task.seen[0] - self.reference[0] - mean)
        jolt = JOLT * (2 if self.ringing else 1)  # friction that is not there is predicted, too
        return bool(abs(task.seen[0] - task.expected) > jolt or away > PUSH + swing + self._free)

    def _check(self) -> None:
        mean, swing = self._swing(_QUARTERS)
        beyond = min(self._quarters[:, _HIGH].max(), -self._quarters[:, _LOW].min())
        self._swings = self._swings + 1 if beyond > RINGING else 0
        self.ringing |= self._swings >= _SWINGS
        if not self.ringing and max(self._quarters[-1, _HIGH], -self._quarters[-1, _LOW]) > FAR:
            self._samples = 0
        bound = MEAN if self.ringing else min(START + GROWTH * self.dt * (self._samples - self.dwell), FAR)
        if (self.ringing or self._samples >= self.dwell) and abs(mean) <= bound and swing <= SWING:
            self._rest_at(self._quarters[-(_QUARTERS if self.ringing else _HALF) :, _P].mean(axis=0))

    def _rest_at(self, p: Array) -> None:
        self.resting = True
        margin = self.compensation.dead_band / 2 + LEAK
        self._p, self.side = p, 1.0 if p.max() + margin < self.limits.pressure[1] else -1.0
        self._began = self._quarters[-1, _P].copy()
        self._since, self._torque, self._error, self._free = 0, 0.0, 0.0, EDGE

    # --- what is seen -----------------------------------------------------------------------------------------------

    def _quarter_ended(self, seen: Array) -> bool:
        """Return whether a quarter of a period ends with this sample."""
        e = float(seen[0] - self.reference[0])
        self._sum += (e, *seen[NX - NU :])
        self._in_sum += 1
        self._low, self._high = min(self._low, e), max(self._high, e)
        if self._in_sum < self._quarter:
            return False
        self._quarters[:-1] = self._quarters[1:]
        self._quarters[-1] = *(self._sum / self._in_sum), self._low, self._high
        self._counted = min(self._counted + 1, _QUARTERS)
        self._sum, self._in_sum = np.zeros(1 + NU), 0
        self._low, self._high = np.inf, -np.inf
        return True

    def _swing(self, quarters: int) -> tuple[float, float]:
        """Return the mean of e, and how far it goes from peak to peak, over the last `quarters` [rad]."""
        last = self._quarters[-quarters:]
        return float(last[:, _E].mean()), float(last[:, _HIGH].max() - last[:, _LOW].min())

    # --- corrections ------------------------------------------------------------------------------------------------

    def _correct(self) -> None:
        P = self._quarters[-_HALF:, _P].mean(axis=0)
        if np.abs(P - self._p).max() > self.compensation.dead_band / 2 + LEAK:
            self.begin()
            return
        swings = self._swing(_HALF)[1] >= STILL
        waited = self._since - ceil(self.settling / self._quarter)
        self._since += 1
        if waited > 0:
            self._free = 0.0
        m = self._swing(_QUARTERS if swings else 1)[0]
        dead_zone = DEAD_ZONE * (2 if self.ringing else 1)  # every correction makes it ring again
        if waited >= (_QUARTERS - 1 if swings else 0) and abs(m) > dead_zone:
            self._turn(m, swings, P)

    def _turn(self, m: float, swings: bool, P: Array) -> None:
        """Correct the mean error `m` [rad]; the pressures (2,) [Pa] have been `P` of late."""
        x = np.array([self.reference[0] + m, 0.0, *self._p])
        if not (K := float(self.plant.isobaric(x))) > 0:
            return
        torque = -m * (K if swings or self.ringing else self._gain(m, K))
        slopes = np.array([side.torque_gain(p) for side, p in zip(self.plant.joint.sides(x[0]), self._p, strict=True)])
        change = np.minimum(self.side * torque / slopes, MOST)
        play = np.minimum(self.side * P, self.side * self._began) - NOISE
        moved = self.side * (np.maximum(self.side * self._p, play) + change)
        self._p, self._began = (np.where(change > 0, moved, before) for before in (self._p, self._began))
        self._since, self._torque, self._error, self._free = 0, torque, m, abs(torque) / K

    def _gain(self, m: float, K: float) -> float:
        """Return g [N·m/rad] of a joint that does not move."""
        g = FIRST * K
        if self._torque:
            moved = (m - self._error) * np.sign(self._torque)
            g = float(np.clip(abs(self._torque) / (max(moved, 0.0) + RESOLUTION) / 2, K, STIFFEST * K))
        return min(g, K * (1 + OVERSHOOT / abs(m)))


class NoRest:
    """The rest mode of an arm: its commands follow the MPC at a constant reference, too."""

    ringing, worthwhile, side = False, False, 0.0

    def reset(self) -> None:
        """Do nothing."""

    def pressures(self, task: Task) -> None:
        """Return None: no rest."""


def rest_mode_of(plant: Machine, dt: float, compensation: Compensation, limits: Limits) -> RestMode | NoRest:
    """Return the rest mode of a joint, which an arm has none of: nobody knows its friction."""
    return RestMode(plant, dt, compensation, limits) if isinstance(plant, Plant) else NoRest()
