"""What equilibria do not tell is the force common to both muscles: it is named, bounded, and seen by a sag test."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from allocator import InvalidInput
from allocator.identification.joint.doubt.common_force import with_free_friction
from allocator.identification.joint.fit import fit_joint
from allocator.identification.joint.problem import JointProblem, PullShare
from allocator.identification.joint.reading import read_joint_log
from allocator.identification.joint.samples import JointSamples, SlackReadings
from allocator.joint.limits import COMMON_FORCE, PRIOR_FORCE
from allocator.machine_file import load_joint
from allocator.units import BAR, DEG
from benchmarks.identification.joint_truth import LABORATORIES, PULLEY, judged, measured, pair

P = 2.5 * BAR
ALONE = {"choices": False, "leave_one_out": False}  # neither changes what is stated


def laboratory(name):
    return next(one for one in LABORATORIES if one.name == name)


@pytest.mark.slow
@pytest.mark.parametrize("one", LABORATORIES, ids=lambda one: one.name)
def test_the_truth_is_inside_what_is_stated_for_stiffness_and_both_forces(one):
    result = judged(one.name, one.joint, **measured(one), **one.options)
    assert result.right == (True, True)
    assert result.fit.common.seen == one.sag
    assert not [warning for warning in result.fit.warnings if "converged" in warning]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["known_weights", "constant_hysteresis", "friction"])
def test_equilibria_of_a_stranger_give_the_stiffness_to_one_percent_and_name_the_force(shared, name):
    log = read_joint_log(shared(Path("data") / "stranger" / f"equilibria_{name}.csv"))
    columns = {key: getattr(log, key) for key in ("theta", "P1", "P2", "torque", "direction")}
    result = judged(name, pair(PULLEY), **columns)
    true, found, _ = result.stiffness
    assert result.right == (True, True)
    assert found == pytest.approx(true, rel=0.01)
    assert result.fit.joint.unseen == (COMMON_FORCE,)
    assert not [warning for warning in result.fit.warnings if "converged" in warning or "zero" in warning]
    if name == "known_weights":
        assert result.fit.rms == pytest.approx(0.05 * DEG, rel=0.02)


@pytest.fixture(scope="module")
def plain():
    """Return a fit to taut equilibria on a pulley with known weights."""
    one = laboratory("pulley, little noise")
    return fit_joint(**measured(one), geometry=PULLEY, **ALONE)


@pytest.mark.slow
def test_what_is_not_seen_is_named_in_the_fit_the_joint_and_the_file(plain, tmp_path):
    assert plain.unseen[0].startswith(f"{COMMON_FORCE}; it is taken from the assumption")
    plain.save(tmp_path / "joint.toml")
    assert load_joint(tmp_path / "joint.toml").unseen == (COMMON_FORCE,)


@pytest.mark.slow
def test_a_force_added_to_both_muscles_moves_no_angle_and_leaves_the_stiffness(plain):
    more = 100.0  # N
    names = np.array(plain.problem.names)
    equal = np.where(np.isin(names, ("log_ratio", "friction")), 0.0, plain.x)  # two equal muscles
    x = equal + more * (names == "c5")
    free = replace(plain.problem, pull=None)
    assert free.angle_error(x) == pytest.approx(free.angle_error(equal), abs=1e-7)
    F, there = plain.forces(0.0, P, P), free.unknowns(x).muscle
    assert there.force(P, PULLEY.initial_contraction) == pytest.approx(F.agonist + more)
    assert F.agonist_interval[0] < F.agonist + more < F.agonist_interval[1]


@pytest.mark.slow
def test_a_prior_supplies_the_force_and_is_reported_as_such():
    one = laboratory("a prior of the type")
    data = measured(one)
    one_weight = data["torque"] != 0
    unloaded = fit_joint(**{name: a[~one_weight] for name, a in data.items()}, geometry=PULLEY, **one.options, **ALONE)
    assert "the prior Sarosi2012" in unloaded.unseen[0]
    fit = fit_joint(**data, geometry=PULLEY, **one.options, **ALONE)
    assert fit.joint.unseen == (PRIOR_FORCE,)
    assert fit.joint.slack_assumed
    assert "the prior Sarosi2012" in fit.unseen[0]
    assert unloaded.joint.unseen == (PRIOR_FORCE,)
    assert fit.forces(0.0, P, P).agonist == pytest.approx(one.joint.forces(0.0, P, P)[0], rel=0.25)


def test_the_equations_of_pull_share_sag_test_and_free_friction_have_exact_derivatives():
    one = laboratory("lever and a sag test")
    data = measured(one)
    slack = data.pop("slack").astype(int)
    every = JointSamples.checked(**data, geometry=one.joint.geometry)
    muscle, extra = one.joint.agonist, ("log_ratio", "zero", "friction")
    bound = np.full(len(muscle.parameters) + len(extra), np.inf)
    problem = JointProblem(muscle, tuple(muscle.parameters), extra, -bound, bound, every.where(slack == 0), 0.02, False)
    sag = SlackReadings.of(every, slack, 0.1 * BAR)
    problem = with_free_friction(replace(problem, pull=PullShare(0.5, 0.3), sag=sag, sag_weight=1e-7))
    x = np.array([*muscle.parameters.values(), -0.2, 0.02, 0.05, 0.01, 0.005])
    J = problem.jacobian(x)
    assert J.shape[0] == 3 * problem.samples.n + 1 + 10
    for i, step in enumerate(1e-5 * np.maximum(np.abs(x), 1e-3)):
        move = step * (np.arange(x.size) == i)
        difference = (problem.residual(x + move) - problem.residual(x - move)) / (2 * step)
        assert J[:, i] == pytest.approx(difference, rel=1e-4, abs=1e-6 * max(np.abs(J[:, i]).max(), 1e-9))


@pytest.mark.parametrize(
    ("slack", "said"),
    [({"slack": 4}, "slack has to be 0"), ({"slack": [0, 1]}, "slack has to be 0"), ({"slack_noise": 0.0}, "above 0")],
)
def test_a_sag_test_that_cannot_be_is_refused_in_a_sentence(slack, said):
    columns = measured(laboratory("pulley, little noise")) | slack
    with pytest.raises(InvalidInput, match=said):
        fit_joint(**columns, geometry=PULLEY)


def test_the_column_of_a_sag_test_is_read_and_checked(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("theta [deg],pressure1 [bar],pressure2 [bar],slack\n10,2,2,0\n5,1.4,1.6,3\n", encoding="utf-8")
    assert read_joint_log(path).slack.tolist() == [0, 3]
    path.write_text("theta [deg],pressure1 [bar],pressure2 [bar],slack\n10,2,2,5\n", encoding="utf-8")
    with pytest.raises(InvalidInput, match="has to be 1"):
        read_joint_log(path)


@pytest.mark.slow
def test_an_encoder_that_would_be_twenty_degrees_off_is_pointed_out():
    one = replace(laboratory("pulley, little noise"), zero=20 * DEG)
    fit = fit_joint(**measured(one), geometry=PULLEY, **ALONE)
    assert fit.zero == pytest.approx(20 * DEG, abs=0.2 * DEG)
    assert any("zero would be off by 20" in warning for warning in fit.warnings)
