"""Real-time loop of a controller and its observer on a device, along a reference.

    loop = RealTimeLoop(device, controller, KalmanObserver(plant, dt), reference, log="run.csv")
    record = loop.run()
    print(record.ending, record.lateness)

Controller and observer are used as on a simulated plant (`mpc.trials.simulation.simulate`). `mpc.bench.loop`
decides on the commands; `mpc.bench.cycle` is responsible for the time, the limits and the safe stop.

Tracking: a controller and its observer as the command source of a loop, also for the replay of a log.

Readings are projected to their due time (`mpc.bench.projection`). For each missed sample the observer gets a sample
without a reading, under the held command.
"""

from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from mpc.bench.cycle import Cycle, Decision, Overrun, Phase, Settings, Tick
from mpc.bench.device import Clock, Device, Reading
from mpc.bench.logs import Record
from mpc.bench.projection import Projection
from mpc.bench.rows import Columns, Pressures, Row, Sheet, of_plan
from mpc.bench.safety import Action, Reason, SafeStop, SoftStart, Stopped, Watchdog
from mpc.model.experiment import check_stiffness
from mpc.model.machine import Machine
from mpc.model.plant import Plant
from mpc.observer.base import Observer, check_observer
from mpc.observer.health import WELL, FaultKind, Health, Part, Reaction
from mpc.trials.motions.reference import LONGEST, Reference
from mpc.trials.simulation import Controller, check_parts

_BLIND = 0.1  # missed samples [s] in a second, which the observer takes for silent sensors
_ACTIONS = {Reaction.VENT: Action.VENT}  # otherwise the configured stop, since a hold needs a running loop


class Tracking:
    """`CommandSource` of a controller, which settles at the reference's first point and then follows it."""

    def __init__(
        self,
        plant: Machine,
        controller: Controller,
        observer: Observer,
        reference: Reference,
        settle: float = 0.0,
        watchdog: Watchdog | None = None,
    ) -> None:
        self.plant, self.controller, self.observer = plant, controller, observer
        self._single, self._n, self._unseen = isinstance(plant, Plant), plant.n, np.full(plant.size, np.nan)
        self._watchdog = Watchdog() if watchdog is None else watchdog
        self.dt = dt = controller.dt
        given = reference.resampled(dt)
        self._settling = checks.count("samples of settling", round(settle / dt), 0, LONGEST)
        self._end = self._settling + reference.samples(dt) + 1  # the tail is for preview only
        t: Array = dt * np.arange(self._settling + given.t.size, dtype=float)
        i = np.maximum(np.arange(t.size) - self._settling, 0)  # the first point until the joint has settled
        if not self._single:
            check_stiffness("K of the reference", given.K, "N·m/rad")
        self.reference = Reference(t, given.theta[i], given.K[i])
        self.first: Pressures = tuple(_rest(plant, given)[2 * plant.n :].tolist())
        self._begun: int | None = None  # the sample of the first decision
        self._projection = Projection(plant.n, dt)
        self._omega: Value = 0.0  # last estimate of the velocities (n,) [rad/s]
        self._unwell = 0  # samples for which health has required a reaction
        self._left_out: deque[tuple[int, int]] = deque()  # samples of the last second, and missed ones before them
        observer.reset()
        controller.reset()

    @property
    def health(self) -> Health:
        """Suspects of the observer; none without a diagnosis."""
        health = getattr(self.observer, "health", WELL)
        assert isinstance(health, Health)
        return health

    def decide(self, tick: Tick) -> Decision | None:
        """Return the controller's commands, None after the last sample of the reference before its tail."""
        if self._begun is None:
            self._begun = tick.k
        k = tick.k - self._begun
        if k >= self._end:
            return None
        x, d = self._estimate(tick)
        if k == 0:  # a controller's first step begins at the given pressures, those last commanded
            x[2 * self._n :] = tick.sent
        self._check_health(tick)
        plan = self.controller.step(x, *self.reference.preview(k, self.controller.ahead), d)
        asked = {"theta_ref": self.reference.theta[k], "K_ref": self.reference.K[k]}
        about = {**asked, **self._estimated(x, d), **of_plan(plan)}
        return Decision(tuple(plan.u[0].tolist()), Phase.SETTLE if k < self._settling else Phase.RUN, about)

    def _estimate(self, tick: Tick) -> tuple[Array, Value]:
        sent = np.array(tick.sent)
        for _ in range(tick.missed):
            self.observer.estimate(self._unseen, sent)
        read = self._projection.at_due(tick, self._omega)
        x, d = self.observer.estimate(read, sent)
        self._omega = x[self._n : 2 * self._n].copy()
        return x, d

    def _estimated(self, x: Array, d: Value) -> dict[str, Any]:
        """Return the fields of `Row` for a state `x` (2n + m,) and a disturbance torque `d`."""
        n, values = self._n, x.tolist()
        theta, omega = (values[0], values[1]) if self._single else (values[:n], values[n : 2 * n])
        return {
            "theta_estimate": theta, "omega_estimate": omega, "P_estimate": tuple(values[2 * n :]), "d_estimate": d,
        }  # fmt: skip

    def _check_health(self, tick: Tick) -> None:
        """Raise `Stopped` if health has requested a hold or a vent for too long, or if the supply is lost."""
        lost = self._lost(tick)
        least = self._watchdog.reaction
        starved = self._starved(tick)
        if least is None or (self.health.reaction < least and not starved):
            self._unwell = 0
            return
        self._unwell += 1 + tick.missed
        if self._unwell * self.dt > self._watchdog.lasting:
            if lost * self.dt >= _BLIND and all(s.fault is FaultKind.SILENT_SENSOR for s in self.health.suspects):
                raise Stopped(Reason.LATE, f"{lost} of the last second; controller or device take too long")
            if starved:  # a ramp from the commands would fill the muscles when the supply returns
                raise Stopped(Reason.UNHEALTHY, f"the supply is lost: {self.health}", Action.VENT)
            raise Stopped(Reason.UNHEALTHY, str(self.health), _ACTIONS.get(self.health.reaction))

    def _starved(self, tick: Tick) -> bool:
        """Return whether a lost supply leaves less than half of the commands: on its return the muscles would jump.

        The health names it, or rejects two pressures at once, as of a supply that collapses.
        """
        faults = [s.fault for s in self.health.suspects if not s.part.startswith(Part.ANGLE)]
        low = FaultKind.SUPPLY_DROP in faults or faults.count(FaultKind.REJECTED_SENSOR) > 1
        return low and sum(tick.reading.P) < sum(tick.sent) / 2

    def _lost(self, tick: Tick) -> int:
        """Return how many samples were missed in the last second."""
        self._left_out.append((tick.k, tick.missed))
        while (tick.k - self._left_out[0][0]) * self.dt > 1.0:
            self._left_out.popleft()
        return sum(missed for _, missed in self._left_out)


