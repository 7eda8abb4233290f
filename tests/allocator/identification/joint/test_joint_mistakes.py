"""Data that cannot be right, or cannot tell what is asked: one clear sentence each."""

import re

import numpy as np
import pytest
from typer.testing import CliRunner

from allocator import AntagonistJoint, Lever, Pulley
from allocator.errors import InvalidInput
from allocator.identification.joint import report
from allocator.identification.joint.fit import fit_joint
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR, DEG
from mpc.cli import app


@pytest.fixture(scope="module")
def data(all_twins, log_maker):
    joint = all_twins["martens-pulley"]
    log = log_maker(joint, 3)
    arrays = {name: getattr(log, name) for name in ("theta", "P1", "P2", "torque", "direction")}
    return {**arrays, "geometry": joint.geometry, "model": "MartensBoblan2017"}


def refused(data, sentence, **changes):
    with pytest.raises(ValueError, match=sentence) as error:
        fit_joint(**{**data, **changes})
    assert "\n" not in str(error.value)


def test_one_direction_only(data):
    keep = data["direction"] > 0
    few = {name: data[name][keep] for name in ("theta", "P1", "P2", "torque", "direction")}
    refused(data, "all equilibria were reached with rising θ", **few)


def test_all_points_slack(data):
    refused(data, "no equilibrium is left in which both muscles can be taut", dead_band=6 * BAR)


def test_one_cocontraction(data):
    total = 6 * BAR
    refused(data, "one co-contraction, P1 \\+ P2 = 6 bar", P2=total - data["P1"], theta=data["P1"] / total - 0.5)


def test_a_pressure_that_was_never_changed(data):
    refused(data, "P2 was never changed", P2=np.full_like(data["P1"], 3 * BAR))


def test_a_weight_too_small_to_see(data, all_twins, log_maker):
    log = log_maker(all_twins["martens-pulley"], 3, weight=0.005)
    names = ("theta", "P1", "P2", "torque", "direction")
    refused(data, r"drowns in a scatter of .*; hang about [0-9.]+ N·m", **{name: getattr(log, name) for name in names})


def test_degrees_for_radians(data):
    refused(data, "if degrees were meant", theta=data["theta"] / DEG)


def test_bar_for_pascal(data):
    refused(data, "if bar was meant", P1=data["P1"] / BAR)


def test_swapped_muscles(data):
    refused(data, "the muscles are swapped, or the angle has the other sign", P1=data["P2"], P2=data["P1"])


def test_an_angle_that_both_pressures_raise(data):
    refused(data, "in an antagonistic pair", theta=(data["P1"] + data["P2"]) / (20 * BAR))


def test_a_geometry_that_cannot_reach_the_angles(data):
    refused(data, "cannot be reached with this geometry", geometry=Lever(0.30, 0.60, 0.03, 0.0175))


def test_a_direction_that_is_none(data):
    refused(data, "direction has to be \\+1", direction=2 * data["direction"])


def test_too_few_equilibria(data):
    few = {name: data[name][::12] for name in ("theta", "P1", "P2", "torque", "direction")}
    refused(data, "equilibria cannot determine the .* unknowns", **few)


def test_several_geometries_need_labels(data):
    refused(data, "need group=", geometry={"a": data["geometry"]})


def test_an_unknown_model(data):
    refused(data, "unknown model 'Sarosi'", model="Sarosi")


@pytest.mark.slow
def test_without_directions_the_report_says_where_hysteresis_goes(data):
    still = data["torque"] == 0
    fit = fit_joint(
        **{**data, **{name: data[name][still] for name in ("theta", "P1", "P2")}, "torque": None, "direction": None}
    )
    assert fit.friction == 0
    assert any("no direction of motion" in warning for warning in fit.warnings)


@pytest.mark.slow
def test_swapped_directions_show_as_negative_friction_beyond_its_doubt_and_are_not_written(data, tmp_path):
    fit = fit_joint(**{**data, "direction": -data["direction"]})
    assert any("the directions look swapped" in warning for warning in fit.warnings)
    with pytest.raises(ValueError, match=r"friction μ = -.* is negative, which no joint has"):
        fit.save(tmp_path / "joint.toml")
    assert not (tmp_path / "joint.toml").exists()
    u = fit.problem.unknowns(fit.x)
    found = report.findings(fit.problem, u, [], fit.doubt.covariance, True)
    assert found.std["friction"] == pytest.approx(fit.standard_deviations["friction"])
    doubted = found._replace(std={**found.std, "friction": abs(fit.friction)})
    assert not any("swapped" in said for said in report.warnings(fit.problem, fit.x, u, doubted))


def test_a_weight_with_the_other_sign(data):
    refused(data, r"torque of .* N·m moves the joint by .*° the wrong way: .*; turn its sign", torque=-data["torque"])


def test_a_prior_that_is_no_muscle(data):
    refused(data, "prior = 'sarosi' has to be a muscle", prior="sarosi")


@pytest.fixture(scope="module")
def grid():
    """Equilibria of a known joint, exact, and its sag test at three angles."""
    joint = AntagonistJoint(Pulley(0.3, 0.018, 0.14), SAROSI_DMSP_20_400N, SAROSI_DMSP_20_400N)
    P1, P2, T = (a.ravel() for a in np.meshgrid(*[np.linspace(1.5, 5, 5) * BAR] * 2, [0.0, 0.8]))
    theta = joint.equilibrium(P1, P2, T)
    there = np.isfinite(theta)
    there[there] = np.minimum(*joint.forces(theta[there], P1[there], P2[there])) > 10
    at = np.array([-20.0, 0.0, 20.0]) * DEG
    sag = [side.muscle.pressure(0.0, side.contraction) for side in joint.sides(at)]
    return joint, (theta[there], P1[there], P2[there], T[there]), (at, *sag, 0 * at)


