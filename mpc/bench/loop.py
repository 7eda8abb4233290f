"""Real-time loop of a controller and its observer on a device, along a reference.

    loop = RealTimeLoop(device, controller, KalmanObserver(plant, dt), reference, log="run.csv")
    record = loop.run()
    print(record.ending, record.lateness)

Controller and observer are used as on a simulated plant (`mpc.trials.simulation.simulate`). `mpc.bench.loop`
decides on the commands; `mpc.bench.cycle` is responsible for the time, the limits and the safe stop.

Tracking: a controller and its observer as the command source of a loop, also for the replay of a log.

An observer assumes evenly spaced readings, and at 1 rad/s a millisecond is 0.06°: late readings are therefore projected
to their due time. So is an angle that its device dates up to a sample earlier, by the estimated velocity; the observer
compensates a constant age (`Compensation.reading_age`). For each missed sample the observer gets a sample without a
reading, under the held command.
"""

from collections.abc import Callable
from math import isfinite
from pathlib import Path

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from mpc.bench.cycle import Cycle, Decision, Overrun, Phase, Settings, Tick
from mpc.bench.device import Clock, Device, Reading
from mpc.bench.logs import Record
from mpc.bench.record import Columns, Row, of_plan
from mpc.bench.safety import Action, Pressures, Reason, SafeStop, SoftStart, Stopped, Watchdog
from mpc.model.plant import NU, NX, Plant
from mpc.observer.base import Observer
from mpc.observer.health import WELL, Health, Reaction
from mpc.tracking.limits import Limits
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
        t, theta, P = tick.reading
        said = np.array([theta, np.nan, *P])
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
        tick = Tick(k, missed, Reading(t, theta, (P1, P2)), (P1, P2) if sent is None else sent, at)
        if phase != Phase.RAMP and (decision := tracking.decide(tick)) is not None:
            commands.append(decision.u)
        sent = one, two
    return np.array(commands).reshape(-1, 2)


class RealTimeLoop:
    """One run of `controller` and `observer` on `device` along `reference`.

    Parameters
    ----------
    device
        The joint's sensors and valves; `run` enters it.
    controller, observer
        As for `mpc.simulate`; the sample time is the controller's.
    reference
        Angle [rad] and stiffness [N·m/rad] over time; between its samples a smooth curve.
    plant
        Model that defines the limits and the rest at the end of the soft start; by default the controller's.
    start, stop, watchdog, overrun
        See `mpc.bench.safety` and `mpc.bench.cycle.Overrun`.
    zero
        Encoder reading at 0 of the joint [rad], as of a fit. It is subtracted from every reading, before the observer,
        the limits and the log; the log's head states it.
    log
        CSV file that is written sample by sample; see `mpc.bench.record`.
    replace
        Whether an existing `log` may be replaced, by the first sample.
    clock
        Clock, by default this computer's monotonic one; a faster `SimulatedDevice` has its own.
    watch
        Called with every `Row`, after its command was sent, for a display. It must return quickly. If it raises, the
        loop ends with the safe stop, and `run` raises the exception.
    """

    def __init__(
        self,
        device: Device,
        controller: Controller,
        observer: Observer,
        reference: Reference,
        *,
        plant: Plant | None = None,
        start: SoftStart | None = None,
        stop: SafeStop | None = None,
        watchdog: Watchdog | None = None,
        overrun: Overrun = Overrun.SKIP,
        zero: float = 0.0,
        log: str | Path | None = None,
        replace: bool = False,
        clock: Clock | None = None,
        watch: Callable[[Row], None] | None = None,
    ) -> None:
        self.plant = _plant_of(controller) if plant is None else plant
        zero = float(checks.angle("zero", zero))
        settings = Settings(overrun, start or SoftStart(), watchdog or Watchdog(), stop or SafeStop(), zero)
        dt = controller.dt
        limits = Limits.of(self.plant, dt)
        _rehearse(self.plant, controller, observer, reference)
        self.tracking = Tracking(self.plant, controller, observer, reference, settings.start.settle, settings.watchdog)
        self.cycle = Cycle(
            device, self.tracking, limits, settings, log=log, replace=replace, about=about(dt), clock=clock, watch=watch
        )

    def run(self) -> Record:
        """Run to the end of the reference or an earlier ending; return the record.

        Raises `RefusedStart` and `DeviceError` before the first command, `InvalidInput` for an existing log, and
        `CannotWrite` if the log cannot begin. Any exception of device, controller, observer or `watch` that is not a
        `DeviceError` is raised after the safe stop; `record` then has the recorded samples.
        """
        self.cycle.run()
        return self.record

    @property
    def record(self) -> Record:
        """Record of a loop that has ended, even by an exception. Raises `InvalidInput` before."""
        if self.cycle.ending is None:
            raise InvalidInput("the loop has not run, or has not ended: there is no record of it")
        return Record(self.plant, self.cycle.dt, self.cycle.recorder.columns, self.cycle.ending)

    def stop(self) -> None:
        """Request the safe stop, from any thread."""
        self.cycle.request_stop()


def about(dt: float) -> list[str]:
    """Return the first lines of a log."""
    return [f"antagonist log; dt = {dt!r} s; SI units; muscle 1 is the agonist; NaN: not measured"]


def _plant_of(controller: Controller) -> Plant:
    plant = getattr(controller, "plant", None)
    if not isinstance(plant, Plant):
        raise InvalidInput(f"plant = None: {type(controller).__name__} has none, and its limits are needed")
    return plant


def _rehearse(plant: Plant, controller: Controller, observer: Observer, reference: Reference) -> None:
    """Run one sample of both in advance, so that nothing is loaded or compiled during the loop."""
    theta, K = float(reference.theta[0]), float(reference.K[0])
    x = plant.at_rest(theta, K)
    seen = x.copy()
    seen[1] = np.nan
    for _ in range(2):
        estimated, d = observer.estimate(seen, x[NX - NU :])
        controller.step(estimated, theta, K, d)
