"""`antagonist fit-joint` as a person meets it."""

from dataclasses import replace
from functools import partial

import matplotlib as mpl
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from allocator import AntagonistJoint, Table, allocate
from allocator.identification.joint.cli import _better_laws, fit_joint_command
from allocator.identification.joint.doubt.covariance import Choice
from allocator.identification.joint.fit import fit_joint
from allocator.identification.joint.reading import read_joint_log
from allocator.machine_file import load_joint, save_machine
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR, DEG

mpl.use("Agg")
app = typer.Typer(pretty_exceptions_enable=False)
app.command("fit-joint")(fit_joint_command)


def run(*arguments):
    return CliRunner().invoke(app, [*map(str, arguments)])


@pytest.fixture(scope="module")
def table(all_twins, log_maker, tmp_path_factory):
    """A file of equilibria of the Martens pulley, with weights."""
    log = log_maker(all_twins["martens-pulley"], 3)
    columns = (log.theta / DEG, log.P1 / BAR, log.P2 / BAR, log.torque, log.direction)
    path = tmp_path_factory.mktemp("table") / "log.csv"
    header = "theta_deg,pressure1_bar,pressure2_bar,torque_Nm,direction"
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="", fmt="%.8g")
    return path


PULLEY = "--pulley", "20,0.11", "--rest-length", 300, "--model"


@pytest.fixture(scope="module")
def fitted(table):
    """The output of a fit to it, and the files of the joint and of its picture."""
    joint, picture = table.parent / "joint.toml", table.parent / "joint.png"
    result = run(table, *PULLEY, "MartensBoblan2017", "--out", joint, "--plot", picture)
    assert result.exit_code == 0, result.output
    return result.output, joint, picture


@pytest.mark.slow
def test_a_log_becomes_a_joint_that_allocates(fitted, all_twins):
    output, joint, picture = fitted
    assert "stiffness: known to" in output
    assert picture.read_bytes().startswith(b"\x89PNG")
    answer = allocate(0.2, 4.5, joint=load_joint(joint))
    true = all_twins["martens-pulley"].stiffness(0.2, answer.P1, answer.P2)
    assert answer.K == pytest.approx(true, rel=0.08)


@pytest.mark.slow
def test_the_mechanism_may_come_from_the_file_of_a_joint(table, tmp_path):
    """Pulleys of 25 and 18 mm are a Table."""
    theta = np.linspace(-1.0, 1.0, 21)
    pulleys, made = Table(0.3, theta, 0.11 + 0.025 / 0.3 * theta, 0.11 - 0.018 / 0.3 * theta), tmp_path / "made.toml"
    save_machine(AntagonistJoint(pulleys, SAROSI_DMSP_20_400N, SAROSI_DMSP_20_400N), made)
    with made.open("a", encoding="utf-8") as file:
        file.write("\n[plant]\ngravity_torque = 1.6\ninertia = 0.02\n")
    result = run(table, "--machine", made, "--gravity", "0", "--out", tmp_path / "joint.toml")
    assert result.exit_code == 0, result.output
    joint, content = load_joint(tmp_path / "joint.toml"), (tmp_path / "joint.toml").read_text()
    assert joint.geometry == pulleys
    assert "inertia = 0.02" in content
    assert "gravity_torque" not in content  # --gravity 0 leaves it in the muscles
    assert joint.pressure_limits == (0.0, 5 * BAR)  # as the file says, whatever was read
    assert "limits are those of the rests: its angles" in " ".join(result.output.split())


@pytest.mark.slow
def test_several_files_make_one_joint_and_each_is_left_out_in_turn(table, fitted, tmp_path):
    header, *rows = table.read_text().splitlines()
    one, two, both = (tmp_path / name for name in ("one.csv", "two.csv", "both.toml"))
    one.write_text("\n".join([header, *rows[::2]]))
    two.write_text("\n".join([header, *rows[1::2]]))
    result = run(one, two, *PULLEY, "MartensBoblan2017", "--stops=-20:20", "--supply", "5", "--out", both)
    assert result.exit_code == 0, result.output
    assert "extrapolated" not in result.output  # the rests go further
    assert f"group one.csv: {len(rows[::2])} samples" in result.output
    angles, P = np.linspace(-0.3, 0.3, 5), (2.5 * BAR, 2.5 * BAR)
    joints = [load_joint(path) for path in (both, fitted[1])]
    np.testing.assert_allclose(joints[0].stiffness(angles, *P), joints[1].stiffness(angles, *P), rtol=1e-3)


