"""A loop over a serial line ends safely, whatever happens to the line."""

import os
import signal

import numpy as np
import pytest

from allocator.units import BAR, DEG
from mpc import Plant, RealPlant, Reference
from mpc.bench.device import SimulatedClock
from mpc.bench.devices.serial_line import SerialDevice
from mpc.bench.devices.serial_protocol import State
from mpc.bench.loop import RealTimeLoop
from mpc.bench.safety import Reason, SafeStop, SoftStart, Watchdog
from mpc.export.serial.simulated import SimulatedBoard
from mpc.model.arm.model import Arm
from mpc.model.real import RealArm
from mpc.observer.base import Differentiator
from mpc.trials.motions.arm_trajectories import usual_stiffness
from mpc.yardsticks.baselines import PIDControl

from ...rigs.arm_pd import ArmPD
from ...rigs.fuzz import noise
from ...rigs.needs import needs, posix

pytestmark = [
    pytest.mark.tools,
    needs("gcc"),
    posix,
]
DT = 0.01


@pytest.fixture
def bench(request, tmp_path):
    """A board whose clock goes on at every command, a device that talks to it, and a second of motion for it.

    It is the board of a joint, or of arm26 where the test asks for "arm".
    """
    t, clock = np.linspace(0, 1, 101), SimulatedClock()
    theta = 10 * DEG * np.sin(np.pi * t) ** 2
    if getattr(request, "param", "joint") == "arm":
        plant = Arm.machine("arm26")
        q = np.stack([theta, -theta], axis=1)
        reference, controller = Reference(t, q, usual_stiffness(plant)(q)), ArmPD(plant, DT)
    else:
        plant = Plant()
        reference, controller = Reference(t, theta, np.full(t.size, 7.5)), PIDControl(plant, DT)
    real = RealPlant(plant) if isinstance(plant, Plant) else RealArm(plant)
    with SimulatedBoard(real, step=DT, flags=("-O0",)) as board:
        device = SerialDevice(board.port, timeout=1.0, clock=clock)

        def run(happens):
            """Run the loop; `happens(device, board, row)` after each sample."""
            loop = RealTimeLoop(
                device,
                controller,
                Differentiator(DT, plant.n),
                reference,
                start=SoftStart(rate=5 * BAR, dwell=0.1, settle=0.1),
                stop=SafeStop(rate=10 * BAR),
                watchdog=Watchdog(stall=60.0),
                clock=clock,
                log=tmp_path / "log.csv",
                watch=lambda row: happens(device, board, row),
            )
            record = loop.run()
            written = (tmp_path / "log.csv").read_text().splitlines()
            assert len(written) >= record.columns["t"].size  # up to the last sample
            return record, device

        yield run


@pytest.mark.parametrize("bench", ["joint", "arm"], indirect=True)
def test_a_run_to_its_end_leaves_the_board_vented(bench):
    record, device = bench(lambda device, board, row: None)
    assert record.ending.reason is Reason.FINISHED
    assert record.ending.delivered
    assert device.state == State.VENTED
    assert np.max(record.theta_rms) < 3 * DEG
    assert device.unanswered == device.late == 0


def test_garbage_on_the_line_does_not_disturb_a_run(bench):
    rng = np.random.default_rng(0)

    def garbage(device, board, row):
        with open(board.port, "wb", buffering=0) as other:
            other.write(noise(rng, 50))

    record, device = bench(garbage)
    assert record.ending.reason is Reason.FINISHED
    assert device.unanswered == 0
    assert device.damaged_there > 50


def test_a_cable_that_is_unplugged_ends_a_run_as_a_lost_device(bench):
    record, _ = bench(lambda device, board, row: board.stop() if row.t > 0.5 else None)
    assert record.ending.reason is Reason.DEVICE
    assert "is gone" in record.ending.message
    assert not record.ending.delivered
    assert record.columns["t"][-1] == pytest.approx(0.5, abs=0.05)


def test_a_board_that_does_not_answer_any_more_ends_a_run_as_silent(bench):
    stopped = []

    def hang(device, board, row):
        if row.t > 0.5 and device.timeout > 0.5:
            device.timeout = 0.01
            stopped.append(board.pid)
            os.kill(board.pid, signal.SIGSTOP)

    record, device = bench(hang)
    os.kill(stopped[0], signal.SIGCONT)
    assert record.ending.reason is Reason.SILENT
    assert not record.ending.delivered
    assert device.unanswered > 10


def test_a_board_that_another_host_has_taken_ends_a_run_as_a_lost_device(bench):
    def take(device, board, row):
        if row.t > 0.5 and device.state == State.DIRECT:
            with SerialDevice(board.port, timeout=1.0) as other:
                other.vent()

    record, _ = bench(take)
    assert record.ending.reason is Reason.DEVICE
    assert "no such session" in record.ending.message