def warnings_of(grid, times=1.0, add=0.0):
    joint, rest, sag = grid
    theta, P1, P2, torque = (np.concatenate(pair) for pair in zip(rest, sag, strict=True))
    slack = np.repeat([0, 3], [rest[0].size, 3])
    P1, P2 = (np.where(slack, P + add, P) for P in (P1, P2))
    options = {"slack": slack, "choices": False, "leave_one_out": False}
    return " ".join(fit_joint(theta, P1, P2, geometry=joint.geometry, torque=times * torque, **options).warnings)


@pytest.mark.slow
def test_a_sag_test_that_contradicts_and_a_torque_in_other_units_are_warned_of(grid):
    right = warnings_of(grid)
    assert "sag test" not in right
    assert "N·m" not in right
    assert "the sag test contradicts the law or the equilibria" in warnings_of(grid, add=2.5 * BAR)
    assert "N/bar, more than any is known to: is the torque in N·m?" in warnings_of(grid, times=100.0)


@pytest.fixture(scope="module")
def still(data):
    return fit_joint(**data, choices=False)


@pytest.mark.parametrize("zero", [-33 * DEG, 16 * DEG, 20 * DEG, 28 * DEG, 32 * DEG])
def test_an_encoder_that_was_not_set_to_zero_is_found(data, still, zero):
    turned = fit_joint(**{**data, "theta": data["theta"] + zero}, choices=False)
    assert turned.zero == pytest.approx(still.zero + zero, abs=0.1 * DEG)
    assert turned.rms < 1.02 * still.rms
    assert still.rms < 1.05 * 0.5 * DEG  # the noise of the log


@pytest.mark.slow
def test_friction_that_looks_partly_constant_by_chance_does_not_spoil_the_fit(all_twins, log_maker):
    joint = all_twins["sarosi-lever"]
    log = log_maker(joint, 3, seed=3)  # a constant part gains 6.5 σ², which chance does in 4 %
    (theta, P1, P2), options = log.fit_arguments()
    fit = fit_joint(theta, P1, P2, **options, geometry=joint.geometry, choices=False)
    assert fit.rms < 1.1 * 0.5 * DEG  # … of the noise
    assert fit.forces(0.0, 3 * BAR, 3 * BAR).agonist == pytest.approx(joint.forces(0.0, 3 * BAR, 3 * BAR)[0], rel=0.05)


@pytest.mark.slow
def test_an_encoder_zero_beyond_the_search_is_not_written(data, tmp_path):
    fit = fit_joint(**{**data, "theta": data["theta"] + 60 * DEG, "model": "Sarosi2012"}, choices=False)
    with pytest.raises(ValueError, match=r"zero would be \+34.4° or more, so nothing was written: subtract"):
        fit.save(tmp_path / "joint.toml")
    assert not (tmp_path / "joint.toml").exists()


def test_rests_on_a_stop_are_left_out_and_counted(data, all_twins, log_maker):
    joint = all_twins["martens-pulley"]
    log = log_maker(joint, 3, noise=0.0)
    beyond = np.abs(log.theta) > 20 * DEG
    noise = 0.05 * DEG * np.random.default_rng(0).standard_normal(beyond.size)
    measured = np.clip(log.theta, -20 * DEG, 20 * DEG) + noise
    fit = fit_joint(measured, *log.fit_arguments()[0][1:], **log.fit_arguments()[1], geometry=joint.geometry)
    at_stops = {why: n for why, n in fit.samples.dropped.items() if "at a stop" in why}
    assert [why.split(" of ")[1] for why in at_stops] == ["20°, whatever the pressures", "-20°, whatever the pressures"]
    assert sum(at_stops.values()) == pytest.approx(beyond.sum(), abs=5)
    assert fit.rms < 0.1 * DEG  # 1° and more with them
    assert fit.friction == pytest.approx(joint.friction, abs=0.01)


def test_too_few_rests_beside_the_stops_are_refused_with_those_left_out(data):
    short = np.clip(data["theta"], -1 * DEG, 1 * DEG)
    refused(data, r"left out were \d+ with an angle at a stop, the greatest one of 1°", theta=short)


@pytest.mark.parametrize(
    ("option", "said"),
    [
        (("--gravity", "heavy"), r"--gravity heavy: expected 1 \(G\) or 2"),
        (("--gravity", "1,2,3"), r"--gravity 1,2,3: expected 1 \(G\) or 2"),
        (("--zero", "400"), "--zero 400"),
        (("--stops", "10:-10"), "--stops -10: expected .* from low to high"),
        (("--supply", "-1"), "--supply -1"),
    ],
)
def test_a_wrong_option_is_refused_before_the_fit(option, said, tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("theta_deg,pressure1_bar,pressure2_bar\n1,2,2\n2,2.5,2\n")
    result = CliRunner().invoke(app, ["fit-joint", str(path), "--pulley", "20,0.12", "--rest-length", "300", *option])
    assert isinstance(result.exception, InvalidInput)
    assert re.search(said, str(result.exception))
