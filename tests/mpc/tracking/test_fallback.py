"""The fallback ladder, rung by rung: which one answers, what it sends, and that it is left again."""

import warnings
from functools import cache
from math import inf
from time import sleep

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from allocator import BAR, DEG, InvalidInput, torque_interval
from mpc import PlanStatus, Plant, Rung, TrackingMPC
from mpc.codegen.buffered import Buffered
from mpc.tracking.fallback import Ladder
from mpc.tracking.linearise import Predictor
from mpc.tracking.preview import BadNumbers
from mpc.tracking.qp.programme import QP
from mpc.tracking.qp.solvers import solver
from mpc.yardsticks.baselines import FeedForwardControl, LQRControl, PIDControl, PredictivePIDControl

pytestmark = pytest.mark.compiles

PLANT = Plant()
REST = PLANT.at_rest(0.1, 7.6)
STEP = Buffered(PLANT.discrete(0.01, 0.02))
DAQP = solver("daqp")
BASELINES = (PIDControl, PredictivePIDControl, LQRControl, FeedForwardControl)


@cache
def built(kind):
    """A controller of this class, built once, when it is needed; `reset` forgets."""
    return kind(PLANT, N=6, patience=0.02) if kind is TrackingMPC else kind(PLANT)


def late(qp, limit=0.0):
    sleep(max(limit, 0.0) + 0.01)
    return DAQP(qp)


def steps(controller, states, theta=0.15, K=7.7):
    """The plans for these measured states, after one for a state at rest."""
    return [controller.step(x, theta, K) for x in [REST, *states]]


def keeps_limits(plans):
    u = np.array([REST[2:], *(plan.u[0] for plan in plans)])
    low, high = PLANT.joint.pressure_limits
    all_finite = all(np.isfinite(a).all() for plan in plans for a in (plan.u, plan.x, plan.K))
    slow = (np.abs(np.diff(u, axis=0)) <= PLANT.slew * 0.01 * (1 + 1e-9)).all()
    return all_finite and slow and (u >= low).all() and (u <= high).all()


# --- time -------------------------------------------------------------------------------------------------------------


def test_an_answer_that_comes_late_is_not_waited_for_twice_and_the_plan_goes_on():
    controller = TrackingMPC(PLANT, N=5, budget=0.3)
    first = controller.step(REST, 0.15, 7.7)
    controller._solve = late
    second = controller.step(first.x[1], 0.15, 7.7)
    controller._solve = DAQP
    third = controller.step(second.x[1], 0.15, 7.7)
    assert [p.rung for p in (first, second, third)] == [Rung.QP, Rung.PREVIOUS, Rung.QP]
    assert [p.status for p in (first, second, third)] == [PlanStatus.OPTIMAL, PlanStatus.LATE, PlanStatus.OPTIMAL]
    np.testing.assert_allclose(second.u[:-1], first.u[1:], rtol=1e-12)
    assert keeps_limits([first, second, third])


def test_the_solver_is_told_how_much_time_is_left():
    told = []
    for budget in (0.5, None):
        controller = TrackingMPC(PLANT, N=5, budget=budget, solver=lambda qp, s: (told.append(s), DAQP(qp, s))[1])
        told.clear()
        assert controller.step(REST, 0.15, 7.7).rung is Rung.QP
        assert told[0] == inf if budget is None else 0.0 < told[0] < 0.5


def test_no_time_at_all_is_answered_at_once_by_the_allocation():
    asked = []
    controller = TrackingMPC(PLANT, budget=0.0, solver=lambda qp, limit: asked.append(qp))
    asked.clear()
    plan = controller.step(REST, 0.15, 7.7)
    assert (plan.status, plan.rung) == (PlanStatus.LATE, Rung.ALLOCATION)
    assert not asked


@pytest.mark.parametrize("name", ["daqp", "osqp", "clarabel", "scs"])
def test_solvers_stop_when_their_time_is_over(name):
    rng = np.random.default_rng(0)
    n, m = 30, 80
    M, R = rng.normal(size=(2 * n, n)), rng.normal(size=(m, n))
    qp = QP(M.T @ M, 3e3 * rng.normal(size=n), np.full(n, -0.3), np.full(n, 0.3), R, np.full(m, -0.3), np.full(m, 0.3))

    def solved(limit):
        found = solver(name)(qp, limit)
        return found is not None and qp.certify(*found).within(1e-4, 1e-3 * abs(qp.cost(found[0])))

    assert solved(10.0)
    assert not solved(1e-5)


