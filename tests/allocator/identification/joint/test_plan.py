"""A plan names the further measurement that tells most, and its table is read back by the fit."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from allocator.cli import app
from allocator.identification.joint.planning import information
from allocator.identification.joint.planning import plan as planning
from allocator.identification.joint.planning.plan import plan_joint_experiment
from allocator.identification.joint.reading import read_joint_log
from allocator.joint.antagonist import report_joint
from allocator.joint.gravity import NO_GRAVITY
from allocator.joint.limits import COMMON_FORCE
from allocator.machine_file import load_joint
from allocator.muscles import scaled
from allocator.muscles.catalogue import MARTENS_DMSP_20_300, SAROSI_DMSP_20_400N
from allocator.units import BAR, DEG
from benchmarks.identification.joint_plan import FRICTION, kept

KINDS = {"a sag test", "a second weight", "a push with shut valves"}


def run(*arguments):
    return CliRunner().invoke(app, ["plan-joint", *map(str, arguments)])


@pytest.mark.parametrize("name", ["sarosi-pulley", "martens-lever"])
def test_only_letting_the_cables_go_slack_shows_a_force_common_to_both_muscles(all_twins, name):
    plan = plan_joint_experiment(all_twins[name])
    assert {s.name for s in plan.further} == KINDS
    best, *others = plan.further
    assert best.name == "a sag test"
    assert best.forces < 0.1
    assert all(other.forces == pytest.approx(1.0, abs=0.02) for other in others)
    assert best.name in str(plan)


def test_a_joint_whose_forces_its_fit_has_seen_gains_more_by_something_else(all_twins):
    joint = all_twins["sarosi-pulley"]
    fitted = replace(joint, covariance=tuple(map(tuple, np.zeros((12, 12)))))
    assert plan_joint_experiment(fitted).further[0].name != "a sag test"
    assert plan_joint_experiment(replace(fitted, unseen=(COMMON_FORCE,))).further[0].name == "a sag test"


def test_a_second_weight_tells_the_stiffness_better_than_none(all_twins):
    plan = plan_joint_experiment(all_twins["sarosi-lever"])
    second = next(s for s in plan.further if s.name == "a second weight")
    assert second.weight == 2 * plan.weight
    assert second.stiffness < plan.accuracy


def test_at_the_pressures_of_the_sag_test_no_muscle_pulls(all_twins):
    joint = all_twins["martens-pulley"]
    points = plan_joint_experiment(joint).further[0].sag
    assert len(points) == 5
    for p in points:
        assert p.slack == 3
        assert joint.forces(p.theta, p.P1, p.P2) == pytest.approx((0.0, 0.0), abs=1e-6)


def test_the_rows_of_the_sag_test_are_how_its_pressures_move_with_the_unknowns(all_twins):
    """Against roots found again with every unknown moved."""
    joint = all_twins["sarosi-lever"]
    problem, x, _ = planning._candidates(joint, NO_GRAVITY, np.array([2.0, 3.0]) * BAR, 0.5)
    known = information.Known(problem, x, np.eye(x.size), np.zeros((1, x.size)), 0.5, DEG)
    points, rows = information._sag_test(joint, known)
    slack = np.array([[p.P1 for p in points], [p.P2 for p in points]]).ravel()
    for i in range(len(problem.free)):
        step = 1e-5 * x[i]
        moved, _ = information._sag_test(joint, known._replace(x=x + step * (np.arange(x.size) == i)))
        change = np.array([[p.P1 for p in moved], [p.P2 for p in moved]]).ravel() - slack
        np.testing.assert_allclose(rows[:, i] * information._SLACK_NOISE, change / step, rtol=2e-3)


def test_the_command_writes_a_table_that_fit_joint_reads_once_it_is_filled_in(tmp_path):
    path = tmp_path / "plan.csv"
    options = ["--muscle", "sarosi-dmsp-20-400n", "--stops", "-50:50"]
    result = run(*options, "--weight", 1.1, "--out", path)
    assert result.exit_code == 0, result.output
    assert "a sag test" in result.output
    values = json.loads(run(*options, "--weight", 1.1, "--json").stdout)
    header, *rows = path.read_text(encoding="utf-8").splitlines()
    with pytest.raises(ValueError, match="line 2"):
        read_joint_log(path)  # nothing was measured yet
    filled = [header]
    for row in rows:
        theta, P1, P2, *rest, expected = row.split(",")
        filled.append(",".join([theta or expected.split()[0], P1 or "1.5", P2 or "1.4", *rest, expected]))
    path.write_text("\n".join(filled), encoding="utf-8")
    log = read_joint_log(path)
    setpoints = values["setpoints"]
    visits = 2 * len(setpoints)
    assert log.theta[:visits:2] / DEG == pytest.approx([s["theta_falling_deg"] for s in setpoints], abs=0.06)
    assert log.P1[1:visits:2] / BAR == pytest.approx([s["pressure1_bar"] for s in setpoints], rel=1e-3)
    assert log.torque[:visits:2] == pytest.approx([s["torque_Nm"] for s in setpoints], rel=1e-3)
    assert log.direction[:visits].tolist() == [-1, 1] * len(setpoints)
    assert len(log.theta) == visits + len(values["further"][0]["sag_test"])


@pytest.mark.slow
def test_the_filled_table_is_fitted_as_it_is_and_shows_where_cables_go_slack(tmp_path):
    """Filled in with what the planned joint does: its stiffness and its slack pressures come back."""
    plan, joint = tmp_path / "plan.csv", tmp_path / "joint.toml"
    described = ["--muscle", "sarosi-dmsp-20-400n", "--stops", "-50:50", "--friction", 0.05]
    assert run(*described, "--accuracy", 2, "--out", plan).exit_code == 0
    header, *rows = plan.read_text(encoding="utf-8").splitlines()
    filled = [header]
    for row in rows:
        theta, P1, P2, *rest, expected = row.split(",")
        found = expected.replace(" and ", " ").split()
        slack = {found[i]: found[i + 2] for i, word in enumerate(found) if word in ("P1", "P2")}
        filled.append(",".join([theta or found[0], P1 or slack["P1"], P2 or slack["P2"], *rest, expected]))
    plan.write_text("\n".join(filled), encoding="utf-8")
    fitted = ["fit-joint", str(plan), "--pulley", "20,0.1375", "--rest-length", "400", "--out", str(joint)]
    result = CliRunner().invoke(app, fitted)
    assert result.exit_code == 0, result.output
    found, true = (
        load_joint(joint),
        replace(report_joint(), agonist=SAROSI_DMSP_20_400N, antagonist=SAROSI_DMSP_20_400N),
    )
    assert not found.slack_assumed
    P = np.array([2.0, 3.0, 4.0]) * BAR
    assert found.stiffness(0.0, P, P) == pytest.approx(true.stiffness(0.0, P, P), rel=0.05)
    assert np.array(found.forces(0.0, P, P)) == pytest.approx(np.array(true.forces(0.0, P, P)), rel=0.1)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--accuracy", 0), "--accuracy"),
        (("--noise", -1), "--noise"),
        (("--weight", "nan"), "positive torques"),
        (("--weight", -1), "positive torques"),
        (("--weight", 1e6), "more than the joint holds"),
        (("--lowest", 9), "--lowest"),
        (("--setpoints", 1), "setpoints = 1 has to be a whole number, 2 or more"),
        (("--out", "plan.png"), "the ending has to be .csv"),
    ],
)
def test_wrong_input_is_one_sentence(arguments, sentence):
    result = run(*arguments)
    assert result.exit_code != 0
    assert sentence in str(result.exception)


def test_a_plan_promises_no_more_than_a_wrong_law_leaves(all_twins):
    """A force law wrong by some per cent cannot be measured away: the promise is far above what noise leaves."""
    joint = replace(all_twins["sarosi-pulley"], angle_limits=(-100 * DEG, 100 * DEG))
    few, many = (plan_joint_experiment(joint, accuracy=a) for a in (0.05, 0.01))
    assert many.accuracy < few.accuracy
    for plan in (few, many):
        assert 0.03 < plan.expected < 0.3
        assert plan.expected > 2 * plan.accuracy
        assert f"known to about {plan.expected:.0%}" in str(plan).splitlines()[0]


def test_a_plan_has_more_setpoints_than_unknowns_unless_the_user_wants_fewer(all_twins):
    joint = all_twins["sarosi-pulley"]
    usual, few = plan_joint_experiment(joint), plan_joint_experiment(joint, setpoints=10)
    assert usual.unknowns == len(joint.agonist.parameters) + 3  # ratio of strengths, zero of the encoder, friction
    assert len(usual.setpoints) >= 3 * usual.unknowns
    assert len(few.setpoints) == 10
    assert "10 setpoints for the 9 unknowns of the fit are few" in str(few)
    assert few.expected > usual.expected
    assert json.loads(run("--setpoints", 7, "--json").stdout)["setpoints"][6:]


@pytest.mark.parametrize("name", ["sarosi-pulley", "sarosi-lever"])
def test_setpoints_survive_on_a_joint_that_is_not_the_one_guessed(all_twins, truth_of, name):
    """Another law, muscles of unequal strength and more than twice the friction: few setpoints end at a stop."""
    guess = replace(all_twins[name], friction=0.05)
    plan = plan_joint_experiment(guess)
    strength = SAROSI_DMSP_20_400N.force(3 * BAR, 0.1) / MARTENS_DMSP_20_300.force(3 * BAR, 0.1)
    muscle = scaled(MARTENS_DMSP_20_300, float(strength))
    joint = replace(guess, agonist=muscle, antagonist=scaled(muscle, 1.1), friction=FRICTION)
    T, P1, P2 = (np.repeat([getattr(s, part) for s in plan.setpoints], 2) for part in ("torque", "P1", "P2"))
    way = np.tile([-1.0, 1.0], len(plan.setpoints))
    assert np.isfinite(truth_of(joint, P1, P2, T, way)).mean() > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1001, 1004])
def test_muscles_of_another_law_are_fitted_and_err_by_no_more_than_twice_the_promise(seed):
    """On foreign muscles with friction as measured: `benchmarks.identification.joint_plan` counts how often."""
    found = kept(seed)
    assert np.sqrt(np.mean(found.error**2)) < 2 * found.expected
