"""A serial device against the exported firmware, compiled for this machine, behind a pseudo-terminal."""

import os
import signal
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from allocator import errors
from allocator.errors import InvalidInput, MissingPackage
from allocator.units import BAR, DEG
from mpc import Arm, Compensation, KalmanObserver, Plant, RealPlant, TrackingMPC, Weights, simulate, sine
from mpc.bench.device import DeviceError, DeviceLost, NoAnswer
from mpc.bench.devices.serial_line import BoardInfo, SerialDevice, open_serial
from mpc.bench.devices.serial_protocol import VERSION, Frame, Kind, State, encoded
from mpc.cli import app
from mpc.export.controller.demonstration import arm_at_rest
from mpc.export.serial.check import examine
from mpc.export.serial.firmware import Safety
from mpc.export.serial.simulated import SimulatedBoard
from mpc.model.real import RealArm
from mpc.trials import circle
from mpc.trials.motions.corrections import Correction, Owner

from ...rigs.fuzz import noise
from ...rigs.needs import needs, posix

pytestmark = [
    pytest.mark.tools,
    needs("gcc"),
    posix,
]
ARM = Arm.machine("arm26")
PATIENT = 1.0  # [s]: a machine busy with other tests may stop a process for a while


@pytest.fixture(scope="module")
def board():
    with SimulatedBoard(RealPlant(), safety=Safety(watchdog=0.4, fall=2 * BAR), flags=("-O1",)) as running:
        yield running


@pytest.fixture
def device(board):
    with SerialDevice(board.port, timeout=PATIENT) as connected:
        yield connected


@pytest.fixture
def own_board():
    """A board that the test may break, whose clock stands still but for commands."""
    with SimulatedBoard(RealPlant(), step=0.01, flags=("-O0",)) as running:
        yield running


def test_the_board_says_what_was_chosen_at_export(device):
    assert device.info == (1, 2, 0, 0, 0.0, 0.0, 5 * BAR, 0.4, 2 * BAR)


def test_pressures_go_where_they_are_commanded(device):
    for _ in range(60):
        before = time.monotonic()
        device.write(3 * BAR, 1 * BAR)
        reading = device.read()
        assert before <= reading.t <= time.monotonic()
        time.sleep(0.01)
    assert device.state == State.DIRECT
    assert reading.P[0] == pytest.approx(3 * BAR, rel=0.1)
    assert reading.P[1] == pytest.approx(1 * BAR, rel=0.1)
    assert reading.theta > 20 * DEG


def test_a_silent_host_lets_the_pressures_fall_together_and_has_to_begin_anew(board):
    with SerialDevice(board.port, timeout=PATIENT) as device:
        for _ in range(60):
            device.write(4 * BAR, 2 * BAR)
            time.sleep(0.01)
        while device.state == State.DIRECT:  # for 0.4 s: `info`
            device.read()  # asking does not count
        time.sleep(0.5)
        falling = device.read()
        assert 0 < falling.P[0] < 3.9 * BAR
        assert falling.P[0] / falling.P[1] == pytest.approx(2, rel=0.15)
        with pytest.raises(DeviceLost, match="safe state"):
            device.write(1 * BAR, 1 * BAR)
    with SerialDevice(board.port, timeout=PATIENT) as again:
        again.write(1 * BAR, 1 * BAR)
        assert again.state == State.DIRECT


def test_a_vented_board_takes_no_command(device):
    device.write(1 * BAR, 1 * BAR)
    device.vent()
    device.vent()
    assert device.state == State.VENTED
    with pytest.raises(DeviceLost, match="safe state"):
        device.write(1 * BAR, 1 * BAR)
    assert device.read().P[0] < 5 * BAR  # it can still be asked


def test_a_pressure_that_is_no_number_is_refused_in_a_sentence(device):
    for P in (None, "1e5", 1j, 10**400):
        with pytest.raises(InvalidInput, match="is not a number or an array of real numbers"):
            device.write(1 * BAR, P)
    assert device.state == State.READY


@pytest.mark.parametrize("P", [-1.0, 5.001 * BAR, np.nan, np.inf])
def test_a_pressure_beyond_the_limits_is_refused_in_a_sentence(device, P):
    device.read()
    with pytest.raises(InvalidInput, match=r"P2 = .* Pa has to lie within the 0 to 500000 Pa of the board"):
        device.write(1 * BAR, P)
    assert device.state == State.READY  # it never came to the board


