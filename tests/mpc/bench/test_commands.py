"""`antagonist devices`, `run` and `sweep` as a person meets them."""

import io
import json
import os
import re
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from allocator import BAR
from mpc import RealPlant
from mpc.bench.device import DeviceLost
from mpc.bench.devices.simulated import SimulatedDevice
from mpc.bench.logs import read_log
from mpc.bench.loop import Tracking
from mpc.bench.rows import Row
from mpc.bench.shell import dashboard
from mpc.bench.shell.options import BenchOptions
from mpc.cli import app
from mpc.model.arm.model import Arm
from mpc.plant_cli import PlantOptions
from mpc.trials.files import load_recording

ARM = "--machine", "arm26", "--device", "sim"
SIM = "--device", "sim", "--fast", "--quiet", "--controller", "pid"


def antagonist(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


@pytest.fixture
def trajectory(tmp_path):
    t = np.linspace(0, 1, 51)
    path = tmp_path / "short.csv"
    rows = np.column_stack([t, 5 * np.sin(np.pi * t) ** 2, np.full(t.size, 5.6)])
    np.savetxt(path, rows, delimiter=",", header="t,theta_deg,stiffness", comments="")
    return path


def test_devices_are_listed():
    result = antagonist("devices")
    assert result.exit_code == 0
    assert all(name in result.output for name in ("sim", "modbus", "serial"))


def test_a_rehearsal_tells_the_controller_the_hysteresis_of_the_file_and_what_is_assumed(tmp_path, trajectory):
    path = tmp_path / "plant.toml"
    assert antagonist("init", path).exit_code == 0
    lines = "weights = [0.1, 0.4, 0.5]", "thresholds = [0.03, 0.05]", "base = 1.0"
    path.write_text("\n".join([path.read_text(), "[hysteresis]", *lines, ""]))
    result = antagonist("run", trajectory, *SIM, "--machine", path, "--out", tmp_path / "run.csv")
    assert result.exit_code == 0, result.output
    output = " ".join(result.output.split())
    assert "hysteresis of the angle with 2 elements" in output
    assert "Dahl" not in output
    assert (
        "not in --machine, simulated as on a usual bench and told to the controller: dead time 0.03 s, "
        "flow up to 5 bar/s, dead band" in output
    )


def test_an_option_of_the_simulated_joint_changes_that_number_alone():
    """Any option replaced the muscles as well."""
    usual, same, slower = (
        BenchOptions(device="sim", fast=True).opened(PlantOptions(slew=slew)).plant for slew in (None, 5.0, 4.0)
    )
    assert usual == same == RealPlant.standard().nominal
    assert slower == replace(usual, slew=4 * BAR)


@pytest.mark.compiles
def test_a_simulated_file_without_its_machine_is_said_to_be_unknown_to_the_controller(tmp_path, trajectory):
    path = tmp_path / "plant.toml"
    assert antagonist("init", path).exit_code == 0
    unknown = f"the controller's model is the default joint, not {path}: give --machine {path} as well"
    for machine, said in (((), True), (("--machine", path), False)):
        result = antagonist("run", trajectory, "--device", f"sim:{path}", "--fast", "--quiet", *machine)
        assert (unknown in result.output) is said


@pytest.mark.slow
def test_a_run_writes_what_is_asked_for_and_cleans_up(tmp_path, trajectory):
    out = tmp_path / "run.npz"
    result = antagonist("run", trajectory, *SIM, "--settle", 0.2, "--out", out)
    assert result.exit_code == 0, result.output
    assert "ended: finished" in result.output
    assert re.search(r"angle error \[°\] +│ 0\.\d+", result.output)
    assert re.search(r"isobaric stiffness error \[%\] +│ [\d.]+", result.output)
    assert load_recording(out).t.size > 100
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run.npz", "short.csv"]


@pytest.mark.slow
@pytest.mark.parametrize("ending", [str.lower, str.upper])
def test_a_log_as_csv_is_the_log_and_endings_may_be_capital(tmp_path, trajectory, ending):
    out, *others = (tmp_path / ending(f"run.{kind}") for kind in ("csv", "npz", "png"))
    outs = [word for path in (out, *others) for word in ("--out", path)]
    result = antagonist("run", trajectory, *SIM, *outs)
    assert result.exit_code == 0, result.output
    assert read_log(out)["t"].size > 100
    assert load_recording(others[0]).t.size > 100
    assert {path.name for path in tmp_path.iterdir()} == {"short.csv", out.name, *(path.name for path in others)}


@pytest.mark.slow
@pytest.mark.compiles
def test_an_arm_runs_its_circle_on_a_simulated_device(tmp_path):
    """From the command line, with the device of the arm's file, its log, its recording and its picture."""
    files = tmp_path / "arm.toml", tmp_path / "run.csv", tmp_path / "run.npz", tmp_path / "run.png"
    assert antagonist("init", files[0], "--machine", "arm26").exit_code == 0
    outs = [word for path in files[1:] for word in ("--out", path)]
    device = "--device", f"sim:{files[0]}", "--present", "0:0:0:0:0:0"
    result = antagonist("run", "--machine", files[0], *device, "--fast", "--quiet", *outs)
    assert result.exit_code == 0, result.output
    said = dict(re.findall(r"error, (shoulder|elbow|K\d\d) \S+ +│ ([\d.]+)", result.output))
    assert list(said) == ["shoulder", "elbow", "K11", "K12", "K22"]
    assert max(map(float, said.values())) < 0.2  # [°], [N·m/rad]
    assert re.search(r"trajectory: angle .*°, entries of K .* N·m/rad, ", " ".join(result.output.split()))
    run, log = load_recording(files[2]), read_log(files[1])
    np.testing.assert_array_equal(run.u[:, 5], log["P6_command"][np.isin(log["phase"], (1, 2))][:-1])
    assert files[3].stat().st_size > 10_000


def test_a_reference_out_of_reach_is_said_before_anything_moves(trajectory):
    stiff = trajectory.with_name("stiff.csv")
    stiff.write_text("t,theta_deg,stiffness\n0,0,56\n0.5,0,56\n")
    words = "100 % of the reference is out of reach; `antagonist map` shows the reachable targets"
    told = " ".join(antagonist("run", stiff, *SIM).output.split())
    assert 0 < told.find(words) < told.find("ended: finished")
    assert "out of reach" not in antagonist("run", trajectory, *SIM).output


@pytest.mark.parametrize(
    ("machine", "there", "here"), [("arm26", "1 joint with 2", "2 joints with 6"), (None, "2", "1")]
)
def test_a_simulated_file_of_another_machine_is_refused(tmp_path, machine, there, here):
    file, of_file = tmp_path / "machine.toml", () if machine else ("--machine", "arm26")
    assert antagonist("init", file, *of_file).exit_code == 0
    given = ("--machine", machine) if machine else ()
    said = str(antagonist("run", "--device", f"sim:{file}", *given, "--fast", "--quiet").exception)
    assert f"--device sim:{file} has {there}" in said
    assert f"and --machine {here}" in said
    assert said.endswith(f"give --machine {file}")


@pytest.mark.slow
def test_an_arm_learns_a_motion_on_a_device_and_plays_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given = *ARM, "--fast", "--quiet", "--dt", "0.02", "--horizon", "8"
    result = antagonist("run", "reach", *given, "--repeat", "2")
    assert result.exit_code == 0, result.output
    assert "learned:" in result.output
    assert sorted(path.name for path in tmp_path.iterdir()) == ["reach.correction.png", "reach.correction.toml"]
    played = antagonist("run", *given, "--from", "reach.correction.toml")
    assert played.exit_code == 0, played.output
    other = antagonist("run", "--machine", "arm48", *given[2:], "--from", "reach.correction.toml")
    assert "was learned on another joint" in str(other.exception)


def test_one_joint_is_what_a_sweep_and_a_measurement_take(tmp_path):
    for command in (("sweep", "--out", tmp_path / "sweep"), ("measure", "--out", tmp_path / "measured.png")):
        result = antagonist(*command, *ARM, "--fast")
        assert "this command takes one joint with two muscles; --machine arm26 is a machine" in str(result.exception)


def test_what_cannot_be_written_after_a_run_is_refused_before_it(tmp_path):
    model, out = tmp_path / "arm.xml", tmp_path / "run.npz"
    model.write_text("""<mujoco><worldbody><site name="a" pos="-.3 .05 0"/><site name="b" pos="-.3 -.05 0"/>
<body><joint name="elbow" axis="0 0 1" range="-45 45"/><geom type="capsule" fromto="0 0 0 .2 0 0" size=".01"/>
<site name="c" pos=".05 .05 0"/><site name="d" pos=".05 -.05 0"/></body></worldbody><tendon>
<spatial name="flexor"><site site="a"/><site site="c"/></spatial>
<spatial name="extensor"><site site="b"/><site site="d"/></spatial></tendon></mujoco>""")
    given = "run", "--machine", model, "--rest-length", "300", "--device", "sim", "--fast", "--quiet", "--out", out
    result = antagonist(*given)
    assert "run.npz: an arm from a MuJoCo model cannot be written to a file; keep" in str(result.exception)
    assert "trajectory" not in result.output
    assert [path.name for path in tmp_path.iterdir()] == ["arm.xml"]


def test_a_loop_that_ended_itself_says_so_and_leaves_its_log(tmp_path, trajectory, monkeypatch):
    write, calls = SimulatedDevice.write, iter(range(10**9))

    def write_or_fail(self, *P):
        if next(calls) > 50:
            raise DeviceLost("unplugged")
        write(self, *P)

    monkeypatch.setattr(SimulatedDevice, "write", write_or_fail)
    result = antagonist("run", trajectory, *SIM, "--out", tmp_path / "run.npz")
    assert result.exit_code == 4
    assert "ended: device lost: unplugged" in result.output
    assert "which the device did not take" in result.output
    assert read_log(tmp_path / "run.partial.csv")["t"].size > 20


@pytest.mark.slow
def test_a_run_that_finished_tells_of_a_sensor_that_fell_silent(tmp_path, trajectory, monkeypatch):
    read, calls = SimulatedDevice.read, iter(range(10**9))

    def read_without_pressures(self):
        reading = read(self)
        return reading if next(calls) < 450 else reading._replace(P=(np.nan, np.nan))

    monkeypatch.setattr(SimulatedDevice, "read", read_without_pressures)
    result = antagonist("run", trajectory, *SIM[:-1], "lqr")
    assert result.exit_code == 0, result.output
    assert "health at the end: silent sensor (P1) since" in result.output


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--device", "teapot"), "unknown device 'teapot'"),
        (("--device", "modbus:localhost:502", "--fast"), "--fast is for --device sim"),
        (("--device", "sim", "--stop", "explode"), "--stop explode: choose one of hold, ramp, vent"),
        (("--device", "sim", "--overrun", "panic"), "--overrun panic: choose one of skip, catch-up, stop"),
        (("--device", "sim", "--out", "run.xls"), "the ending has to be one of .png"),
        (("--device", "sim", "--present", "0"), "--present 0: expected LOW:HIGH"),
        (("--device", "sim:missing.toml"), "missing.toml"),
        (("--device", "sim", "--start-rate", "0"), "--start-rate 0: expected"),
        (("--device", "sim", "--settle", "-1"), "settle = -1"),
        (("--device", "sim", "--controller", "bang-bang"), "unknown controller 'bang-bang'"),
        (("--device", "sim", "--hand", "tip"), "--stiffness-of and --hand go with a --machine of several joints"),
        ((*ARM, "--controller", "pid"), "--controller is for one joint"),
        ((*ARM, "--stiffness", "7"), "--stiffness is for one joint"),
        ((*ARM, "--present", "0:0"), "--present 0:0: expected 6 numbers with colons between them"),
        ((*ARM,), "unknown reference 'min-jerk'"),
    ],
)
def test_wrong_input_is_one_sentence(arguments, said):
    result = antagonist("run", "min-jerk", *arguments)
    assert result.exit_code != 0
    assert said in str(result.exception) + result.output


