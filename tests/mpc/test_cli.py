"""`antagonist track` as a person meets it."""

import csv
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from allocator import BAR, DEG, PrandtlIshlinskii
from allocator.joint.antagonist import report_joint
from allocator.joint.limits import COMMON_FORCE
from allocator.machine_file import save_machine
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc import Plant, sine
from mpc.cli import app, main
from mpc.model.arm.storage import load_arm
from mpc.trials.files import load_recording, save_reference
from mpc.trials.motions.trajectories import TRAJECTORIES

pytestmark = pytest.mark.compiles


def antagonist(*arguments, cwd):
    code = "import sys; from mpc.cli import main; sys.argv[0] = 'antagonist'; main()"
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd)


@pytest.fixture
def trajectory(tmp_path):
    path = tmp_path / "short.csv"
    save_reference(sine(duration=2, ramp=1), path)
    return path


def test_show_opens_every_picture_that_is_written(trajectory, tmp_path, monkeypatch):
    opened, names = [], ("run.csv", "run.png", "margins.png")
    monkeypatch.setattr("typer.launch", opened.append)
    table, picture, margins = (tmp_path / name for name in names)
    given = "--controller", "pid", "--plant", "nominal", "--dt", "0.02", "--margins", str(margins), "--show"
    result = CliRunner().invoke(app, ["track", str(trajectory), "--out", str(table), "--out", str(picture), *given])
    assert result.exit_code == 0, result.output
    assert opened == [str(picture), str(margins)]