def test_the_board_itself_refuses_what_is_beyond_its_limits(device):
    device.info = device.info._replace(high=1e9)
    with pytest.raises(NoAnswer, match="beyond its limits"):
        device.write(1 * BAR, 6 * BAR)
    assert device.state == State.READY


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"joints": 0}, "0 joints and 6 muscles"),
        ({"joints": 12}, "12 joints and 6 muscles"),
        ({"low": np.nan}, "commands from nan to 500000 Pa"),
        ({"high": 0.0}, "commands from 0 to 0 Pa"),
        ({"watchdog": 0.0}, "a watchdog of 0 s"),
        ({"room": 9}, "a controller with samples of 0 s"),
    ],
)
def test_a_board_that_describes_itself_wrongly_is_refused(changed, words):
    info, device = BoardInfo(2, 6, 0, 0, 0.0, 0.0, 5 * BAR, 0.2, 1 * BAR), SerialDevice("COM3")
    device._check(info, VERSION)
    with pytest.raises(DeviceError, match=f"describes itself with {words}"):
        device._check(info._replace(**changed), VERSION)
    with pytest.raises(DeviceError, match="version 3 of the protocol"):
        device._check(info, 3)


def test_noise_on_the_line_costs_nothing_that_comes_after_it(board, device):
    rng = np.random.default_rng(0)
    with open(board.port, "wb", buffering=0) as other:
        for _ in range(50):
            other.write(noise(rng, int(rng.integers(1, 100))))
            device.read()
    assert device.unanswered == 0
    assert device.damaged_there > 20


def test_another_host_takes_the_board_over_and_the_first_is_told(board, device):
    device.write(1 * BAR, 1 * BAR)
    with SerialDevice(board.port, timeout=PATIENT), pytest.raises(DeviceLost, match="no such session"):
        device.write(1 * BAR, 1 * BAR)


def test_a_weight_that_hangs_on_the_simulated_joint_turns_it(own_board):
    def angle(device):
        for _ in range(200):
            device.write(2 * BAR, 2 * BAR)
        return device.read().theta

    with SerialDevice(own_board.port, timeout=PATIENT) as device:
        free = angle(device)
        assert own_board.hang(2.0)
        assert angle(device) < free - 5 * DEG
        assert own_board.hang(0.0)
        assert angle(device) == pytest.approx(free, abs=1 * DEG)


def test_what_is_unplugged_is_lost(own_board):
    with SerialDevice(own_board.port, timeout=PATIENT) as device:
        device.read()
        own_board.stop()
        for exchange in (device.read, lambda: device.write(0.0, 0.0), device.vent):
            with pytest.raises(DeviceLost, match="is gone"):
                exchange()
    with pytest.raises(DeviceError, match="cannot be opened"), device:
        pass


def test_an_answer_that_comes_late_is_not_taken_for_the_next(own_board):
    with SerialDevice(own_board.port, timeout=0.02) as device:
        device.timeout = PATIENT
        device.write(2 * BAR, 1 * BAR)
        device.timeout = 0.02
        os.kill(own_board.pid, signal.SIGSTOP)
        for _ in range(3):
            with pytest.raises(NoAnswer, match="did not answer within 20 ms"):
                device.read()
        os.kill(own_board.pid, signal.SIGCONT)
        device.timeout = PATIENT
        before = time.monotonic()
        assert device.read().t >= before
        assert (device.unanswered, device.late) == (3, 3)


def test_what_is_no_board_is_said_to_be_none(tmp_path):
    with (
        pytest.raises(DeviceError, match=r"nowhere cannot be opened \(No such file or directory\)"),
        SerialDevice(str(tmp_path / "nowhere")),
    ):
        pass
    master, slave = os.openpty()
    silent = SerialDevice(os.ttyname(slave), connect=0.2)
    with pytest.raises(DeviceError, match=r"answered within 0.2 s as a board"), silent:
        pass
    os.close(master)
    os.close(slave)


def test_without_pyserial_the_line_to_install_it_is_named(monkeypatch):
    monkeypatch.delitem(sys.modules, "serial", raising=False)
    ours = [finder for finder in sys.meta_path if isinstance(finder, errors._NameMissing)]
    monkeypatch.setattr(sys, "meta_path", ours)
    with pytest.raises(MissingPackage, match=r"pip install 'antagonist\[serial\]'"), SerialDevice("/dev/null"):
        pass


def test_a_device_that_is_not_connected_is_lost_and_one_without_a_controller_follows_nothing(device):
    with pytest.raises(DeviceLost, match="not connected"):
        SerialDevice(device.port).read()
    with pytest.raises(InvalidInput, match="no controller"):
        device.follow(0, [0.1], [5.0])


def test_an_address_names_port_and_baud():
    assert (open_serial("/dev/ttyUSB0").port, open_serial("/dev/ttyUSB0").baud) == ("/dev/ttyUSB0", 115200)
    there = open_serial("socket://host:7000@921600")
    assert (there.port, there.baud) == ("socket://host:7000", 921600)
    for wrong in ("", "@9600", "/dev/ttyUSB0@fast"):
        with pytest.raises(InvalidInput, match="serial:PORT@BAUD"):
            open_serial(wrong)


