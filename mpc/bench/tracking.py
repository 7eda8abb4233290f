"""Tracking: a controller and its observer as the command source of a loop, also for the replay of a log.

An observer assumes evenly spaced readings, and at 1 rad/s a millisecond is 0.06°: late readings are therefore projected
to their due time. So is an angle that its device dates up to a sample earlier, by the estimated velocity; the observer
compensates a constant age (`Compensation.reading_age`). For each missed sample the observer gets a sample without a
reading, under the held command.
"""

from math import isfinite

import numpy as np

from allocator.calculus import Array
from mpc.bench.cycle import Decision, Phase, Tick
from mpc.bench.device import Reading
from mpc.bench.guard import Pressures
from mpc.bench.record import Columns, of_plan
from mpc.bench.safety import Action, Reason, Stopped, Watchdog
from mpc.model.plant import NX, Plant
from mpc.observer.base import Observer
from mpc.observer.health import WELL, Health, Reaction
from mpc.trials.motions.reference import Reference
from mpc.trials.simulation import Controller

_ACTIONS = {Reaction.VENT: Action.VENT}  # otherwise the configured stop, since a hold needs a running loop
_ESTIMATES = ("theta_estimate", "omega_estimate", "P1_estimate", "P2_estimate", "d_estimate")
_UNSEEN = np.full(NX, np.nan)


class Tracking:
    """`CommandSource` of a controller, which settles at the reference's first point and then follows it."""

    def __init__(
        self,
        plant: Plant,
        controller: Controller,
        observer: Observer,
        reference: Reference,
        settle: float = 0.0,
        watchdog: Watchdog | None = None,
    ) -> None:
        self.controller, self.observer = controller, observer
        self._watchdog = Watchdog() if watchdog is None else watchdog
        self.dt = dt = controller.dt
        given = reference.resampled(dt)
        self._settling = round(settle / dt)
        t: Array = dt * np.arange(self._settling + given.t.size, dtype=float)
        i = np.maximum(np.arange(t.size) - self._settling, 0)  # the first point until the joint has settled
        self.reference = Reference(t, given.theta[i], given.K[i])
        one, two = plant.at_rest(float(given.theta[0]), float(given.K[0]))[2:].tolist()
        self.first: Pressures = one, two
        self._begun: int | None = None  # the sample of the first decision
        self._before: tuple[float, Array] | None = None  # the last reading's time [s] and values (4,)
        self._omega = 0.0  # last estimate of the velocity [rad/s]
        self._unwell = 0  # samples for which health has required a reaction
        observer.reset()
        controller.reset()

    @property
    def health(self) -> Health:
        """Suspects of the observer; none without a diagnosis."""
        health = getattr(self.observer, "health", WELL)
        assert isinstance(health, Health)
        return health

    def decide(self, tick: Tick) -> Decision | None:
        """Return the controller's commands, None after the last sample of the reference."""
        if self._begun is None:
            self._begun = tick.k
        k = tick.k - self._begun
        if k >= self.reference.t.size:
            return None
        x, d = self._estimate(tick)
        if k == 0:  # a controller's first step begins at the given pressures, those last commanded
            x[2:] = tick.sent
        self._check_health()
        plan = self.controller.step(x, *self.reference.preview(k, self.controller.ahead), d)
        estimate = dict(zip(_ESTIMATES, [*x.tolist(), d], strict=True))
        about = {"theta_ref": self.reference.theta[k], "K_ref": self.reference.K[k], **estimate, **of_plan(plan)}
        one, two = plan.u[0].tolist()
        return Decision((one, two), Phase.SETTLE if k < self._settling else Phase.RUN, about)

    def _estimate(self, tick: Tick) -> tuple[Array, float]:
        sent = np.array(tick.sent)
        for _ in range(tick.missed):
            self.observer.estimate(_UNSEEN, sent)
        x, d = self.observer.estimate(self._at_due(tick), sent)
        self._omega = float(x[1]) if isfinite(x[1]) else 0.0
        return x, d

    def _at_due(self, tick: Tick) -> Array:
        """Return the readings (4,) projected to the due time.

        A later reading is interpolated linearly from the one before, an earlier angle is extrapolated with the
        estimated velocity.
        """
        t, *now = tick.reading
        said = np.array([now[0], np.nan, now[1], now[2]])
        before, self._before = self._before, (t, said)
        if 0 < tick.due - t <= self.dt:
            said[0] += self._omega * (tick.due - t)
            return said
        if before is None or not t > before[0] or not tick.due < t:
            return said
        share = min((t - tick.due) / (t - before[0]), 1.0)
        line = said + share * (before[1] - said)
        return np.where(np.isnan(line), said, line)

    def _check_health(self) -> None:
        """Raise `Stopped` if health has requested a hold or a vent for too long."""
        least = self._watchdog.reaction
        if least is None or self.health.reaction < least:
            self._unwell = 0
            return
        self._unwell += 1
        if self._unwell * self.dt > self._watchdog.lasting:
            raise Stopped(Reason.UNHEALTHY, str(self.health), _ACTIONS.get(self.health.reaction))


def replay(columns: Columns, tracking: Tracking) -> Array:
    """Return the commands (n, 2) [Pa] of `tracking` for the readings and commands of a log.

    They are those of the log's n samples under control, if `tracking` has the same plant, controller, observer and
    reference, and if no guard changed them.
    """
    commands, sent = [], None
    names = ("read_at", "theta", "P1", "P2", "P1_command", "P2_command", "phase", "missed")
    due = (columns["t"] - columns["late"]).tolist()
    k = -1
    for t, theta, P1, P2, one, two, phase, missed, at in zip(*(columns[n].tolist() for n in names), due, strict=True):
        if phase == Phase.STOP:
            break
        k += 1 + missed
        tick = Tick(k, missed, Reading(t, theta, P1, P2), (P1, P2) if sent is None else sent, at)
        if phase != Phase.RAMP and (decision := tracking.decide(tick)) is not None:
            commands.append(decision.u)
        sent = one, two
    return np.array(commands).reshape(-1, 2)
