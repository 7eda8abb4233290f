"""The encoder's zero of a joint's file: subtracted from a device's readings, added again by readers of its logs."""

import numpy as np
import pytest
from typer.testing import CliRunner

from allocator import DEG
from allocator.identification import read_joint_log, read_motion_log
from mpc import Plant
from mpc.bench.device import SimulatedClock
from mpc.bench.devices.simulated import open_simulated
from mpc.bench.logs import read_log
from mpc.bench.measuring.log import read_log_of_motion
from mpc.cli import app

ZERO = 8 * DEG
FAST = "--fast", "--quiet"


def antagonist(*arguments):
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    assert result.exit_code == 0, result.output + str(result.exception)
    return result


@pytest.fixture
def joint(tmp_path):
    """A joint's file whose fit has found that the encoder reads 8° at the zero of the joint."""
    path = tmp_path / "joint.toml"
    Plant().save(path)
    path.write_text(f"{path.read_text()}\n[source]\nencoder_zero_deg = {ZERO / DEG}\n")
    return path


@pytest.mark.slow
def test_a_run_and_its_log_are_in_angles_of_the_joint_and_fits_get_the_readings(joint, tmp_path):
    with open_simulated(str(joint), SimulatedClock()) as device:
        assert device.read().theta == pytest.approx(ZERO, abs=0.5 * DEG)
    trajectory, out = tmp_path / "sine.csv", tmp_path / "run.csv"
    t = np.linspace(0, 24, 241)
    rows = np.column_stack([t, 5 + 8 * np.sin(2 * np.pi * t / 4), np.full(t.size, 5.6)])
    np.savetxt(trajectory, rows, delimiter=",", header="t,theta_deg,stiffness", comments="")
    driven = "--device", f"sim:{joint}", "--controller", "pid"
    antagonist("run", trajectory, *driven, "--machine", joint, *FAST, "--settle", 1, "--out", out)
    log = read_log(out)
    last = log["phase"] == 2
    assert log["theta"][last].mean() == pytest.approx(5 * DEG, abs=1 * DEG)
    assert out.read_text().splitlines()[1] == f"# encoder zero {ZERO!r} rad (8°), subtracted from theta"
    read = read_motion_log(out)
    assert read.theta.mean() == pytest.approx(log["theta"].mean() + ZERO, abs=0.1 * DEG)
    assert any("its zero, 8°, was added to theta again" in note for note in read.notes)
    assert read_log_of_motion(out, zero=ZERO).theta[-50:] == pytest.approx(log["theta"][-50:])


def test_logs_of_a_sweep_name_the_zero_too(joint, tmp_path):
    program = "--motion", 30, "--no-weights", "--out", tmp_path
    antagonist("sweep", "--device", f"sim:{joint}", "--machine", joint, *FAST, *program)
    for name, read in (("joint_log.csv", read_joint_log), ("motion_log.csv", read_motion_log)):
        path = tmp_path / name
        written = np.loadtxt(path, delimiter=",", skiprows=2, usecols=0 if "joint" in name else 1)
        assert f"encoder zero {ZERO!r} rad" in path.read_text()
        theta = read(path).theta
        assert theta.mean() == pytest.approx(written.mean() + ZERO, abs=0.2 * DEG)


@pytest.mark.slow
def test_an_exported_controller_asks_its_caller_to_subtract_the_zero(joint, tmp_path):
    errors = "--errors", "theta=0.1,rate=0.3"
    result = antagonist("export", "controller", "--machine", joint, "--out", tmp_path / "c", *errors)
    assert "the encoder reads 8° at 0 of the joint: subtract it" in result.output