@pytest.mark.slow
@pytest.mark.parametrize(
    ("error", "code"),
    [
        (OSError(5, "Input/output error"), 4),
        (ValueError("no number"), 4),
        (DeviceLost("unplugged"), 4),
        (SystemExit("the driver left"), 4),
        (KeyboardInterrupt(), 130),
    ],
)
def test_an_exception_of_a_device_is_its_end_and_not_a_failure_of_the_program(
    tmp_path, trajectory, monkeypatch, error, code
):
    read, calls = SimulatedDevice.read, iter(range(10**9))

    def read_or_fail(self):
        if next(calls) > 50:
            raise error
        return read(self)

    monkeypatch.setattr(SimulatedDevice, "read", read_or_fail)
    result = antagonist("run", trajectory, *SIM, "--out", tmp_path / "run.csv")
    assert result.exit_code == code
    assert "pressures: " in result.output
    assert str(error) in result.output
    assert (tmp_path / "run.csv").read_text().splitlines()[-1].startswith("# ended: ")


def test_an_error_of_the_program_is_reported_with_what_became_of_the_pressures(tmp_path, trajectory, monkeypatch):
    def fail(*_):
        raise ZeroDivisionError("in the controller")

    monkeypatch.setattr(Tracking, "decide", fail)
    result = antagonist("run", trajectory, *SIM)
    assert isinstance(result.exception, ZeroDivisionError)
    assert "ended: an error in the program: ZeroDivisionError: in the controller" in result.output
    assert "pressures: ramp" in result.output


