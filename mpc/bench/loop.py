"""Real-time loop of a controller and its observer on a device, along a reference.

    loop = RealTimeLoop(device, controller, KalmanObserver(plant, dt), reference, log="run.csv")
    record = loop.run()
    print(record.ending, record.lateness)

Controller and observer are used as on a simulated plant (`mpc.trials.simulation.simulate`). `mpc.bench.tracking`
decides on the commands; `mpc.bench.cycle` is responsible for the time, the limits and the safe stop.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from allocator import checks
from allocator.errors import InvalidInput
from mpc.bench.cycle import Cycle, Overrun, Settings
from mpc.bench.device import Clock, Device
from mpc.bench.logs import Record
from mpc.bench.record import Row
from mpc.bench.safety import SafeStop, SoftStart, Watchdog
from mpc.bench.tracking import Tracking
from mpc.model.plant import NU, NX, Plant
from mpc.observer.base import Observer
from mpc.tracking.limits import Limits
from mpc.trials.motions.reference import Reference
from mpc.trials.simulation import Controller


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
