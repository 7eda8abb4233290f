"""The nonlinear MPC solves the problem of the controller's docstring, and the linear one costs what it costs."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from allocator import BAR, DEG, InvalidInput, MissingBackend
from benchmarks.objective import closed_loop_cost
from mpc import (
    Compensation,
    NonlinearMPC,
    PlanStatus,
    Plant,
    RealPlant,
    Reference,
    Rung,
    TrackingMPC,
    Weights,
    simulate,
    sine,
)
from mpc.trials.metrics import metrics

PLANT = Plant()
N = 12
RIGHT = 2.1  # [rad], near the end of the joint range
SOLVERS = "ipopt", "fatrop"


@cache
def held(solver):
    """A controller built once, when it is needed; `reset` forgets."""
    return NonlinearMPC(PLANT, N=N, solver=solver)


def moving(x, omega):
    return np.array([x[0], omega, *x[2:]])


CASES = {  # state, angle, stiffness
    "small": (PLANT.at_rest(0.0, 7.6), 1 * DEG, 7.7),
    "slew binds": (PLANT.at_rest(0.0, 7.6), np.where(np.arange(N + 1) < 5, 0.0, 20 * DEG), 7.6),
    "supply binds": (PLANT.at_rest(0.3, 9.6), 0.5, 9.9),
    "joint range binds": (moving(PLANT.at_rest(RIGHT, 7.6), 2.0), RIGHT, 7.6),
    "taut muscles bind": (PLANT.at_rest(0.0, 6.55), 30 * DEG, 6.55),
}


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_multiple_shooting_finds_what_single_shooting_and_ipopt_find(case, solver, ipopt_mpc):
    """The fixture is the problem written anew from the docstring, with the commands alone for decisions."""
    x, theta, K = case
    nlp, mpc = ipopt_mpc(N), held(solver)
    mpc.reset()
    plan = mpc.step(x, theta, K)
    assert plan.status is PlanStatus.OPTIMAL
    assert plan.rung is Rung.QP
    u, _, _ = nlp.solve(x, np.broadcast_to(theta, N + 1), np.full(N + 1, K), x[2:])
    np.testing.assert_allclose(plan.u, u, atol=1e-3 * BAR)


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_second_step_goes_on_from_the_first(solver, ipopt_mpc):
    weights = Weights(rate=1 / (0.1 * BAR) ** 2)
    nlp, mpc = ipopt_mpc(N, weights), NonlinearMPC(PLANT, N=N, weights=weights, solver=solver)
    theta, K = np.zeros(N + 1), np.full(N + 1, 7.6)
    first = mpc.step(PLANT.at_rest(0.0, 7.65), theta, K)
    u, _, _ = nlp.solve(first.x[1], theta, K + 0.1, first.u[0], nlp.feed_forward(theta, K).u[0])
    np.testing.assert_allclose(mpc.step(first.x[1], theta, K + 0.1).u, u, atol=1e-3 * BAR)


def test_commands_from_outside_the_supply_return_at_the_slew_limit():
    mpc = held("ipopt")
    mpc.reset()
    start = np.array([0.0, 0.0, 5.2 * BAR, 5.1 * BAR])
    plan = mpc.step(start, 0.0, 9.0)
    assert plan.status is PlanStatus.OPTIMAL
    changes = np.abs(np.diff(plan.u, axis=0, prepend=start[None, 2:]))
    assert changes.max() <= PLANT.slew * 0.01 * (1 + 1e-9)
    assert (plan.u[-1] <= 5 * BAR).all()


# --- honesty ----------------------------------------------------------------------------------------------------------


def test_the_certificate_holds_for_the_solution_and_for_nothing_near_it():
    mpc, x = held("ipopt"), PLANT.at_rest(0.0, 7.6)
    shooting = mpc.problem
    feed = mpc._feed_forward(np.full(N + 1, 1 * DEG), np.full(N + 1, 7.7))
    given = shooting.given(x, feed, np.zeros(N), x[2:], feed.u[0])
    start = shooting.point(mpc._predictor.motion(x, feed.u), x[2:])
    z, multipliers, success = mpc._solve(start, given)
    assert success
    assert shooting.certify(z, multipliers, given).within(1e-6)
    assert not shooting.certify(start, multipliers, given).within(1e-6)
    assert not shooting.certify(z, 0.9 * multipliers, given).within(1e-6)
    assert not shooting.certify(z + np.nan, multipliers, given).within(1e-6)
    assert shooting.cost(z, given) < shooting.cost(
        shooting.point(mpc._predictor.motion(x, np.tile(x[2:], (N, 1))), x[2:]), given
    )


def test_a_solver_that_lies_or_gives_up_is_found_out_and_the_ladder_taken():
    mpc = NonlinearMPC(PLANT, N=N)
    x, right = PLANT.at_rest(0.0, 7.6), mpc._solve
    good = mpc.step(x, 1 * DEG, 7.7)
    mpc._solve = lambda start, given: right(start, given)._replace(z=start)
    lied = mpc.step(good.x[1], 1 * DEG, 7.7)
    assert (lied.status, lied.rung) == (PlanStatus.REFUSED, Rung.PREVIOUS)
    np.testing.assert_allclose(lied.u[:-1], good.u[1:])
    mpc._solve = lambda start, given: right(start, given)._replace(z=start, success=False)
    assert mpc.step(lied.x[1], 1 * DEG, 7.7).status is PlanStatus.UNSOLVED
    mpc._solve = right
    assert mpc.step(good.x[2], 1 * DEG, 7.7).status is PlanStatus.OPTIMAL


def test_a_state_beyond_all_numbers_counts_as_not_measured():
    controller = NonlinearMPC(PLANT, N=np.int64(5))
    rest = PLANT.at_rest(0.1, 7.6)
    controller.step(rest, 0.1, 7.6)
    plan = controller.step([1e300, *rest[1:]], 0.1, 7.6)
    assert (plan.rung, plan.status) == (Rung.QP, PlanStatus.NO_MEASUREMENT)
    assert np.isfinite(plan.u).all()
    assert np.isfinite(plan.x).all()
    assert controller.step(rest, 0.1, 7.6).status is PlanStatus.OPTIMAL


def test_without_the_angle_the_prediction_serves_for_a_while_and_then_the_joint_is_held():
    mpc, x = NonlinearMPC(PLANT, N=N, patience=0.02), PLANT.at_rest(0.0, 7.6)
    mpc.step(x, 0.0, 7.6)
    blind = np.array([np.nan, 0.0, *x[2:]])
    plans = [mpc.step(blind, 0.0, 7.6) for _ in range(4)]
    assert [plan.status for plan in plans[:2]] == [PlanStatus.NO_MEASUREMENT] * 2
    assert (plans[-1].status, plans[-1].rung) == (PlanStatus.BLIND, Rung.HOLD)
    assert mpc.step(x, 0.0, 7.6).status is PlanStatus.OPTIMAL


@pytest.mark.parametrize(
    ("settings", "said"),
    [({"solver": "magic"}, "ipopt"), ({"N": 2}, "N = 2"), ({"dt": -1.0}, "dt"), ({"min_force": -1.0}, "min_force")],
)
def test_settings_that_make_no_sense_are_refused(settings, said):
    with pytest.raises((InvalidInput, MissingBackend), match=said):
        NonlinearMPC(PLANT, **settings)


# --- in closed loop ---------------------------------------------------------------------------------------------------


def jump(angle=20 * DEG, K=(7.6, 7.6)):
    """A step that no joint follows, after 0.1 s of 0.5 s."""
    t = 0.01 * np.arange(51)
    return Reference(t, np.where(t < 0.095, 0.0, angle), np.where(t < 0.095, *K))


@pytest.mark.compiles
@pytest.mark.parametrize(
    ("reference", "most"),
    [(sine(duration=0.6, ramp=0.3, frequency=1.0), 0.5), (jump(), 0.05), (jump(0.0, (8.0, 10.0)), 0.05)],
    ids=["sine", "on the slew limit", "on the supply's limit"],
)
def test_one_qp_a_sample_costs_within_half_a_per_cent_of_the_nonlinear_mpc_in_closed_loop(reference, most):
    """`benchmarks/nominal.py` does it for all trajectories. `most` in %; below a unit of cost nothing counts."""
    best, ours = (
        closed_loop_cost(simulate(PLANT, controller, reference), Weights(), N).total
        for controller in (held("fatrop"), TrackingMPC(PLANT, N=N))
    )
    assert abs(ours - best) < most / 100 * max(best, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("build", [partial(TrackingMPC, compiled=False), NonlinearMPC], ids=["mpc", "nmpc"])
def test_a_step_of_stiffness_under_a_known_load_moves_the_angle_by_less_than_a_tenth_of_a_degree(build):
    hanging = Plant(gravity_torque=3.0)  # 1 N·m at 20°
    t = 0.01 * np.arange(61)
    step = Reference(t, np.full_like(t, 20 * DEG), np.where(t < 0.195, 7.0, 8.0))
    run = simulate(hanging, build(hanging), step)  # 12 samples ahead are too few for it: 0.17°
    assert run.K[-1] == pytest.approx(8.0, rel=1e-3)
    assert metrics(run).theta_worst < 0.1


def test_the_nonlinear_mpc_bears_dead_time_and_a_real_joint():
    real = RealPlant.standard()
    mpc = NonlinearMPC(real.nominal, N=N, weights=Weights.calm(), solver="fatrop", compensation=real.known())
    run = simulate(real, mpc, sine(amplitude=10 * DEG, K=5.5, K_amplitude=0.1, duration=1.0, ramp=0.5))
    assert mpc.ahead == N + 3
    assert metrics(run).limits_kept
    assert (run.rung == Rung.QP).mean() > 0.9
    assert Compensation().delay(0.01) == 0


# --- what a run has cost ----------------------------------------------------------------------------------------------


@pytest.mark.compiles
def test_the_cost_of_a_run_is_the_sum_written_anew():
    weights, reference = Weights(), sine(duration=0.6, ramp=0.3, frequency=1.0)
    run = simulate(PLANT, TrackingMPC(PLANT, N=N), reference)
    cost = closed_loop_cost(run, weights, N)
    angle = np.sum((run.theta - run.theta_ref)[1:] ** 2) * weights.theta / 2
    stiffness = np.sum((run.K - run.K_ref)[1:] ** 2) * weights.K / 2
    assert cost.theta == pytest.approx(angle, rel=1e-9)
    assert cost.K == pytest.approx(stiffness, rel=1e-9)
    assert cost.slack == cost.slack_force == 0.0
    assert cost.total == pytest.approx(sum(cost))
    assert min(cost) >= 0.0


@pytest.mark.compiles
def test_leaving_the_feed_forward_is_what_commands_are_charged_for():
    """At rest on a constant reference the feed-forward is the pressures; one bar more for one sample has its price."""
    still = Reference([0.0, 0.1], [0.0, 0.0], [7.6, 7.6])
    run = simulate(PLANT, TrackingMPC(PLANT, N=N), still)
    assert closed_loop_cost(run, Weights(), N).total < 1e-6
    u = run.u.copy()
    u[4, 0] += 1 * BAR
    charged = closed_loop_cost(replace(run, u=u), Weights(), N)
    assert charged.u == pytest.approx(0.5 * (1 / 0.5) ** 2, rel=1e-6)
    assert charged.rate == pytest.approx(2 * 0.5 * (100 / 10) ** 2, rel=1e-6)
