"""Laws of the joint's fit: derivatives, equilibria, scale, indistinguishable models, friction, storage, planning."""

import re
from dataclasses import replace

import numpy as np
import pytest

from allocator import AntagonistJoint, Table, allocate, report_joint
from allocator.identification.joint.fit import fit_joint
from allocator.identification.joint.planning.plan import plan_joint_experiment
from allocator.identification.joint.problem import JointProblem
from allocator.identification.joint.samples import JointSamples
from allocator.identification.joint.search import first_guess, minimise
from allocator.machine_file import load_joint, save_machine
from allocator.muscles import MODELS, scaled
from allocator.muscles.catalogue import MUSCLES, SAROSI_DMSP_20_400N, TONDU_MCKIBBEN
from allocator.units import BAR, DEG
from mpc import Compensation, Plant
from mpc.tracking.feedforward import InverseDynamics
from mpc.tracking.limits import Limits
from mpc.tracking.preview import Preview

SAROSI = tuple(SAROSI_DMSP_20_400N.parameters)


def problem_of(joint, log, conventional):
    samples = JointSamples.checked(
        log.theta, log.P1, log.P2, geometry=joint.geometry, torque=log.torque, direction=log.direction
    )
    extra, free = ("log_ratio", "zero", "friction"), tuple(joint.agonist.parameters)
    bound = np.full(len(free) + len(extra), np.inf)
    return JointProblem(joint.agonist, free, extra, -bound, bound, samples, 0.4, conventional)


@pytest.mark.parametrize("name", ["sarosi-pulley", "sarosi-lever"])
@pytest.mark.parametrize("conventional", [True, False])
def test_the_jacobian_is_the_central_difference_of_the_residuals(all_twins, log_maker, name, conventional):
    joint = all_twins[name]
    problem = problem_of(joint, log_maker(joint, 3), conventional)
    x = np.array([*joint.agonist.parameters.values(), 0.05, 0.01, 0.12])
    J = problem.jacobian(x)
    assert (problem.residual(x)[problem.samples.n :] > 0).sum() > 5  # tautness at 40 % is active somewhere
    for i, step in enumerate(1e-5 * np.maximum(np.abs(x), 1e-2)):
        move = np.zeros(x.size)
        move[i] = step
        difference = (problem.residual(x + move) - problem.residual(x - move)) / (2 * step)
        assert J[:, i] == pytest.approx(difference, rel=1e-4, abs=1e-5 * np.abs(J[:, i]).max())


def test_all_equilibria_at_once_are_those_of_root_finding(all_twins, log_maker, truth_of):
    for joint in all_twins.values():
        log = log_maker(joint, 3)
        problem = problem_of(joint, log, conventional=False)
        x = np.array([*joint.agonist.parameters.values(), 0.0, 0.0, joint.friction])
        theta, reached = problem.equilibrium(problem.unknowns(x))
        assert reached.all()
        assert theta == pytest.approx(truth_of(joint, log.P1, log.P2, log.torque, log.direction), abs=1e-8)


@pytest.mark.parametrize("name", MUSCLES)
def test_a_scaled_muscle_pulls_by_the_factor_everywhere(name):
    P, eps = np.array([1, 2, 4]) * BAR, np.array([[0.02], [0.1], [0.2]])
    muscle = MUSCLES[name]
    assert scaled(muscle, 2.5).force(P, eps) == pytest.approx(2.5 * muscle.force(P, eps), rel=1e-9)


def test_the_scale_of_every_model_is_known():
    from allocator.identification import fit, load_dataset

    data = load_dataset("dmsp-20-300-map")
    P, eps = np.array([1, 2, 4]) * BAR, np.array([[0.02], [0.1], [0.2]])
    for model in MODELS.values():
        muscle = fit(model, data.contraction, data.pressure, data.force, folds=0).muscle
        assert scaled(muscle, 0.6).force(P, eps) == pytest.approx(0.6 * muscle.force(P, eps), rel=1e-9), model


