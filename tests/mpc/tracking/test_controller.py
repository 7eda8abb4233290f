"""The controller: it solves its problem, keeps its limits whatever is asked, and always answers."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from allocator import BAR, DEG, InvalidInput
from mpc import PlanStatus, Plant, Rung, TrackingMPC, Weights
from mpc.codegen.buffered import Buffered
from mpc.tracking.preview import BadNumbers
from mpc.tracking.qp.condense import softened

pytestmark = pytest.mark.compiles

PLANT = Plant()
STEP = Buffered(PLANT.discrete(0.01, 0.02))


@cache
def ten_samples():
    """A controller built once, when it is needed; `reset` forgets."""
    return TrackingMPC(PLANT, N=10)


def broken_limits(plan, u_last, plant=PLANT, dt=0.01):
    low, high = plant.joint.pressure_limits
    changes = np.abs(np.diff(plan.u, axis=0, prepend=np.asarray(u_last)[None]))
    return not (
        np.isfinite(plan.u).all()
        and np.isfinite(plan.x).all()
        and (plan.u >= low).all()
        and (plan.u <= high).all()
        and (changes <= plant.slew * dt * (1 + 1e-9)).all()
    )


# --- against IPOPT ----------------------------------------------------------------------------------------------------

RIGHT = 2.1  # [rad], near the end of the joint range
CASES = {  # state, previews of theta and K
    "small": lambda n: (PLANT.at_rest(0.0, 7.6), np.full(n, 1 * DEG), np.full(n, 7.7)),
    "slew binds": lambda n: (PLANT.at_rest(0.0, 7.6), np.where(np.arange(n) < 5, 0.0, 20 * DEG), np.full(n, 7.6)),
    "supply binds": lambda n: (PLANT.at_rest(0.3, 9.6), np.full(n, 0.5), np.full(n, 9.9)),
    "taut muscles bind": lambda n: (PLANT.at_rest(0.0, 6.5), np.full(n, 10 * DEG), np.full(n, 6.2)),
    "joint range binds": lambda n: (moving(PLANT.at_rest(RIGHT, 7.6), 2.0), np.full(n, RIGHT), np.full(n, 7.6)),
}


def moving(x, omega):
    return np.array([x[0], omega, *x[2:]])


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_repeated_qps_reach_ipopt_s_solution_of_the_nonlinear_problem(case, ipopt_mpc):
    N = 12
    x, theta, K = case(N + 1)
    nlp = ipopt_mpc(N)
    u, cost, given_data = nlp.solve(x, theta, K, x[2:])
    plan = TrackingMPC(PLANT, N=N, iterations=15).step(x, theta, K)
    assert plan.status is PlanStatus.OPTIMAL
    assert nlp.cost_of(plan, given_data) == pytest.approx(cost, rel=1e-5)
    np.testing.assert_allclose(plan.u, u, atol=2e-3 * BAR)


def test_the_second_step_starts_from_the_first_one_s_command_and_feed_forward(ipopt_mpc):
    """From both, because the changes of their difference are charged for; dearly here, so that it shows."""
    weights = Weights(rate=1 / (0.1 * BAR) ** 2)
    nlp, mpc = ipopt_mpc(12, weights), TrackingMPC(PLANT, N=12, weights=weights, iterations=15)
    theta, K = np.zeros(13), np.full(13, 7.6)
    first = mpc.step(PLANT.at_rest(0.0, 7.65), theta, K)
    u, _, _ = nlp.solve(first.x[1], theta, K + 0.1, first.u[0], nlp.feed_forward(theta, K).u[0])
    np.testing.assert_allclose(mpc.step(first.x[1], theta, K + 0.1).u, u, atol=2e-3 * BAR)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["taut muscles bind", "joint range binds"])
def test_one_qp_a_sample_costs_what_the_nonlinear_mpc_costs_in_closed_loop(case, ipopt_mpc):
    """`tests/mpc/yardsticks/test_nonlinear.py` has motions on which the other limits bind."""
    N, steps = 12, 25
    x0, theta, K = CASES[case](N + steps + 1)
    nlp, mpc, w = ipopt_mpc(N), TrackingMPC(PLANT, N=N), Weights()

    def closed_loop(command):
        x, cost = x0, 0.0
        for k in range(steps):
            ahead = slice(k, k + N + 1)
            x = STEP(x, command(x, theta[ahead], K[ahead]), 0.0)[0][0]
            errors = x[0] - theta[k + 1], x[1], PLANT.stiffness(x) - K[k + 1]
            cost += np.dot([w.theta, w.omega, w.K], np.square(errors))
        return cost

    memory = [x0[2:], None]

    def by_ipopt(x, theta, K):
        u, _, _ = nlp.solve(x, theta, K, *memory)
        memory[:] = u[0], nlp.feed_forward(theta, K).u[0]
        return u[0]

    assert closed_loop(lambda *a: mpc.step(*a).u[0]) <= 1.005 * closed_loop(by_ipopt)


# --- limits -----------------------------------------------------------------------------------------------------------

angles, stiffnesses = st.floats(-170, 170), st.floats(3.0, 20.0)
pressures = st.floats(0, 5).map(lambda bar: round(bar, 2))  # a few Pa would be warned of as bar


@settings(max_examples=40)
@given(
    references=st.lists(st.tuples(angles, stiffnesses), min_size=1, max_size=5),
    theta0=st.floats(-120, 120),
    omega0=st.floats(-10, 10),
    P0=st.tuples(pressures, pressures),
)
def test_no_reference_makes_the_controller_break_a_hard_limit(references, theta0, omega0, P0):
    controller = ten_samples()
    controller.reset()
    x = np.array([theta0 * DEG, omega0, *(p * BAR for p in P0)])
    u_last = x[2:]
    for theta, K in references:
        for _ in range(3):
            plan = controller.step(x, theta * DEG, K)
            assert not broken_limits(plan, u_last)
            assert plan.rung is Rung.QP
            u_last = plan.u[0]
            x = STEP(x, u_last, 0.0)[0][0]


def test_pressures_that_start_outside_the_supply_return_at_the_slew_limit():
    controller = TrackingMPC(PLANT)
    x = np.array([0.0, 0.0, 5.4 * BAR, 3.0 * BAR])
    commands = []
    for _ in range(15):
        plan = controller.step(x, 0.0, 7.6)
        assert plan.rung is Rung.QP
        commands.append(plan.u[0, 0])
        x = STEP(x, plan.u[0], 0.0)[0][0]
    np.testing.assert_allclose(commands[:8], (5.4 - 0.05 * np.arange(1, 9)) * BAR, rtol=1e-9)
    assert commands[-1] <= 5 * BAR


@pytest.mark.parametrize("x", [[RIGHT + 0.2, 0.0, 3 * BAR, 3 * BAR], [0.0, 0.0, 0.2 * BAR, 0.2 * BAR]], ids=["θ", "F"])
def test_angles_and_forces_that_start_outside_their_limits_are_brought_back(x):
    controller, x = TrackingMPC(PLANT), np.array(x)
    first = controller.step(x, 1.0, 7.6)
    assert max(first.slack, first.slack_force) > 0.05
    for _ in range(100):
        plan = controller.step(x, 1.0, 7.6)
        assert plan.rung is Rung.QP
        x = STEP(x, plan.u[0], 0.0)[0][0]
    assert plan.slack == plan.slack_force == 0.0
    assert x[0] == pytest.approx(1.0, abs=1 * DEG)


def test_the_joint_range_is_left_only_when_it_must_be_and_this_is_said():
    controller = TrackingMPC(PLANT)
    right = PLANT.joint.angle_range[1]
    x = PLANT.at_rest(right - 0.01, 7.6)
    assert controller.step(x, 3.0, 7.6).slack < 1e-6
    controller.reset()
    assert controller.step(moving(x, 4.0), 3.0, 7.6).slack > 0.01


# --- the plan ---------------------------------------------------------------------------------------------------------


def test_a_plan_is_the_plant_s_motion_under_its_commands():
    controller = TrackingMPC(PLANT, N=8)
    x = PLANT.at_rest(0.1, 7.6)
    plan = controller.step(x, 0.15, 7.8)
    fine = Buffered(PLANT.discrete(0.01))
    for k in range(8):
        x = fine(x, plan.u[k], 0.0)[0][0]
        np.testing.assert_allclose(plan.x[k + 1], x, rtol=1e-10)
    np.testing.assert_allclose(plan.K, PLANT.stiffness(plan.x.T), rtol=1e-12)
    assert plan.times.total >= plan.times.feed_forward + plan.times.linearise + plan.times.condense + plan.times.solve
    with pytest.raises(ValueError, match="read-only"):
        plan.u[0] = 0.0


def test_in_equilibrium_on_the_reference_nothing_is_changed():
    x = PLANT.at_rest(0.4, 7.6)
    plan = TrackingMPC(PLANT).step(x, 0.4, 7.6)
    np.testing.assert_allclose(plan.u, np.broadcast_to(x[2:], plan.u.shape), atol=1e-6 * BAR)


def test_a_value_is_a_constant_preview():
    x = PLANT.at_rest(0.1, 7.6)
    value, preview = (TrackingMPC(PLANT).step(x, *refs) for refs in [(0.2, 7.7), (np.full(21, 0.2), np.full(21, 7.7))])
    np.testing.assert_array_equal(value.u, preview.u)


def test_a_known_disturbance_torque_is_compensated():
    controller = TrackingMPC(PLANT)
    x = PLANT.at_rest(0.2, 7.6)
    for _ in range(150):
        x = STEP(x, controller.step(x, 0.2, 7.6, d=1.0).u[0], 1.0)[0][0]
    assert x[0] == pytest.approx(0.2, abs=1e-3 * DEG)
    assert PLANT.stiffness(x) == pytest.approx(7.6, rel=1e-4)


@pytest.mark.parametrize("name", ["osqp", "clarabel"])
def test_another_solver_gives_the_same_plan(name):
    x = PLANT.at_rest(0.1, 7.6)
    ours, other = (TrackingMPC(PLANT, solver=s).step(x, 0.4, 8.0) for s in ("daqp", name))
    assert other.rung is Rung.QP
    np.testing.assert_allclose(other.u, ours.u, atol=2e-3 * BAR)


# --- never without an answer ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sabotage", "status"),
    [
        (lambda qp, limit: None, PlanStatus.UNSOLVED),
        (lambda qp, limit: (np.full_like(qp.f, 0.01), np.zeros(qp.f.size + len(qp.R))), PlanStatus.REFUSED),
        (lambda qp, limit: (np.full_like(qp.f, np.nan), np.zeros(qp.f.size + len(qp.R))), PlanStatus.REFUSED),
    ],
    ids=["gives up", "lies", "answers NaN"],
)
@pytest.mark.parametrize(
    ("softened", "answers"),
    [(softened, ["SOFTENED"] * 7), (lambda qp, deadline: None, [*["PREVIOUS"] * 4, *["ALLOCATION"] * 3])],
    ids=["softened", "not even softened"],
)
def test_when_the_solver_fails_the_ladder_answers_and_recovery_is_automatic(
    sabotage, status, softened, answers, monkeypatch
):
    monkeypatch.setattr("mpc.tracking.controller.softened", softened)
    controller = TrackingMPC(PLANT, N=5)
    good = controller._solve
    x, u_last, rungs = PLANT.at_rest(0.0, 7.6), PLANT.at_rest(0.0, 7.6)[2:], []
    for k in range(10):
        controller._solve = sabotage if 1 <= k < 8 else good
        plan = controller.step(x, 0.1, 7.7)
        assert not broken_limits(plan, u_last)
        assert (plan.status is PlanStatus.OPTIMAL) == (plan.rung is Rung.QP)
        if plan.rung is not Rung.QP:
            assert plan.status is status
        rungs.append(plan.rung.name)
        u_last = plan.u[0]
        x = STEP(x, u_last, 0.0)[0][0]
    assert rungs == ["QP", *answers, "QP", "QP"]


def test_the_previous_plan_goes_on_where_it_was(monkeypatch):
    monkeypatch.setattr("mpc.tracking.controller.softened", lambda qp, deadline: None)
    controller = TrackingMPC(PLANT)
    x = PLANT.at_rest(0.0, 7.6)
    first = controller.step(x, 0.1, 7.7)
    controller._solve = lambda qp, limit: None
    second = controller.step(first.x[1], 0.1, 7.7)
    np.testing.assert_allclose(second.u[:-1], first.u[1:], rtol=1e-12)


def test_without_any_plan_the_allocation_is_approached_at_the_slew_limit(monkeypatch):
    monkeypatch.setattr("mpc.tracking.controller.softened", lambda qp, deadline: None)
    controller = TrackingMPC(PLANT)
    controller._solve = lambda qp, limit: None
    x = PLANT.at_rest(0.0, 7.0)
    plan = controller.step(x, 0.0, 8.5)
    assert plan.rung is Rung.ALLOCATION
    np.testing.assert_allclose(plan.u[:5, 0] - x[2], 0.05 * BAR * np.arange(1, 6), rtol=1e-9)


def test_a_missing_measurement_is_replaced_by_the_prediction():
    controller = TrackingMPC(PLANT)
    x = PLANT.at_rest(0.0, 7.6)
    first = controller.step(x, 0.1, 7.7)
    blind = controller.step([np.nan, *first.x[1][1:]], 0.1, 7.7)
    assert blind.status is PlanStatus.NO_MEASUREMENT
    np.testing.assert_array_equal(blind.x[0], first.x[1])
    assert not broken_limits(blind, first.u[0])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (([0, 0, 3e5], 0.0, 7.6), "x has the shape"),
        (({}, 0.0, 7.6), "x = {} is not a number"),
        (([0, 0, 3e5, 3e5], np.zeros(5), 7.6), "theta_ref has the shape"),
        (([0, 0, 3e5, 3e5], "up", 7.6), "theta_ref = 'up' is not a number"),
        (([0, 0, 3e5, 3e5], 0.0, 1j), "K_ref = 1j is not a number"),
    ],
)
def test_arguments_that_make_no_sense_are_refused(arguments, said):
    with pytest.raises(InvalidInput, match=said):
        TrackingMPC(PLANT).step(*arguments)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"dt": 10.0}, "dt = 10 s"),
        ({"dt": "fast"}, "dt = 'fast' is not a number"),
        ({"N": 2}, "N = 2"),
        ({"N": 2.5}, "N = 2.5"),
        ({"iterations": 0}, "iterations = 0"),
    ],
)
def test_settings_that_make_no_sense_are_refused(settings, said):
    with pytest.raises(InvalidInput, match=said):
        TrackingMPC(PLANT, **settings)


def test_weights_have_to_be_positive():
    with pytest.raises(InvalidInput, match="theta = -1"):
        Weights(theta=-1)


@pytest.mark.parametrize("P", [(2.3, 3.4), (0.0, 3.4), (float("nan"), 3.4)])
def test_pressures_in_bar_are_pointed_out_at_the_first_step(P):
    controller = ten_samples()
    controller.reset()
    with pytest.warns(BadNumbers, match="if bar was meant, multiply by 1e5"):
        controller.step([0.1, 0.0, *P], 0.1, 7.5)
    controller.step([0.1, 0.0, *P], 0.1, 7.5)  # said once: warnings are errors


@pytest.mark.parametrize("P", [(2.3e5, 3.4e5), (0.0, 0.0), (0.0, 3.4e5), (float("nan"), float("nan"))])
def test_pressures_in_pascal_are_not(P):
    controller = ten_samples()
    controller.reset()
    controller.step([0.1, 0.0, *P], 0.1, 7.5)


@pytest.mark.parametrize(
    ("readings", "said"),
    [
        (
            [(0.0, 0.0), (0.03, 0.02), (2.3, 3.4)],
            "P.* = 2.3 Pa is next to nothing; if bar was meant",
        ),  # vented at first
        ([(2.3e5, 3.4e5)], "θ.* = 11 rad is over a turn; if degrees were meant, pass 0.192 rad"),
    ],
)
def test_the_first_readings_that_show_a_unit_are_checked(readings, said):
    controller = ten_samples()
    controller.reset()
    *before, last = readings
    for P in before:
        controller.step([0.1, 0.0, *P], 0.1, 7.5)
    with pytest.warns(BadNumbers, match=said):
        controller.step([11.0 if last[0] > 1e5 else 0.1, 0.0, *last], 0.1, 7.5)