# --- nothing to trust -------------------------------------------------------------------------------------------------


def test_without_the_angle_the_prediction_serves_for_the_patience_and_then_pressures_are_held():
    controller = TrackingMPC(PLANT, N=5, patience=0.03)
    plans = steps(controller, [np.full(4, np.nan)] * 6 + [REST])
    expected = [PlanStatus.OPTIMAL, *[PlanStatus.NO_MEASUREMENT] * 3, *[PlanStatus.BLIND] * 3, PlanStatus.OPTIMAL]
    assert [plan.status for plan in plans] == expected
    assert [plan.rung for plan in plans] == [*[Rung.QP] * 4, *[Rung.HOLD] * 3, Rung.QP]
    for plan in plans[4:7]:
        np.testing.assert_array_equal(plan.u, np.broadcast_to(plans[3].u[0], plan.u.shape))
    assert keeps_limits(plans)


def test_missing_pressures_are_predicted_for_as_long_as_it_takes():
    controller = TrackingMPC(PLANT, N=5, patience=0.03)
    plans = steps(controller, [np.array([REST[0], 0.0, np.nan, np.nan])] * 10)
    assert {plan.rung for plan in plans} == {Rung.QP}
    assert {plan.status for plan in plans[1:]} == {PlanStatus.NO_MEASUREMENT}


@pytest.mark.parametrize("garbage", [1e300, -1e12, 1e30])
@pytest.mark.parametrize("entry", range(4))
def test_a_state_that_no_joint_can_have_is_survived(garbage, entry):
    controller = TrackingMPC(PLANT, N=5)
    x = REST.copy()
    x[entry] = garbage
    plans = steps(controller, [x, np.full(4, np.nan), REST, REST])
    assert keeps_limits(plans)
    assert all((plan.status is PlanStatus.OPTIMAL) <= (plan.rung is Rung.QP) for plan in plans)
    assert plans[-1].rung is Rung.QP


def test_what_no_joint_can_measure_counts_as_not_measured():
    controller, twin = TrackingMPC(PLANT, N=5), TrackingMPC(PLANT, N=5)
    for entry, garbage in enumerate((1e300, 1e9, -1e12, 5e6)):
        states = [np.where(np.arange(4) == entry, value, REST) for value in (garbage, np.nan)]
        got, wanted = (steps(c, [x])[-1] for c, x in zip((controller, twin), states, strict=True))
        assert (got.rung, got.status) == (Rung.QP, PlanStatus.NO_MEASUREMENT)
        np.testing.assert_array_equal(got.u, wanted.u)


def test_to_begin_without_an_angle_is_to_hold_the_pressures_until_there_is_one():
    controller = TrackingMPC(PLANT, N=5)
    first = controller.step([1e300, 0, 2e5, 1e5], 0.0, 7.6)
    assert (first.rung, first.status) == (Rung.HOLD, PlanStatus.BLIND)
    np.testing.assert_array_equal(first.u, np.broadcast_to([2e5, 1e5], first.u.shape))
    assert np.isfinite(first.x).all()
    assert controller.step([0.0, 0.0, 2e5, 1e5], 0.0, 7.6).rung is Rung.QP


@pytest.mark.parametrize(
    ("theta", "K", "d", "said"),
    [
        (40.0, 7.6, 0.0, "theta_ref = 40 rad is over a turn"),
        (0.0, -1.0, 0.0, "K_ref = -1"),
        (0.0, np.nan, 0.0, "K_ref = nan is not finite"),
        (0.0, 7.6, np.inf, "d = inf"),
        (np.full(6, np.nan), 7.6, 0.0, r"theta_ref\[0\] = nan"),
    ],
)
def test_references_that_cannot_be_meant_hold_the_pressures_and_are_named_once(theta, K, d, said):
    controller = TrackingMPC(PLANT, N=5)
    good = controller.step(REST, 0.15, 7.7)
    with pytest.warns(BadNumbers, match=said):
        bad = controller.step(REST, theta, K, d)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = controller.step(REST, theta, K, d)
    assert [(p.rung, p.status) for p in (bad, again)] == 2 * [(Rung.HOLD, PlanStatus.BAD_INPUT)]
    np.testing.assert_array_equal(again.u, np.broadcast_to(good.u[0], again.u.shape))
    assert bad.moved is None
    assert controller.step(REST, 0.15, 7.7).rung is Rung.QP