def replay(columns: Columns, tracking: Tracking) -> Array:
    """Return the commands (N, m) [Pa] of `tracking` for the readings and commands of a log.

    They are those of the log's N samples under control, if `tracking` has the same plant, controller, observer and
    reference, and if no guard changed them.
    """
    sheet, commands, sent = Sheet.of(tracking.plant), [], None
    said = (sheet.values(columns, name).tolist() for name in ("read_at", "theta", "P", "P_command", "phase", "missed"))
    late = columns["late"].tolist()
    due = (columns["t"] - columns["late"]).tolist()
    k = -1
    for t, theta, P, u, phase, missed, at, after in zip(*said, due, late, strict=True):
        if phase == Phase.STOP:
            break
        k += 1 + missed
        tick = Tick(k, missed, Reading(t, theta, tuple(P)), tuple(P) if sent is None else sent, at, after)
        if phase != Phase.RAMP and (decision := tracking.decide(tick)) is not None:
            commands.append(decision.u)
        sent = tuple(u)
    return np.array(commands).reshape(-1, tracking.plant.m)


class RealTimeLoop:
    """One run of `controller` and `observer` on `device` along `reference`.

    Parameters
    ----------
    device
        Sensors and valves of the joint or the arm; `run` enters it.
    controller, observer
        As for `mpc.simulate`; the sample time is the controller's.
    reference
        Angles [rad] and stiffness [N·m/rad] over time; between its samples a smooth curve.
    plant
        Model that defines the limits and the rest at the end of the soft start; by default the controller's.
    start, stop, watchdog, overrun
        See `mpc.bench.safety` and `mpc.bench.cycle.Overrun`.
    zero
        Encoder reading at 0 of the joint [rad], as of a fit; (n,) of an arm. It is subtracted from every reading,
        before the observer, the limits and the log; the log's head states it.
    log
        CSV file that is written sample by sample; see `mpc.bench.rows`.
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
        plant: Machine | None = None,
        start: SoftStart | None = None,
        stop: SafeStop | None = None,
        watchdog: Watchdog | None = None,
        overrun: Overrun = Overrun.SKIP,
        zero: Value = 0.0,
        log: str | Path | None = None,
        replace: bool = False,
        clock: Clock | None = None,
        watch: Callable[[Row], None] | None = None,
    ) -> None:
        self.plant = _plant_of(controller) if plant is None else plant
        check_parts(self.plant, controller, reference)
        check_observer(observer, controller.dt)
        zero = _zero_of(self.plant, zero)
        settings = Settings(overrun, start or SoftStart(), watchdog or Watchdog(), stop or SafeStop(), zero)
        settings.check()
        _rehearse(self.plant, controller, observer, reference)
        self.tracking = Tracking(self.plant, controller, observer, reference, settings.start.settle, settings.watchdog)
        self.cycle = Cycle(
            device, self.tracking, self.plant, settings, log=log, replace=replace, clock=clock, watch=watch
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
        return Record(self.plant, self.cycle.dt, self.cycle.recorder.columns, self.cycle.ending, self.tracking.health)

    def stop(self) -> None:
        """Request the safe stop, from any thread."""
        self.cycle.request_stop()


def _plant_of(controller: Controller) -> Machine:
    plant = getattr(controller, "plant", None)
    if not isinstance(plant, Machine):
        raise InvalidInput(f"plant = None: {type(controller).__name__} has none, and its limits are needed")
    return plant


def _zero_of(machine: Machine, zero: Value) -> Value:
    """Return the zeros of the encoders [rad]: a number for a joint, (n,) for an arm. Raises `InvalidInput`."""
    angle, shape = checks.angle("zero", zero), machine.angle_shape
    if angle.shape not in ((), shape):
        wanted = f"n = {machine.n} angles [rad], one a joint" if shape else "one angle [rad]"
        raise InvalidInput(f"zero = {checks.brief(zero)} has to be {wanted}")
    return np.broadcast_to(angle, shape) if shape else float(angle)


def _rest(machine: Machine, reference: Reference) -> Array:
    """Return the state (2n + m,) at rest at the first point of a reference."""
    return np.asarray(machine.at_rest(reference.theta[0], reference.K[0]))


def _rehearse(plant: Machine, controller: Controller, observer: Observer, reference: Reference) -> None:
    """Run one sample of both in advance, so that nothing is loaded or compiled during the loop."""
    seen = _rest(plant, reference)
    P = seen[2 * plant.n :].copy()
    seen[plant.n : 2 * plant.n] = np.nan
    for _ in range(2):
        estimated, d = observer.estimate(seen, P)
        controller.step(estimated, reference.theta[0], reference.K[0], d)