def test_track_writes_picture_and_table_and_prints_the_figures(trajectory, tmp_path):
    out = tmp_path / "new" / "directory"
    result = CliRunner().invoke(app, ["track", str(trajectory), "--out", str(out), "--dt", "0.02", "--horizon", "12"])
    assert result.exit_code == 0, result.output
    assert (out / "tracking.png").read_bytes().startswith(b"\x89PNG")
    with (out / "tracking.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 101
    error = np.array([float(row["theta_deg"]) - float(row["theta_ref_deg"]) for row in rows])
    printed = re.search(r"angle error \[°\]\D+([\d.e-]+)", result.output).group(1)
    assert float(printed) == pytest.approx(np.sqrt(np.mean(error**2)), rel=0.02, abs=1e-7)
    for text in (
        "stiffness error [%]",
        "pressure slew",
        "kept",
        "slack muscle",
        "time of a step [ms]",
        "answered by QP",
    ):
        assert text in result.output


def test_track_prints_the_errors_after_the_first_rest_as_well(tmp_path):
    path = tmp_path / "run.csv"
    result = CliRunner().invoke(app, ["track", "min-jerk", "--out", str(path), "--controller", "feedforward"])
    assert result.exit_code == 0, result.output
    with path.open() as file:
        rows = list(csv.DictReader(file))
    t, theta, wanted = (np.array([float(row[name]) for row in rows]) for name in ("t", "theta_deg", "theta_ref_deg"))
    later = (theta - wanted)[t >= 4 - 1e-9]
    _, after = result.output.split("after the first rest of 4 s")
    printed = re.search(r"angle error \[°\]\D+([\d.e-]+)\D+([\d.e-]+)", after).groups()
    expected = np.sqrt(np.mean(later**2)), np.abs(later).max()
    assert [float(p) for p in printed] == pytest.approx(expected, rel=0.01)


def test_an_amplitude_is_not_ignored_where_there_is_no_hysteresis(tmp_path):
    command = [
        "track",
        "min-jerk",
        "--out",
        str(tmp_path / "run.csv"),
        "--controller",
        "feedforward",
        "--amplitude",
        "5",
    ]
    printed = CliRunner().invoke(app, [*command, "--plant", "nominal"]).output
    assert "--amplitude: this plant has no hysteresis" in printed
    assert "not known" not in printed
    printed = CliRunner().invoke(app, [*command, "--plant", "real", "--force"]).output
    assert "felt stiffness, with hysteresis: pushes of ±5° meet" in printed
    assert "not known to the controller: muscles 10 % stronger (agonist) and 10 % weaker" in " ".join(printed.split())


@pytest.mark.slow
@pytest.mark.parametrize("plant", ["nominal", "real"])
def test_track_tells_the_controller_what_the_plant_s_file_says_and_simulates_it(plant, tmp_path):
    operator = PrandtlIshlinskii((0.4, 0.2, 0.2, 0.2), (1.5 * DEG, 3.5 * DEG, 7.0 * DEG), base=0.4)
    joint = report_joint(SAROSI_DMSP_20_400N)
    path, silent, move = (tmp_path / name for name in ("plant.toml", "silent.toml", "move.csv"))
    Plant(replace(joint, hysteresis=operator)).save(path)
    with path.open("a", encoding="utf-8") as file:
        file.write("\n[regulators]\ndead_time = 0.04\n")
    Plant(joint).save(silent)
    save_reference(sine(amplitude=15 * DEG, K=5.5, K_amplitude=0.0, duration=3, ramp=1), move)
    runs = {}
    for name in (path, silent):
        out = tmp_path / f"{name.stem}.npz"
        command = ["track", str(move), "--machine", str(name), "--plant", plant, "--out", str(out)]
        result = CliRunner().invoke(app, [*command, "--controller", "predictive-pid"])
        assert result.exit_code == 0, result.output
        told = "known to the controller: hysteresis of the angle with 3 elements, dead time 0.04 s"
        assert (told in " ".join(result.output.split())) is (name is path)
        runs[name] = load_recording(out)
    told, plain = runs[path], runs[silent]
    assert np.abs(told.u - plain.u).max() > 0.05 * BAR  # the controller pulls harder
    error = np.sqrt(np.mean((told.theta - told.theta_ref) ** 2))
    assert error < (0.05 if plant == "nominal" else 2.5) * DEG  # as it should, on the plant that has what it is told


def test_a_standard_trajectory_is_one_word_and_the_run_can_be_read_again(tmp_path):
    files = [tmp_path / name for name in ("run.npz", "run.csv", "run.png")]
    outs = [word for path in files for word in ("--out", str(path))]
    result = CliRunner().invoke(app, ["track", "min-jerk", *outs, "--controller", "feedforward"])
    assert result.exit_code == 0, result.output
    assert sorted(tmp_path.iterdir()) == sorted(files)
    run, table = load_recording(files[0]), np.genfromtxt(files[1], delimiter=",", names=True)
    np.testing.assert_allclose(table["theta_deg"] * DEG, run.theta, atol=1e-9)
    np.testing.assert_allclose(table["P1_bar"] * BAR, run.P[:, 0], rtol=1e-8)
    assert run.theta_ref[0] == pytest.approx(-30 * DEG)
    repeated = tmp_path / "repeated.npz"  # a recording is a trajectory
    again = CliRunner().invoke(app, ["track", str(files[0]), "--out", str(repeated), "--controller", "feedforward"])
    assert again.exit_code == 0, again.output
    np.testing.assert_array_equal(load_recording(repeated).u, run.u)


def test_the_table_says_that_slack_limits_are_assumed_where_the_fit_has_not_seen_them(tmp_path):
    said = []
    for name, unseen in (("seen", ()), ("unseen", (COMMON_FORCE,))):
        save_machine(replace(report_joint(), unseen=unseen), tmp_path / f"{name}.toml")
        options = ["--machine", str(tmp_path / f"{name}.toml"), "--controller", "feedforward"]
        result = CliRunner().invoke(app, ["track", "min-jerk", *options, "--out", str(tmp_path / f"{name}.csv")])
        assert result.exit_code == 0, result.output
        said.append("slack limits" in result.output and "assumed" in result.output)
    assert said == [False, True]


def test_without_a_trajectory_another_joint_moves_about_what_it_has(tmp_path):
    out = tmp_path / "run.npz"
    options = ["--radius", "10", "--rest-length", "180", "--stops=-20:20", "--controller", "feedforward"]
    result = CliRunner().invoke(app, ["track", *options, "--out", str(out)])
    assert result.exit_code == 0, result.output
    run = load_recording(out)
    assert np.abs(run.theta_ref).max() <= 18.001 * DEG
    assert "out of reach" not in result.output
    assert "trajectory: angle -18 … 18°, stiffness " in result.output


def test_the_stiffness_of_a_standard_trajectory_can_be_chosen(tmp_path):
    out = tmp_path / "run.npz"
    options = ["--stiffness", "8.2", "--dt", "0.02", "--controller", "feedforward", "--out", str(out)]
    assert CliRunner().invoke(app, ["track", "steps", *options]).exit_code == 0
    np.testing.assert_allclose(load_recording(out).K_ref, 8.2)


def test_the_help_names_every_standard_trajectory(tmp_path):
    shown = re.sub(r"-\s+", "-", antagonist("track", "--help", cwd=tmp_path).stdout)
    assert all(name in shown for name in TRAJECTORIES)


def tracked(trajectory, *options):
    out = trajectory.parent / "-".join(options)
    result = CliRunner().invoke(app, ["track", str(trajectory), "--out", str(out), *options])
    assert result.exit_code == 0, result.output
    return (out / "tracking.csv").read_text()


@pytest.mark.slow
@pytest.mark.parametrize("controller", ["nmpc", "pid", "lqr", "feedforward"])
def test_every_controller_can_be_tried_on_the_real_plant(trajectory, controller):
    assert tracked(trajectory, "--plant", "real", "--controller", controller).count("\n") == 202


@pytest.mark.slow
def test_the_seed_makes_a_run_on_the_real_plant_repeatable(trajectory):
    first, again, other = (tracked(trajectory, "--plant", "real", "--seed", seed) for seed in ("1", "1", "2"))
    assert first == again
    assert first != other


@pytest.mark.slow
def test_a_payload_is_met_better_with_an_observer(trajectory):
    def left(*options):
        rows = [*csv.DictReader(tracked(trajectory, "--plant", "nominal", "--payload", "1", *options).splitlines())]
        return abs(float(rows[-1]["theta_deg"]) - float(rows[-1]["theta_ref_deg"]))

    assert left("--observer") < 0.2 * left("--no-observer")


@pytest.mark.slow
def test_track_without_a_file_follows_the_default_and_writes_here(tmp_path):
    done = antagonist("track", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["tracking.csv", "tracking.png"]
    assert "steps answered by QP" in done.stdout
    assert "exceeded" not in done.stdout
    assert "not known to the controller: muscles of Wickramatunge2010" in done.stdout
    angle = float(re.search(r"angle error \[°\]\D+([\d.e-]+)", done.stdout).group(1))
    assert 0.2 < angle < 3  # [°] of a plant that the model does not describe


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere.csv"], "nowhere.csv: does not exist"),
        (["bad.csv"], "bad.csv, line 3, column 'theta_deg': 'up' is not a number"),
        (["short.csv", "--solver", "magic"], "unknown QP solver 'magic'; available: "),
        (["short.csv", "--dt", "-1"], "dt = -1 s has to be a sample time"),
        (["short.csv", "--horizon", "1"], "N = 1 has to be"),
        (["min-jork"], "neither a standard trajectory nor a file min-jork; there are sine, min-jerk, "),
        (["sine", "--stiffness", "-3"], "stiffness"),
        (["short.csv", "--stiffness", "7"], "--stiffness goes with a standard trajectory"),
        (["short.csv", "--controller", "nmpc", "--solver", "daqp"], "unknown NLP solver 'daqp'; available: "),
        (["short.csv", "--out", "run.xlsx"], "--out run.xlsx: a run is written as .png, "),
        (["short.csv", "--out", "bad.csv/run.npz"], "bad.csv/run.npz cannot be written"),
        (["short.csv", "--plant", "imaginary"], "unknown plant 'imaginary'; available: nominal, other, real"),
        (["short.csv", "--seed", "-1"], "seed = -1 has to be a whole number, 0 or more"),
        (["short.csv", "--controller", "pid", "--solver", "osqp"], "solver = 'osqp' belongs to the controllers mpc"),
        (["short.csv", "--controller", "fuzzy"], "unknown controller 'fuzzy'; available: "),
        (["short.csv", "--controller", "pid", "--dt", "-1"], "dt = -1 s has to be a sample time"),
    ],
)
def test_bad_input_is_one_sentence_and_no_traceback(trajectory, arguments, said, monkeypatch, capsys):
    (trajectory.parent / "bad.csv").write_text("t,theta_deg,stiffness\n0,0,7\n1,up,7\n")
    monkeypatch.chdir(trajectory.parent)
    monkeypatch.setattr(sys, "argv", ["antagonist", "track", *arguments])
    with pytest.raises(SystemExit) as left:
        main()
    shown = capsys.readouterr()
    assert left.value.code == 2
    assert shown.out == ""
    assert shown.err.startswith("antagonist: ")
    assert said in shown.err
    assert len(shown.err.strip().splitlines()) == 1
    assert not (trajectory.parent / "tracking.csv").exists()