@settings(max_examples=60, deadline=None)
@given(
    x=st.lists(st.floats(width=64), min_size=4, max_size=4),
    theta=st.floats(),
    K=st.floats(),
    d=st.floats(),
    begun=st.booleans(),
)
@pytest.mark.filterwarnings("ignore::mpc.tracking.preview.BadNumbers")
@pytest.mark.parametrize("kind", [TrackingMPC, *BASELINES])
def test_no_numbers_whatever_make_a_step_raise(kind, x, theta, K, d, begun):
    controller = built(kind)
    controller.reset()
    if begun:
        controller.step(REST, 0.15, 7.7)
    plans = [controller.step(x, theta, K, d), controller.step(x, 0.15, 7.7)]
    low, high = PLANT.joint.pressure_limits
    assert all(((low <= plan.u) & (plan.u <= high)).all() for plan in plans)


def test_an_absurd_torque_is_survived():
    controller = TrackingMPC(PLANT, N=5)
    plans = [controller.step(REST, 0.1, 7.6, d) for d in (0.0, 1e200, -1e6, 0.0, 0.0)]
    assert keeps_limits(plans)
    assert plans[-1].rung is Rung.QP


def test_what_is_held_long_is_let_out_slowly_and_in_proportion():
    predictor = Predictor(PLANT, 0.01, 5)
    ladder = Ladder(TrackingMPC(PLANT, N=5).limits, predictor, holding=0.1, venting=0.5 * BAR)
    u, seen = np.array([3.0, 1.5]) * BAR, []
    for _ in range(700):
        plan = ladder.hold(u)
        ladder.remember(Rung.HOLD, predictor.motion(REST, plan))
        u = plan[0]
        seen.append(u)
    seen = np.array(seen)
    np.testing.assert_array_equal(seen[:10], np.broadcast_to(seen[0], (10, 2)))
    np.testing.assert_allclose(seen[10:600, 0], (3.0 - 0.005 * np.arange(1, 591)) * BAR, rtol=1e-9)
    np.testing.assert_allclose(seen[:590, 1], seen[:590, 0] / 2, rtol=1e-9)
    np.testing.assert_array_equal(seen[-1], 0.0)


def test_after_a_rest_on_the_last_rung_the_first_plan_is_not_gone_on_with():
    """What lies on the ladder is the plan that was sent last: an old one must not come back."""
    controller = TrackingMPC(PLANT, N=5, patience=0.0)
    controller.step(REST, 0.15, 7.7)
    controller.step(np.full(4, np.nan), 0.15, 7.7)
    controller.budget = 0.0
    assert controller.step(REST, 0.15, 7.7).rung is Rung.ALLOCATION


@settings(max_examples=25, deadline=None)
@given(
    storm=st.lists(
        st.tuples(
            st.sampled_from(["fine", "none", "lie", "NaN"]),  # the solver
            st.sets(st.integers(0, 3)),  # entries of the state that are not measured …
            st.sampled_from([np.nan, np.inf, 1e250]),  # … and what is read instead
            st.floats(-1e4, 1e4),  # torque said to act [N·m]
        ),
        min_size=1,
        max_size=15,
    )
)
def test_whatever_comes_together_is_survived_and_forgotten(storm):
    answers = {
        "fine": DAQP,
        "none": lambda qp, limit: None,
        "lie": lambda qp, limit: (np.full_like(qp.f, 0.02), np.zeros(qp.f.size + len(qp.R))),
        "NaN": lambda qp, limit: (np.full_like(qp.f, np.nan), np.zeros(qp.f.size + len(qp.R))),
    }
    stormy = built(TrackingMPC)
    stormy.reset()
    x, plans = REST, [stormy.step(REST, 0.15, 7.7)]
    for how, lost, reading, torque in storm:
        stormy._solve = answers[how]
        read = np.where(np.isin(np.arange(4), list(lost)), reading, x)
        plans.append(stormy.step(read, 0.15, 7.7, torque))
        x = STEP(x, plans[-1].u[0], 0.0)[0][0]
    stormy._solve = DAQP
    plans.append(stormy.step(x, 0.15, 7.7))
    assert keeps_limits(plans)
    assert all(plan.rung is Rung.QP for plan in plans if plan.status is PlanStatus.OPTIMAL)
    assert (plans[-1].rung, plans[-1].status) == (Rung.QP, PlanStatus.OPTIMAL)


# --- what is said -----------------------------------------------------------------------------------------------------


