"""Tracking is what a controller and its observer do with the samples of a loop; a log can be replayed through them.

Where samples had to be left out the observer is told so: a sample without a reading under the command that was held.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from allocator.calculus import Array
from mpc.bench.cycle import Decision, Phase, Pressures, Tick
from mpc.bench.device import Reading
from mpc.bench.record import of_plan
from mpc.bench.safety import Action, Reason, Stopped, Watchdog
from mpc.model.plant import NX, Plant
from mpc.observer.health import WELL, Health, Reaction
from mpc.observer.kalman import Observer
from mpc.trials.reference import Reference
from mpc.trials.simulation import Controller

_ACTIONS = {Reaction.VENT: Action.VENT, Reaction.HOLD: Action.HOLD}
_UNSEEN = np.full(NX, np.nan)


class Tracking:
    """Tracking is the `CommandSource` of a controller: it settles at the reference's first point, then follows it."""

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
        dt = controller.dt
        given = reference.resampled(dt)
        self._settling = round(settle / dt)
        t = dt * np.arange(self._settling + given.t.size)
        theta, K = (np.pad(a, (self._settling, 0), "edge") for a in (given.theta, given.K))
        self.reference = Reference(t, theta, K)
        one, two = plant.at_rest(float(given.theta[0]), float(given.K[0]))[2:].tolist()
        self.first: Pressures = one, two
        self._begun: int | None = None  # the sample of the first decision
        self._unwell = 0  # samples for which health has asked for a reaction
        observer.reset()
        controller.reset()

    @property
    def health(self) -> Health:
        """Return what the observer suspects; nothing if it has no diagnosis."""
        health = getattr(self.observer, "health", WELL)
        assert isinstance(health, Health)
        return health

    def observe(self, tick: Tick) -> dict[str, Any]:
        """Estimate state and torque from a reading, and say them."""
        x, d = self._estimate(tick)
        names = ("theta_estimate", "omega_estimate", "P1_estimate", "P2_estimate", "d_estimate")
        return dict(zip(names, [*x.tolist(), d], strict=True))

    def decide(self, tick: Tick) -> Decision | None:
        """Return the controller's commands, None after the last sample of the reference."""
        if self._begun is None:
            self._begun = tick.k
        k = tick.k - self._begun
        if k >= self.reference.t.size:
            return None
        about = self.observe(tick)
        self._check_health()
        *x, d = list(about.values())
        plan = self.controller.step(x, *self.reference.preview(k, self.controller.ahead), d)
        about |= {"theta_ref": self.reference.theta[k], "K_ref": self.reference.K[k], **of_plan(plan)}
        one, two = plan.u[0].tolist()
        return Decision((one, two), Phase.SETTLE if k < self._settling else Phase.RUN, about)

    def _estimate(self, tick: Tick) -> tuple[Any, float]:
        sent = np.array(tick.sent)
        for _ in range(tick.missed):
            self.observer.estimate(_UNSEEN, sent)
        _, theta, P1, P2 = tick.reading
        return self.observer.estimate(np.array([theta, np.nan, P1, P2]), sent)

    def _check_health(self) -> None:
        """Raise `Stopped` where health has asked for too long for what ends a loop."""
        least = self._watchdog.reaction
        if least is None or self.health.reaction < least:
            self._unwell = 0
            return
        self._unwell += 1
        if self._unwell * self.controller.dt > self._watchdog.lasting:
            raise Stopped(Reason.UNHEALTHY, str(self.health), _ACTIONS.get(self.health.reaction))


def replay(columns: Mapping[str, Any], tracking: Tracking) -> Array:
    """Return the commands (n, 2) [Pa] that `tracking` decides on where it is told what the log says was read and sent.

    They are those of the log's n samples under control, if `tracking` has the same plant, controller, observer and
    reference, and if no guard changed them.
    """
    commands, sent = [], None
    names = ("theta", "P1", "P2", "P1_command", "P2_command", "phase", "missed")
    rows = zip(*(columns[name].tolist() for name in names), strict=True)
    k = -1
    for theta, P1, P2, one, two, phase, missed in rows:
        if phase == Phase.STOP:
            break
        k += 1 + missed
        tick = Tick(k, missed, Reading(float(k), theta, P1, P2), (P1, P2) if sent is None else sent)
        if phase == Phase.RAMP:
            tracking.observe(tick)
        elif (decision := tracking.decide(tick)) is not None:
            commands.append(decision.u)
        sent = one, two
    return np.array(commands).reshape(-1, 2)


__all__ = ["Tracking", "replay"]