# --- the scale ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def unloaded(all_twins, log_maker):
    joint = all_twins["martens-lever"]
    log = log_maker(joint, 3)
    (theta, P1, P2), given = log.fit_arguments(loaded=False)
    return joint, log, fit_joint(theta, P1, P2, **given, geometry=joint.geometry, model="MartensBoblan2017")


@pytest.mark.slow
@pytest.mark.parametrize(
    "ask",
    [
        lambda fit: fit.joint.stiffness(0.0, 3 * BAR, 3 * BAR),
        lambda fit: fit.joint.torque(0.0, 3 * BAR, 3 * BAR),
        lambda fit: allocate(0.1, 5.0, joint=fit.joint),
        lambda fit: fit.stiffness(),
        lambda fit: fit.stiffness_std(),
    ],
)
def test_no_absolute_stiffness_is_given_without_a_weight(unloaded, ask):
    *_, fit = unloaded
    assert fit.scale is None
    with pytest.raises(ValueError, match="needs the force scale"):
        ask(fit)


@pytest.mark.slow
def test_a_joint_without_scale_is_saved_but_not_loaded_for_commands(unloaded, tmp_path):
    *_, fit = unloaded
    fit.save(tmp_path / "rough.toml")
    with pytest.raises(ValueError, match="fitted without a weight"):
        load_joint(tmp_path / "rough.toml")
    assert load_joint(tmp_path / "rough.toml", scale_needed=False) == fit.joint.shape


def test_angle_per_pressure_and_relative_stiffness_need_no_scale(unloaded):
    joint, _, fit = unloaded
    ours, true = (np.ptp(one.equilibrium(np.array([3.1, 3.3]) * BAR, 2.8 * BAR)) for one in (fit.joint, joint))
    assert ours == pytest.approx(true, rel=0.05)
    theta, P1, P2 = fit.joint.reference
    ratio = joint.stiffness(theta, 2 * BAR, 2 * BAR) / joint.stiffness(theta, P1, P2)
    std = fit.joint.relative_stiffness_std(theta, 2 * BAR, 2 * BAR)[0]
    assert 0 < std < 0.05
    assert abs(fit.joint.relative_stiffness(theta, 2 * BAR, 2 * BAR)[0] - ratio) < 3 * std


@pytest.mark.slow
def test_weights_added_later_complete_the_scale(unloaded):
    joint, log, _ = unloaded
    arrays, given = log.fit_arguments()
    done = fit_joint(*arrays, **given, geometry=joint.geometry, model="MartensBoblan2017")
    P = 3 * BAR
    assert abs(done.joint.stiffness(0.0, P, P) / joint.stiffness(0.0, P, P) - 1) < 3 * done.scale_std
    assert done.scale_std < 0.08


# --- friction -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["exact", "qp"])
def test_the_link_gets_the_torque_asked_for_whichever_way_it_moves(all_twins, method):
    way = np.array([-1.0, -0.3, 0.0, 1.0])
    for joint in all_twins.values():
        K = joint.stiffness(0.2, 3 * BAR, 3 * BAR)
        answer = allocate(0.2, K, 0.3, joint=joint, direction=way, method=method)
        lost = joint.friction_torque(0.2, answer.P1, answer.P2, way)
        assert answer.success.all()
        assert answer.T - lost == pytest.approx(0.3, abs=1e-6)
        assert answer.K == pytest.approx(K, rel=1e-6)


def test_a_joint_without_friction_is_not_disturbed_by_the_direction():
    still, moving = (allocate(0.2, 7.5, 1.0, direction=way) for way in (0, 1))
    assert (still.P1, still.P2) == (moving.P1, moving.P2)


