"""Sweep and tracking on the exported firmware, with a joint of unknown parameters."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from typer.testing import CliRunner

from allocator.identification.joint.planning.plan import plan_joint_experiment
from allocator.joint.antagonist import report_joint
from allocator.muscles import scaled
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc import Compensation, KalmanObserver, Plant, TrackingMPC, Weights
from mpc.bench.cycle import Cycle, Settings
from mpc.bench.device import Clock, MonotonicClock, SimulatedClock
from mpc.bench.devices.serial_line import SerialDevice
from mpc.bench.devices.simulated import simulated
from mpc.bench.logs import Record
from mpc.bench.loop import RealTimeLoop
from mpc.bench.safety import SoftStart, Watchdog
from mpc.bench.sweep import Pace, Sweep, random_steps, visits_of, within
from mpc.cli import app
from mpc.export.serial.simulated import SimulatedBoard
from mpc.trials.files import reference_called
from mpc.trials.motions.reference import Reference

ROUGH = Plant(report_joint(SAROSI_DMSP_20_400N))  # from a data sheet
WEAKER = {"agonist": scaled(SAROSI_DMSP_20_400N, 0.9), "antagonist": scaled(SAROSI_DMSP_20_400N, 0.82)}
HIDDEN = Plant(replace(ROUGH.joint, **WEAKER), inertia=0.04, damping=0.15, lag=(0.09, 0.11), gas=False)
GEOMETRY = "--pulley", "20,0.1375", "--rest-length", "400"  # of `antagonist fit-joint`
_VENTED = np.zeros(4)


def antagonist(*arguments: object) -> str:
    """Return the output of a command, which has to succeed."""
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    assert result.exit_code == 0, result.output
    return result.output


@dataclass(frozen=True)
class Afternoon:
    """Session in real time, or with a board whose clock advances at every command, which is reproducible."""

    real_time: bool
    timeout: float = 1.0  # of an answer [s]
    flags: tuple[str, ...] = ("-O1",)  # of the compiler

    def sweep(self, directory: Path, motion: int, dt: float = 0.02) -> Cycle:
        """Write the logs of a sweep with `motion` [s] of random steps; return its result."""
        plan = plan_joint_experiment(within(ROUGH.joint), accuracy=0.05)
        steps = random_steps(ROUGH.joint, motion)
        with self._board(dt) as board:
            device, clock = self._device(board)
            source = Sweep(visits_of(plan, ROUGH.joint), steps, dt, board.hang, directory, Pace(motion=float(motion)))
            settings = Settings(watchdog=self._watchdog)
            cycle = Cycle(device, source, ROUGH, settings, clock=clock)
            cycle.run()
        return cycle

    def run(self, plant: Plant, known: Compensation, log: Path) -> Record:
        """Track min-jerk at 100 Hz by the MPC for the identified `plant`."""
        parts, start = self.loop(plant, known), SoftStart(settle=1.0)
        with self._board(parts[0].dt) as board:
            device, clock = self._device(board)
            return RealTimeLoop(
                device, *parts, self.reference(plant), start=start, watchdog=self._watchdog, log=log, clock=clock
            ).run()

    @staticmethod
    def loop(plant: Plant, known: Compensation) -> tuple[TrackingMPC, KalmanObserver]:
        """Return a controller for the identified `plant`, and its observer."""
        controller = TrackingMPC(plant, N=20, weights=Weights.calm(), compensation=known)
        return controller, KalmanObserver(plant, controller.dt, compensation=known)

    @staticmethod
    def reference(plant: Plant) -> Reference:
        """Return the trajectory that is tracked."""
        return reference_called("min-jerk", None, plant)

    @property
    def _watchdog(self) -> Watchdog:
        """Return a watchdog that in simulated time ignores the delays of a busy machine."""
        return Watchdog() if self.real_time else Watchdog(stall=60.0)

    def _board(self, dt: float) -> SimulatedBoard:
        process = simulated(HIDDEN, Compensation())
        return SimulatedBoard(process, step=0.0 if self.real_time else dt, x0=_VENTED, flags=self.flags)

    def _device(self, board: SimulatedBoard) -> tuple[SerialDevice, Clock]:
        clock = MonotonicClock() if self.real_time else SimulatedClock()
        return SerialDevice(board.port, timeout=self.timeout, clock=clock), clock