def test_a_sweep_tells_only_of_files_that_it_has_written(tmp_path, monkeypatch):
    """An older joint_log.csv is not this sweep's, which ended before its first visit."""
    (tmp_path / "joint_log.csv").write_text("older")
    read, calls = SimulatedDevice.read, iter(range(10**9))

    def read_or_fail(self):
        if next(calls) > 50:
            raise DeviceLost("unplugged")
        return read(self)

    monkeypatch.setattr(SimulatedDevice, "read", read_or_fail)
    result = antagonist("sweep", "--device", "sim", "--fast", "--quiet", "--force", "--out", tmp_path)
    assert result.exit_code == 4, result.output
    assert (tmp_path / "joint_log.csv").read_text() == "older"
    written = result.output.partition("written: ")[2]
    assert "sweep.csv" in written
    assert "joint_log.csv" not in written


def test_a_seed_below_zero_is_one_sentence(tmp_path):
    result = antagonist("sweep", "--device", "sim", "--fast", "--out", tmp_path, "--seed", "-1")
    assert "--seed = -1 has to be a whole number, 0 or more" in str(result.exception)


def test_a_sweep_does_not_write_over_older_ones(tmp_path):
    (tmp_path / "joint_log.csv").write_text("mine")
    result = antagonist("sweep", "--device", "sim", "--fast", "--out", tmp_path)
    assert "joint_log.csv exists" in str(result.exception)