def test_the_mpc_s_feed_forward_adds_what_the_fitted_friction_takes(all_twins):
    joint = all_twins["sarosi-pulley"]
    plant, rising = Plant(joint), 0.5 * 0.02 * np.arange(21)
    x = plant.at_rest(0.0, 5.0)
    tasks = [
        Preview(plant, 0.02, 20, known, Limits.of(plant, 0.02)).task(x, rising, 5.0, 0.0)
        for known in (Compensation(), Compensation.of(joint))
    ]
    plain, helped = (InverseDynamics(plant, 0.02, 20)(task.theta, task.K, task.d) for task in tasks)
    more = joint.torque(rising, *helped.x.T[2:]) - joint.torque(rising, *plain.x.T[2:])
    taken = joint.friction_torque(0.0, x[2], x[3], 1.0)  # as at present; Dahl: all of it after a few degrees
    assert more[0] == pytest.approx(0.0, abs=1e-6)
    assert more[-1] == pytest.approx(taken, rel=1e-3)
    assert taken > 0.1


# --- storage and planning -----------------------------------------------------------------------------------------


def test_a_joint_survives_its_file(all_twins, unloaded, tmp_path):
    angles = np.linspace(-1, 1, 9)
    table = Table(0.4, angles, 0.13 + 0.04 * np.sin(angles), 0.13 - 0.05 * np.sin(angles))
    fitted = next(iter(unloaded[2].shapes.values()))
    others = (report_joint(), AntagonistJoint(table, TONDU_MCKIBBEN, SAROSI_DMSP_20_400N), fitted)
    for joint in (*all_twins.values(), *others):
        save_machine(joint, tmp_path / "joint.toml", source={"of": "a test"})
        assert load_joint(tmp_path / "joint.toml") == joint


def test_a_file_that_is_no_joint_is_refused(tmp_path):
    path = tmp_path / "joint.toml"
    save_machine(report_joint(), path)
    path.write_text(path.read_text(encoding="utf-8").replace("friction", "strength"), encoding="utf-8")
    with pytest.raises(ValueError, match="has no strength"):
        load_joint(path)
    path.write_text('model = "Sarosi2012"\n')
    with pytest.raises(ValueError, match=r"the table \[machine\] is missing"):
        load_joint(path)


@pytest.mark.slow
def test_a_plan_followed_at_the_bench_gives_the_accuracy_it_promised(all_twins, truth_of):
    joint = all_twins["sarosi-lever"]
    plan = plan_joint_experiment(joint, accuracy=0.04)
    assert plan.reached
    assert len(re.findall(r"^ +\d+ +[+-]", str(plan), re.MULTILINE)) == len(plan.setpoints)
    T, P1, P2 = (np.repeat([getattr(s, name) for s in plan.setpoints], 2) for name in ("torque", "P1", "P2"))
    way = np.tile([-1.0, 1.0], len(plan.setpoints))
    angle = truth_of(joint, P1, P2, T, way)
    assert angle[::2] == pytest.approx([s.falling for s in plan.setpoints], abs=1e-6)
    errors = []
    given = {"geometry": joint.geometry, "start": joint.agonist, "choices": False}
    for seed in range(4):
        theta = angle + 0.5 * DEG * np.random.default_rng([77, seed]).standard_normal(angle.size)
        fit = fit_joint(theta, P1, P2, torque=T, direction=way, **given)
        P = np.array([2.0, 3.0, 4.0]) * BAR
        errors.append(fit.joint.stiffness(0.0, P, P) / joint.stiffness(0.0, P, P) - 1)
    assert np.sqrt(np.mean(np.square(errors))) < 2 * 0.04


def test_the_search_from_the_truth_stays_there_without_noise(all_twins, log_maker):
    joint = all_twins["sarosi-lever"]
    problem = replace(problem_of(joint, log_maker(joint, 3, noise=0.0), conventional=False), taut_min=0.0)
    x, converged = minimise(problem, first_guess(problem))
    assert converged
    assert problem.angle_error(x) == pytest.approx(0.0, abs=1e-5)
    assert problem.unknowns(x).friction == pytest.approx(joint.friction, abs=1e-4)