@pytest.mark.slow
def test_a_controller_on_the_board_tracks_a_corrected_motion_as_the_same_one_here_does():
    process = RealPlant.standard()
    controller = TrackingMPC(process.nominal, N=5, weights=Weights.calm(), compensation=process.known())
    wanted = sine(K=5.5, duration=3.2, ramp=1.0).resampled(controller.dt)
    owner = Owner.of(process.nominal, controller.compensation)
    reference = Correction(wanted, 0.1 * wanted.theta, owner).reference
    last, errors, statuses = reference.t.size - 1, [], set()
    with (
        SimulatedBoard(process, controller, step=controller.dt, x0=process.at_rest(0.0, 5.5), flags=("-O0",)) as board,
        SerialDevice(board.port, timeout=PATIENT) as device,
    ):
        assert device.info[:5] == (1, 2, controller.ahead, controller.ahead + 33, controller.dt)
        with pytest.raises(NoAnswer, match="left out"):
            device.follow(5, reference.theta[:1], reference.K[:1])
        with pytest.raises(InvalidInput, match="at most 16 samples"):
            device.follow(0, reference.theta[:17], reference.K[:17])
        for now in device.track(reference):
            statuses |= {now.status}
            if now.sample > 60:
                errors.append(now.reading.theta - reference.theta[now.sample])
        device.write(2 * BAR, 2 * BAR)  # and it takes commands again
        assert device.state == State.DIRECT
    assert now.sample == last
    assert len(errors) > 240
    assert np.sqrt(np.mean(np.square(errors))) < 1 * DEG
    assert statuses == {0}


@pytest.mark.slow
def test_commands_that_wait_in_the_line_come_after_the_sample_before_them():
    """Such are repeated ones, after an answer that came too late for the host."""
    controller, found = TrackingMPC(Plant(), N=4, compiled=False), []
    with (
        SimulatedBoard(RealPlant(), controller, step=controller.dt, flags=("-O0",)) as board,
        SerialDevice(board.port, timeout=PATIENT) as device,
    ):
        begun = device.follow(0, np.zeros(16), np.full(16, 6.0))
        numbers = range(device._sequence + 1, device._sequence + 4)
        for number in numbers:
            request = Frame(Kind.FOLLOW, device._session, number, (begun.next,), ())
            device._send(encoded(request, device.sizes))
        until = time.monotonic() + 10 * PATIENT
        while len(found) < len(numbers) and time.monotonic() < until:
            found += device._receiver.frames(device._arrived())
    assert [int(frame.number("sample")) for frame in found] == [begun.sample + 1 + k for k in range(len(numbers))]


@pytest.fixture(scope="module")
def arm_board():
    real = RealArm(ARM, encoder=1e-4)
    with SimulatedBoard(real, safety=Safety(watchdog=0.4, fall=2 * BAR), step=0.01, flags=("-O1",)) as running:
        yield running


def test_a_board_of_an_arm_has_its_encoders_and_its_valves(arm_board):
    P = np.linspace(1, 3, ARM.m) * BAR
    experiment = RealArm(ARM, encoder=1e-4).begin(0.01, arm_at_rest(ARM)[0], 0)
    with SerialDevice(arm_board.port, timeout=PATIENT) as device:
        assert (device.info.joints, device.info.muscles) == (ARM.n, ARM.m) == device.sizes
        assert device._line.write_timeout == PATIENT  # a pause of this process within a write is no end of the line
        for _ in range(100):
            device.write(*P)
            experiment.advance(P.astype(np.float32))
        reading = device.read()
        np.testing.assert_allclose(reading.theta / DEG, experiment.x[: ARM.n] / DEG, atol=0.05)
        np.testing.assert_allclose(reading.P, experiment.x[2 * ARM.n :], rtol=1e-3)
        with pytest.raises(InvalidInput, match="write: 2 pressures for the 6 of the board"):
            device.write(1 * BAR, 1 * BAR)
        with pytest.raises(InvalidInput, match="P6 = 600000 Pa"):
            device.write(*P[:5], 6 * BAR)
        device.vent()
        assert device.state == State.VENTED


def test_weights_on_a_simulated_arm_are_one_a_joint(arm_board):
    with SerialDevice(arm_board.port, timeout=PATIENT) as device:
        with pytest.raises(InvalidInput, match="one number a joint, 2"):
            arm_board.hang(1.0)
        before = after = device.read().theta
        assert arm_board.hang([1.0, 0.0])
        for _ in range(100):
            device.write(*(2 * BAR,) * ARM.m)
            after = device.read().theta
        assert arm_board.hang([0.0, 0.0])
    assert after[0] < before[0] - 2 * DEG