# --- the dashboard -------------------------------------------------------------------------------------------------


STATE = {
    "t": 1.0, "phase": 2, "joints": ["angle"], "theta": [0.1], "theta_ref": [0.2], "K": [7.4], "K_ref": [7.5],
    "unit": "N·m/rad", "muscles": ["muscle 1", "muscle 2"], "P": [1e5, float("nan")], "u": [2e5, 3e5],
    "highest": 5e5, "late": 0.0012, "took": 0.001, "missed": 0, "health": "leak (muscle 1)",
}  # fmt: skip


STATE_OF_ARM = {
    "joints": ["shoulder", "elbow"], "theta": [0.1, 0.2], "theta_ref": [0.0, -0.1], "K": [3.0, 0.5, 2.0],
    "K_ref": [3.0, 0.5, 2.0], "unit": "N/m", "muscles": ["biceps", "brachialis", "triceps"], "P": [1e5, 2e5, 3e5],
    "u": [3e5, 2e5, 1e5],
}  # fmt: skip


def test_a_dashboard_without_a_terminal_prints_a_line_a_second(capsys):
    dashboard.main([json.dumps(STATE | {"t": 0.1 * k}) for k in range(25)])
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3
    assert all(
        text in lines[0] for text in ("tracking", "5.73°", "K 7.40", "1.00 nan bar", "late 1.20 ms", "leak (muscle 1)")
    )


def test_a_dashboard_of_an_arm_names_its_joints_and_muscles(monkeypatch, capsys):
    dashboard.main([json.dumps(STATE | STATE_OF_ARM)])
    (line,) = capsys.readouterr().out.splitlines()
    assert "θ 5.73 11.46° of 0.00 -5.73°  K 3.00 0.50 2.00 N/m  P 1.00 2.00 3.00 bar, commanded 3.00 2.00 1.00" in line
    picture = io.StringIO()
    Console(file=picture, width=100).print(dashboard._picture(STATE | STATE_OF_ARM))
    assert all(name in picture.getvalue() for name in ("shoulder", "elbow", "P3 (triceps)", "3 0.5 2 N/m", "-5.73°"))


def test_the_state_of_a_row_has_a_number_for_each_joint_and_muscle(monkeypatch):
    arm, sent = Arm.machine("arm26"), []
    shown = dashboard.Dashboard(arm)
    shown._pipe = 0
    monkeypatch.setattr(os, "write", lambda pipe, data: sent.append(json.loads(data)))
    P = tuple(1e5 * j for j in range(6))
    shown(Row(0.0, np.array([0.1, 0.2]), P, P, 2, 0, 0.0, 0.0, K_ref=np.eye(2)))
    assert (sent[0]["theta"], sent[0]["P"], sent[0]["K_ref"]) == ([0.1, 0.2], list(P), [1.0, 0.0, 1.0])
    assert np.isnan(sent[0]["theta_ref"]).tolist() == [True, True]
    assert (sent[0]["joints"], sent[0]["muscles"][5]) == (["shoulder", "elbow"], "biarticular extensor")


def test_a_dashboard_on_a_terminal_draws_bars(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    shown = Terminal()
    monkeypatch.setattr("sys.stdout", shown)
    dashboard.main([json.dumps(STATE)])
    assert "█" in shown.getvalue()
    assert "leak (muscle 1)" in shown.getvalue()


@pytest.mark.parametrize(("value", "full"), [(0.0, 0), (2.5e5, 12), (5e5, 24), (9e5, 24), (float("nan"), 0)])
def test_a_bar_is_as_long_as_its_value(value, full):
    assert dashboard.bar(value, 5e5) == "█" * full + "·" * (24 - full)


@pytest.mark.slow
def test_a_dashboard_is_a_process_of_its_own_and_its_death_is_no_harm(bench):
    with dashboard.Dashboard(bench.plant) as shown:
        shown._process.kill()
        shown._process.wait()
        record = bench.loop(watch=shown).run()
    assert str(record.ending) == "finished"