@pytest.mark.slow
def test_without_a_weight_it_says_that_stiffness_is_relative(table, tmp_path):
    rows = [row for row in table.read_text().splitlines() if row.split(",")[3] in ("torque_Nm", "0")]
    unloaded = tmp_path / "unloaded.csv"
    unloaded.write_text("\n".join(rows))
    result = run(unloaded, *PULLEY, "AffinePolynomial")
    assert result.exit_code == 0, result.output
    assert "relative only" in result.output
    assert "all forces times one factor" in result.output


@pytest.mark.slow
def test_several_rest_lengths_in_one_file(all_twins, log_maker, tmp_path):
    log = log_maker(all_twins["sarosi-pulley"], 0)
    path = tmp_path / "log.csv"
    lines = ["theta_rad;pressure1_kpa;pressure2_kpa;sweep;rest_length_mm"]
    for theta, P1, P2, way in zip(log.theta, log.P1, log.P2, log.direction, strict=True):
        lines += [f"{theta};{P1 / 1e3};{P2 / 1e3};{1 if way < 0 else 2};{mm}" for mm in (400, 401)]
    path.write_text("\n".join(lines))
    result = run(path, "--pulley", "20,0.1375", "--model", "AffinePolynomial", "--sweep", "1=-1", "--sweep", "2=1")
    assert result.exit_code == 0, result.output
    assert "groups left out in turn" in result.output


def test_steady_samples_are_picked_from_a_raw_log(tmp_path):
    """Three setpoints of 3 s with ramps of 2 s between, at 20 Hz: each rest gives one equilibrium."""
    t = np.arange(0, 13, 0.05)
    ramp = np.interp(t, [0, 3, 5, 8, 10, 13], [0, 0, 1, 1, 0.3, 0.3])
    path = tmp_path / "raw.csv"
    columns = np.column_stack([t, 20 * ramp, 2 + 2 * ramp, 3 + 0 * t])
    np.savetxt(path, columns, delimiter=",", header="time_s,theta_deg,pressure1_bar,pressure2_bar", comments="")
    log = read_joint_log(path)
    assert log.theta == pytest.approx(np.array([0, 20, 6]) * DEG, abs=0.1 * DEG)
    assert log.P1 == pytest.approx(np.array([2, 4, 2.6]) * BAR, rel=1e-2)
    assert log.direction.tolist() == [0, 1, -1]
    assert log.dropped_share == pytest.approx(1 - 3 * 21 / t.size, abs=0.01)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--rest-length", 300), "--lever R,r,offset [mm] or --pulley"),
        (("--pulley", "20,0.11"), "give the rest length once"),
        (("--pulley", "20,0.11", "--machine", "joint.toml"), "give the mechanism once"),
        (("--machine", "joint.toml", "--rest-length", 300), "joint.toml has the rest length"),
        (("--pulley", "20", "--rest-length", 300), "expected 2 (R,ε0) numbers"),
        (("--lever", "a,b", "--rest-length", 300), "expected 2 (R,r) or 3 (R,r,offset) numbers"),
        (("--lever", "0.25,0.03", "--rest-length", 300), "--lever 0.25: expected 1 to 10000 mm"),
        (("--pulley", "0.02,0.11", "--rest-length", 300), "--pulley 0.02: expected 1 to 10000 mm"),
        (("--pulley", "20,0.11", "--rest-length", 300, "--sweep", "1"), "expected NUMBER=DIRECTION"),
        (("--pulley", "20,0.11", "--rest-length", 300, "--sweep", "up=1"), "expected NUMBER=DIRECTION"),
        (("--pulley", "20,0.11", "--rest-length", 300, "--group", "3"), "pass --out as well"),
    ],
)
def test_what_is_missing_on_the_command_line_is_said(table, arguments, sentence):
    assert sentence in str(run(table, *arguments).exception)


def test_a_missing_column_is_named(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("theta_deg,pressure1_bar\n1,2\n")
    with pytest.raises(ValueError, match="no column for the pressure2"):
        read_joint_log(path)


@pytest.mark.slow
def test_only_laws_that_fit_better_when_they_are_tried_are_suggested(all_twins, log_maker):
    joint = all_twins["martens-pulley"]
    measured, options = log_maker(joint, 3).fit_arguments()
    fitted = partial(fit_joint, *measured, **options | {"geometry": joint.geometry})
    fit = fitted(model="ChouHannaford1996")
    better = _better_laws(fit, fitted)
    assert "MartensBoblan2017" in better
    promised = Choice("TonduLopez2000", "law", 0.0, 1.0, 0.0, 0.0, 0.0)
    fit = replace(fit, doubt=replace(fit.doubt, choices=(*fit.doubt.choices, promised)))
    assert _better_laws(fit, fitted) == better  # with this law itself the angles are no better