WRONG_SAMPLES = (  # of a board with two joints
    (0, [[0.0, 0.0]], [[[5.0, 6.0], [6.0, 5.0]]], "K is not positive definite"),
    (0, [[0.0, 0.0]], [[[5.0, 1.0], [2.0, 5.0]]], "K is not symmetric"),
    (0, [[0.0, 0.0]], [5e39 * np.eye(2)], "K has to be at most"),
    (0, 0.1, 5.0, "are no samples for the n = 2 joints"),
    (0, [], [1.0], "are no samples for the n = 2 joints"),
    (0, [[20.0, 0.0]], [np.eye(2)], "degrees"),
    (-1, [[0.0, 0.0]], [np.eye(2)], "first = -1 has to be a whole number"),
    (2**32, [[0.0, 0.0]], [np.eye(2)], "first = 4294967296 is over"),
    (0, np.zeros((13, 2)), np.tile(np.eye(2), (13, 1, 1)), "at most 12 samples"),
)


@pytest.mark.slow
def test_a_controller_on_the_board_of_an_arm_moves_it_as_the_same_one_here_does():
    real, controller = RealArm(ARM, encoder=1e-4), TrackingMPC(ARM, N=4, compiled=False)
    reference = circle(ARM, turns=1).resampled(controller.dt)
    x0 = real.at_rest(reference.theta[0], reference.K[0])
    observer = KalmanObserver(ARM, controller.dt, compiled=False)
    run = simulate(real, controller, reference, x0=x0, observer=observer)
    with (
        SimulatedBoard(real, controller, step=controller.dt, x0=x0, flags=("-O0",)) as board,
        SerialDevice(board.port, timeout=PATIENT) as device,
    ):
        with pytest.raises(InvalidInput, match=r"shapes \(3,\) and \(3,\) are no samples for the n = 2 joints"):
            device.follow(0, [0.1, 0.2, 0.3], [5.0, 5.0, 5.0])
        with pytest.raises(NoAnswer, match="beyond its limits"):
            device._follow(0, np.array([[0.1, 0.2, 5.0, 6.0, 5.0]]))  # which holds no posture
        for first, theta, K, match in WRONG_SAMPLES:
            with pytest.raises(InvalidInput, match=match):
                device.follow(first, theta, K)
        falling = replace(reference, K=reference.K * np.linspace(1, -1, reference.t.size)[:, None, None])
        with pytest.raises(InvalidInput, match="K is not positive definite"):
            next(device.track(falling))
        assert device.state == State.READY
        states = [now for now in device.track(reference) if now.sample < run.t.size]
    assert states[-1].sample == run.t.size - 1
    there = np.array([now.reading.theta for now in states])
    sent = np.array([now.u for now in states if now.sample])
    assert {now.status for now in states} == {0}
    assert np.abs(there - run.x[[now.sample for now in states], : ARM.n]).max() < 0.1 * DEG
    assert np.abs(sent - run.u[[now.sample - 1 for now in states if now.sample]]).max() < 0.2 * BAR


def test_a_good_board_is_found_good_and_bad_ones_bad(board):
    found = examine(lambda: SerialDevice(board.port, timeout=PATIENT), exchanges=50)
    assert found.faults == []
    assert found.read.size == found.write.size == 50
    assert abs(found.clock) < 0.05
    deaf = SimulatedBoard(RealPlant(), safety=Safety(watchdog=0.05), flags=("-O0",))
    whole = deaf.files["serial/board.c"]
    deaf.files["serial/board.c"] = whole.replace("    watch(b);", "    (void)watch;")
    assert deaf.files["serial/board.c"] != whole
    with deaf:
        found = examine(lambda: SerialDevice(deaf.port, timeout=PATIENT), exchanges=5)
    assert len(found.faults) == 2
    assert "took a command after its host had been silent" in found.faults[0]


def test_the_command_examines_a_board(board):
    done = CliRunner().invoke(app, ["bench-check", f"serial:{board.port}", "--exchanges", "20", "--timeout", "1"])
    assert done.exit_code == 0, done.output
    assert "of 40 requests 0 were not answered" in done.output
    assert "watchdog after 0.4 s of silence: acted" in done.output
    refused = CliRunner().invoke(app, ["bench-check", "ttyUSB0"])
    assert isinstance(refused.exception, InvalidInput)


def test_compensation_of_the_joint_reaches_the_board_s_controller():
    controller = TrackingMPC(Plant(), N=3, compensation=Compensation(dead_time=0.02))
    files = SimulatedBoard(None, controller).files
    assert "#define ANT_ROOM 38u" in files["serial/config.h"]
    assert "#define ANT_AHEAD 5" in files["antagonist_config.h"]