def test_help_is_given_before_anything_heavy_is_loaded(tmp_path):
    code = (
        "import sys, mpc.cli; "
        "print([m for m in ('casadi', 'daqp', 'osqp', 'qpsolvers', 'control', 'matplotlib') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    assert "track" in antagonist("--help", cwd=tmp_path).stdout


def test_track_reckons_with_the_gas_and_says_which_stiffness_is_tracked(trajectory, tmp_path):
    common = ["track", str(trajectory), "--muscle", "sarosi-dmsp-20-400n", "--dt", "0.02", "--horizon", "8"]
    out = ["--out", str(tmp_path / "run.npz"), "--controller", "feedforward", "--force"]
    usual = CliRunner().invoke(app, [*common, *out])
    assert "isobaric stiffness error [%]" in usual.output
    assert "gas with κ = 1.3 in 126 cm³" in " ".join(usual.output.split())
    bare = CliRunner().invoke(app, [*common, *out, "--no-gas"])
    assert "no gas" in bare.output
    assert load_recording(tmp_path / "run.npz").plant.gas is None
    gas = CliRunner().invoke(app, [*common, *out, "--kappa", "1.4", "--frequency", "2"])
    assert gas.exit_code == 0, gas.output
    assert "dynamic stiffness at 2 Hz error [%]" in gas.output
    assert "gas with κ = 1.4" in gas.output
    plant = load_recording(tmp_path / "run.npz").plant
    assert (plant.gas.kappa, plant.frequency) == (1.4, 2.0)
    refused = CliRunner().invoke(app, [*common, *out, "--no-gas", "--frequency", "2"])
    assert refused.exit_code != 0
    assert "--frequency is of the gas" in str(refused.exception)


@pytest.mark.parametrize("machine", [None, "arm26"])
def test_a_plant_is_written_with_gas_or_without(machine, tmp_path):
    load = Plant.load if machine is None else load_arm
    more = [] if machine is None else ["--machine", machine]
    for option, has in (("--gas", True), ("--no-gas", False)):
        made = CliRunner().invoke(app, ["init", str(tmp_path / "plant.toml"), *more, option, "--force"])
        assert made.exit_code == 0, made.output
        assert (load(tmp_path / "plant.toml").gas is not None) == has
    told = CliRunner().invoke(app, ["init", str(tmp_path / "usual.toml"), *more])
    assert told.exit_code == 0
    assert load(tmp_path / "usual.toml").gas is not None


@pytest.mark.parametrize(("option", "said"), [("--gas", True), ("--no-gas", False)])
def test_the_file_of_an_arm_tells_what_it_assumes_of_the_gas(option, said, tmp_path):
    muscle = replace(SAROSI_DMSP_20_400N, inner_radius=None)
    muscle.save(tmp_path / "muscle.toml", source={})
    given = "init", str(tmp_path / "arm.toml"), "--machine", "arm26", "--muscle", str(tmp_path / "muscle.toml"), option
    made = CliRunner().invoke(app, given)
    assert made.exit_code == 0, made.output
    assert ("how much gas the muscles hold: taken as in braids of" in made.output) == said
