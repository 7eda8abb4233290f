"""`antagonist fit-motion` as a person meets it."""

import json

import matplotlib as mpl
import numpy as np
import pytest
from typer.testing import CliRunner

from allocator.machine_file import load_joint, save_machine
from allocator.units import BAR, DEG
from mpc import Compensation, KalmanObserver, Plant
from mpc.cli import app
from mpc.model.friction.maxwell_slip import MaxwellSlip

from ...rigs.moving_joint import DEAD_TIME, JOINT, LAG

mpl.use("Agg")


def run(*arguments):
    return CliRunner().invoke(app, ["fit-motion", *map(str, arguments)])


def export(machine, out):
    errors = "--errors", "theta=0.1,rate=0.3"  # without them robust weights are searched for, which takes seconds
    return CliRunner().invoke(app, ["export", "controller", "--machine", str(machine), "--out", str(out), *errors])


def write(path, header, log, rows=None):
    table = np.column_stack([log.t, log.theta / DEG, log.P1 / BAR, log.P2 / BAR])[:rows]
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.6g")
    return path


@pytest.fixture(scope="module")
def identified(slow_joint, tmp_path_factory):
    """The directory of a plant.toml and a fit.png that the command made of a log, and what it printed."""
    made = tmp_path_factory.mktemp("identified")
    log = write(made / "log.csv", "t,phi [deg],p1 [bar],P2_bar", slow_joint, 1500)
    save_machine(JOINT, made / "joint.toml")
    out, picture = made / "plant.toml", made / "fit.png"
    result = run(log, "--machine", made / "joint.toml", "--out", out, "--plot", picture, "--json")
    assert result.exit_code == 0, result.output
    return made, json.loads(result.stdout)


@pytest.mark.slow
def test_a_log_becomes_a_plant_a_picture_and_json(identified):
    made, said = identified
    assert said["lag_up_s_low"] < said["lag_up_s"] < said["lag_up_s_high"]
    assert said["held_out_deg"] < 1.5
    assert said["plant_rms_last_40_percent_deg"] < 1.02 * said["plant_held_out_deg"]  # the same rows, fitted or not
    assert said["plant_rms_deg"] < 0.3
    assert said["plant_held_out_deg"] < 0.3
    assert 0.9 < said["band_coverage"] < 0.99
    assert len(said["hysteresis"]["weights"]) == len(said["hysteresis"]["thresholds_deg"]) + 1
    assert (made / "fit.png").read_bytes().startswith(b"\x89PNG")
    assert load_joint(made / "plant.toml").hysteresis is not None
    text = (made / "plant.toml").read_text(encoding="utf-8")
    assert "[regulators]" in text
    assert "[plant]" in text


@pytest.mark.slow
def test_the_plant_of_a_log_is_tracked_and_exported_and_its_effects_are_told_to_controllers(identified, tmp_path):
    path = identified[0] / "plant.toml"
    known, plant = Compensation.load(path), Plant.load(path)
    assert known.friction == MaxwellSlip.of(load_joint(path).hysteresis)
    assert known.dead_time == pytest.approx(DEAD_TIME, abs=0.015)
    assert plant.lags == pytest.approx((LAG, LAG), rel=0.1)
    observer = KalmanObserver(plant, 0.01, compensation=known)
    for _ in range(100):
        x, d = observer.estimate(plant.at_rest(0.0, 6.0), plant.at_rest(0.0, 6.0)[2:])
    np.testing.assert_allclose([*x, d], [*plant.at_rest(0.0, 6.0), 0.0], rtol=0.02, atol=0.02)
    track = ["track", "sine", "--machine", str(path), "--controller", "feedforward", "--out", str(tmp_path / "run.csv")]
    tracked = CliRunner().invoke(app, track)
    assert tracked.exit_code == 0, tracked.output
    assert "known to the controller: Maxwell slip with" in " ".join(tracked.output.split())
    exported = export(path, tmp_path / "c")
    assert exported.exit_code == 0, exported.output
    assert any((tmp_path / "c").rglob("*.c"))


@pytest.mark.slow
def test_without_a_joint_it_says_what_was_found_and_that_there_is_no_plant(slow_joint, tmp_path):
    result = run(write(tmp_path / "log.csv", "t [s],theta [deg],P1 [bar],P2 [bar]", slow_joint, 1500))
    assert result.exit_code == 0, result.output
    for text in (
        "five blocks",
        "95 % band of predicted angles",
        "unit",
        "lag of a rising pressure",
        "hysteresis loop",
        "not seen by this log",
        "there is no plant",
    ):
        assert text in result.output


def test_units_that_are_not_said_are_asked_for_in_one_sentence(slow_joint, tmp_path):
    result = run(write(tmp_path / "log.csv", "t,phi,p1,p2", slow_joint, 300))
    assert result.exit_code != 0
    assert '--columns "theta=phi:deg,pressure1=p1:bar,pressure2=p2:bar"' in str(result.exception)


def test_a_log_that_tells_too_little_is_refused_with_the_experiment_that_would_help(slow_joint, tmp_path):
    result = run(write(tmp_path / "log.csv", "t,phi [deg],p1 [bar],p2 [bar]", slow_joint, 300))
    assert result.exit_code != 0
    assert "300 rows over 5.98 s are too few: record a minute or more of random steps" in str(result.exception)


def test_nothing_is_written_over_and_no_plant_without_a_joint(slow_joint, tmp_path):
    log = write(tmp_path / "log.csv", "t,phi [deg],p1 [bar],p2 [bar]", slow_joint)
    result = run(log, "--out", tmp_path / "plant.toml")
    assert "--out writes a plant with muscles: give its joint with --machine" in str(result.exception)
    (tmp_path / "plant.toml").write_text("mine")
    save_machine(JOINT, tmp_path / "joint.toml")
    result = run(log, "--machine", tmp_path / "joint.toml", "--out", tmp_path / "plant.toml")
    assert "exists; give another name, or --force" in str(result.exception)
    assert (tmp_path / "plant.toml").read_text() == "mine"


@pytest.mark.slow
def test_an_export_names_the_numbers_of_regulators_that_c_does_not_take(tmp_path):
    path = tmp_path / "plant.toml"
    Plant(JOINT).save(path)
    with path.open("a", encoding="utf-8") as file:
        file.write("\n[regulators]\nlag_up = 0.08\nlag_down = 0.14\nflow = 4e5\n")
    exported = export(path, tmp_path / "c")
    assert exported.exit_code == 0, exported.output
    said = " ".join(exported.output.split())
    assert "not known to the controller" in said
    assert "lag 0.08 s of a rising pressure and lag 0.14 s of a falling pressure" in said
    assert "flow up to 4 bar/s" in said
