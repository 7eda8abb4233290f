"""Whatever ends the process, the last command is the safe one and the log is whole."""

import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from mpc.bench.cycle import Phase
from mpc.bench.logs import read_log

from ...rigs.needs import posix

pty = pytest.importorskip("pty")

pytestmark = [
    pytest.mark.slow,
    posix,
]
LONG = 120  # [s], on a busy machine


def driven(directory, hang="no"):
    command = [sys.executable, str(Path(__file__).with_name("driven.py")), str(directory), hang]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.fixture(scope="module", autouse=True)
def given_up(tmp_path_factory):
    """A process whose device hangs in every call, and its directory: it gives up while the other tests run."""
    directory = tmp_path_factory.mktemp("given_up")
    with driven(directory, "device") as process:
        yield process, directory
        process.kill()


def commands(directory):
    path = directory / "commands"
    return path.read_text().splitlines() if path.exists() else []


def wait_for(directory, n):
    end = time.monotonic() + LONG
    while len(commands(directory)) < n:
        assert time.monotonic() < end
        time.sleep(0.02)


def check_log(directory):
    """Every command that was sent is in the log, but for those that say vent, and one that was on its way."""
    logged = read_log(directory / "log.csv")
    sent = [tuple(map(float, line.split())) for line in commands(directory) if line != "vent"]
    n = logged["t"].size
    assert len(sent) - 1 <= n <= len(sent)
    np.testing.assert_array_equal(np.stack([logged["P1_command"], logged["P2_command"]], 1), sent[:n])
    return logged


@pytest.mark.parametrize(
    ("number", "code", "word"),
    [
        (signal.SIGINT, 130, "interrupted"),
        (signal.SIGTSTP, 130, "interrupted"),
        (signal.SIGTERM, 143, "terminated"),
        (signal.SIGHUP, 143, "terminated"),
    ],
)
def test_a_signal_leads_to_a_ramp_and_a_vent(tmp_path, number, code, word):
    process = driven(tmp_path)
    wait_for(tmp_path, 60)
    process.send_signal(number)
    out, err = process.communicate(timeout=LONG)
    assert (process.returncode, err) == (code, "")
    assert word in out
    assert commands(tmp_path)[-1] == "vent"
    logged = check_log(tmp_path)
    falling = logged["P1_command"][logged["phase"] == Phase.STOP]
    assert falling.size > 2
    assert (np.diff(falling) < 0).all()
    assert falling[-1] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("numbers", "at"), [((signal.SIGINT, signal.SIGTERM), 1), ((signal.SIGHUP, signal.SIGINT), 60)]
)
def test_a_second_signal_in_any_phase_leaves_no_pressure(tmp_path, numbers, at):
    process = driven(tmp_path)
    wait_for(tmp_path, at)
    for number in numbers:  # the second one may find the process at its end already, and kill it
        process.send_signal(number)
    process.communicate(timeout=LONG)
    assert commands(tmp_path)[-1] == "vent"
    check_log(tmp_path)


@pytest.mark.parametrize("at", [1, 60])
def test_a_quit_vents_at_once(tmp_path, at):
    process = driven(tmp_path)
    wait_for(tmp_path, at)
    process.send_signal(signal.SIGQUIT)
    _, err = process.communicate(timeout=LONG)
    assert (process.returncode, err) == (143, "")
    assert commands(tmp_path)[-1] == "vent"
    assert (check_log(tmp_path)["phase"] == Phase.STOP).sum() == 0


def test_signals_that_never_stop_do_not_stop_the_vent(tmp_path):
    process = driven(tmp_path)
    wait_for(tmp_path, 60)
    while process.poll() is None:
        process.send_signal(signal.SIGINT)
        time.sleep(0.002)
    process.communicate(timeout=LONG)
    assert "vent" in commands(tmp_path)[-1]


def test_a_loop_in_another_thread_ends_safely_with_its_process(tmp_path):
    process = driven(tmp_path, "thread")
    _, err = process.communicate(timeout=LONG)
    assert (process.returncode, err) == (0, "")
    assert commands(tmp_path)[-1] == "vent"
    logged = check_log(tmp_path)
    assert logged["phase"][-1] == Phase.STOP


def test_a_terminal_that_closes_is_no_failure_of_the_program(tmp_path):
    """The shell's window is closed during a run: exit code 143, the log whole, its last remark the safe stop's."""
    log = tmp_path / "run.csv"
    child, terminal = pty.fork()
    if child == 0:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)  # the tests may run under nohup
        program = "from mpc.__main__ import main; main()"
        arguments = ["run", "min-jerk", "--device", "sim", "--controller", "pid", "--out", str(log)]
        os.execv(sys.executable, [sys.executable, "-c", program, *arguments])
    end = time.monotonic() + LONG
    while not (log.exists() and log.read_text().count("\n") > 50):
        assert time.monotonic() < end
        if select.select([terminal], [], [], 0.05)[0]:
            os.read(terminal, 65536)
    os.close(terminal)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 143
    assert log.read_text().splitlines()[-1] == "# ended: terminated; ramp: done"


def test_a_process_that_is_killed_outright_leaves_a_whole_log(tmp_path):
    process = driven(tmp_path)
    wait_for(tmp_path, 60)
    process.kill()
    process.communicate(timeout=LONG)
    assert check_log(tmp_path)["t"].size >= 59


def test_a_call_that_hangs_is_interrupted_and_the_pressures_fall(tmp_path):
    process = driven(tmp_path, "call")
    out, err = process.communicate(timeout=LONG)
    assert (process.returncode, err) == (4, "")
    assert "no progress: a call hung for 0.5 s" in out
    assert commands(tmp_path)[-1] == "vent"
    check_log(tmp_path)


def test_a_call_that_cannot_be_interrupted_is_left_and_the_process_ends(tmp_path):
    process = driven(tmp_path, "stubborn")
    _, err = process.communicate(timeout=LONG)
    assert process.returncode == 4
    assert "a call hangs; it was vented" in err
    assert commands(tmp_path)[-1] == "vent"
    check_log(tmp_path)
    last = (tmp_path / "log.csv").read_text().splitlines()[-1]
    assert last == "# ended: no progress: read() hangs; it was vented"


def test_a_device_whose_every_call_hangs_is_given_up_and_said_to(given_up):
    process, directory = given_up
    out, err = process.communicate(timeout=LONG)
    assert process.returncode == 4
    assert "False" in out or "could not be vented" in err
    check_log(directory)