def test_it_is_said_how_far_the_references_were_moved():
    controller = TrackingMPC(PLANT, N=5)
    right = PLANT.joint.angle_range[1]
    assert controller.step(REST, 0.1, 7.6).moved == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert controller.step(REST, right + 0.2, 7.6).moved.theta == pytest.approx(0.2)
    held = PLANT.at_rest(0.1, 20.0)
    assert controller.step(REST, 0.1, 20.0).moved.K == pytest.approx(20.0 - PLANT.stiffness(held))
    _, most = torque_interval(0.1)
    assert controller.step(REST, 0.1, 7.6, d=-50.0).moved.T == pytest.approx(50.0 - most, rel=1e-6)


def test_lack_of_muscle_force_is_said_in_newtons():
    plan = TrackingMPC(PLANT, N=5).step([0.0, 0.0, 0.5 * BAR, 0.5 * BAR], 0.0, 7.6)
    assert plan.slack_force == pytest.approx(-float(np.min(PLANT.forces(plan.x[1:].T))))
    assert plan.slack_force > 1.0
    asked = TrackingMPC(PLANT, N=5, min_force=40.0).step([0.0, 0.0, 0.5 * BAR, 0.5 * BAR], 0.0, 7.6)
    assert asked.slack_force > 41.0


def test_the_joint_keeps_its_muscles_as_taut_as_they_have_to_be():
    controller, x = TrackingMPC(PLANT, min_force=30.0), PLANT.at_rest(0.0, 7.6)
    for k in range(100):
        plan = controller.step(x, 20 * DEG * np.sin(k / 15), 6.0)
        x = STEP(x, plan.u[0], 0.0)[0][0]
        assert min(PLANT.forces(x)) > 29.5


# --- blocked moves ----------------------------------------------------------------------------------------------------


def test_blocks_of_one_sample_change_nothing():
    free, blocked = (TrackingMPC(PLANT, N=6, blocks=b).step(REST, 0.15, 7.7) for b in (None, [1] * 6))
    np.testing.assert_array_equal(free.u, blocked.u)


def test_within_a_block_the_commands_move_as_the_plan_before_did():
    controller = TrackingMPC(PLANT, N=8, blocks=(1, 1, 2, 4))
    first, second = (controller.step(REST, theta, 7.7) for theta in (0.15, 0.16))
    shifted = np.vstack([first.u[1:], first.u[-1]])
    moves = np.diff(second.u - shifted, axis=0)
    free = np.array([True, True, False, True, False, False])  # does block begin at sample 1, 2, …, 6?
    np.testing.assert_allclose(moves[:6][~free], 0.0, atol=1e-6)
    assert (np.abs(moves[:6][free]) > 1.0).any()
    assert controller.problem.E.shape == (8, 2, 10)


def test_blocked_moves_keep_the_limits_and_track_nearly_as_well():
    errors = {}
    for blocks in (None, (1, 1, 1, 1, 1, 1, 2, 2, 2, 4, 4)):
        controller, x, u, error = TrackingMPC(PLANT, blocks=blocks), REST, [REST[2:]], []
        for k in range(150):
            theta = 30 * DEG * np.sin((k + np.arange(21)) * 0.03)
            plan = controller.step(x, 0.1 + theta, 7.6)
            assert plan.rung is Rung.QP
            u.append(plan.u[0])
            x = STEP(x, u[-1], 0.0)[0][0]
            error.append(x[0] - 0.1 - theta[1])
        assert (np.abs(np.diff(u, axis=0)) <= 0.05 * BAR * (1 + 1e-9)).all()
        errors[blocks is None] = np.sqrt(np.mean(np.square(error)))
    assert errors[False] < 1.1 * errors[True] + 1e-5


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"blocks": (1, 2)}, r"blocks = \(1, 2\) cover 3 samples, not the N = 20"),
        ({"blocks": (0, 20)}, "a length of blocks = 0"),
        ({"budget": -1.0}, "budget = -1.0"),
        ({"patience": np.nan}, "patience"),
        ({"min_force": -3.0}, "min_force = -3.0"),
    ],
)
def test_settings_that_make_no_sense_are_refused(settings, said):
    with pytest.raises(InvalidInput, match=said):
        TrackingMPC(PLANT, **settings)


def test_a_budget_that_is_long_enough_changes_nothing():
    within, without = (TrackingMPC(PLANT, budget=budget).step(REST, 0.15, 7.7) for budget in (60.0, None))
    assert within.status is PlanStatus.OPTIMAL
    np.testing.assert_array_equal(within.u, without.u)
