"""The compiled step is the readable one: the same laws, the same QP, the same answer; and it is not needed."""

import math
from copy import deepcopy

import numpy as np
import pytest

from allocator import BAR, DEG
from mpc import Compensation, PlanStatus, Plant, TrackingMPC, Weights
from mpc.tracking.compiled import module
from mpc.tracking.compiled.factory import factory
from mpc.tracking.compiled.qp_step import CompiledFeedForward, CompiledQPStep
from mpc.tracking.feedforward import FeedForward, InverseDynamics
from mpc.tracking.limits import Limits
from mpc.tracking.linearise import Predictor
from mpc.tracking.qp.condense import TrackingProblem, condense
from mpc.tracking.qp.programme import QP
from mpc.tracking.qp.solvers import solver
from mpc.tracking.qp.step import PreviousSample, ReadableQPStep, certified
from mpc.tracking.terminal import terminal_factor

RNG = np.random.default_rng(8)
DAQP, RICCATI = solver("daqp"), solver("riccati")


# --- the QP -----------------------------------------------------------------------------------------------------------

CASES = {  # name of the joint, plant, dt, blocks, how far all is from rest: commands [bar] and the rest alike
    "report": ("report", {}, 0.01, (1,) * 12, 0.5),
    "report, within the limits": ("report", {}, 0.01, (1,) * 12, 0.02),
    "substeps, gravity, blocks": (
        "sarosi-lever",
        {"lag": (0.1, 0.03), "venting": 1.5, "gravity_torque": 0.8, "hanging_angle": 0.4},
        0.04,
        (1, 1, 2, 4),
        0.5,
    ),
    "no kernel": ("tondu-lever", {}, 0.01, (1,) * 8, 0.5),
}


class Case:
    """One step, ready to be built in both ways."""

    def __init__(self, joint, options, dt, blocks, away):
        self.plant, self.dt, N = Plant(joint=joint, **options), dt, sum(blocks)
        weights = Weights()
        L = terminal_factor(self.plant, dt, weights)
        limits = Limits.of(self.plant, dt, 5.0)
        self.problem = TrackingProblem(weights, limits, L, blocks, dt)
        self.predictor, self.inverse = Predictor(self.plant, dt, N), InverseDynamics(self.plant, dt, N, 5.0)
        self.qp_step, self.feed_forward = factory(self.plant, dt, self.problem, self.predictor, self.inverse)
        self.readable = ReadableQPStep(self.problem, self.predictor)
        left, right = limits.theta
        self.x = self.plant.at_rest(0.7 * left + 0.3 * right, 1.2 * self.plant.stiffness(self.plant.at_rest(0.0, 1.0)))
        self.theta = self.x[0] + np.linspace(0.0, 4 * away * DEG, N + 1)
        self.K = np.full(N + 1, float(self.plant.stiffness(self.x)))
        self.d = 0.2 * away * RNG.normal(size=N + 1)
        self.u = self.x[2:] + away * BAR * RNG.normal(size=(N, 2))

    def arguments(self, solve=RICCATI, x=None, deadline=math.inf):
        feed = self.inverse(self.theta, self.K, self.d)
        previous = PreviousSample(self.x[2:], feed.u[0] - 1e3)
        return self.x if x is None else x, self.u, self.d[:-1], feed, previous, solve, deadline


def long_to_compile(name):
    return [pytest.mark.slow] if name in ("no kernel", "substeps, gravity, blocks") else []


@pytest.fixture(
    scope="module", params=[pytest.param(c, id=name, marks=long_to_compile(name)) for name, c in CASES.items()]
)
def case(request, joints):
    name, *rest = request.param
    return Case(joints[name], *rest)


@pytest.mark.slow
def test_the_compiled_step_is_used_here(case):
    assert isinstance(case.qp_step, CompiledQPStep)
    assert isinstance(case.feed_forward, CompiledFeedForward) == bool(module.compiled_plant(case.plant, case.dt).p.size)


@pytest.mark.compiles
def test_the_compiled_qp_is_the_readable_one(case):
    qp = case.qp_step(*case.arguments(solve=lambda qp, limit: None)).qp
    x, u, d, feed, previous, *_ = case.arguments()
    model = case.predictor.linearise(x, case.problem.limits.limited(previous.u, u), d)
    wanted = condense(case.problem, model, feed, *previous)
    for name in ("H", "f", "lower", "upper", "R", "rows_lower", "rows_upper"):
        one, other = getattr(qp, name), getattr(wanted, name)
        finite = np.isfinite(other)
        np.testing.assert_array_equal(one[~finite], other[~finite])
        np.testing.assert_allclose(one[finite], other[finite], rtol=1e-10, atol=1e-12 * np.abs(other[finite]).max())


@pytest.mark.compiles
def test_the_compiled_step_comes_to_the_readable_one_s_commands_and_motion(case):
    compiled, readable = (step(*case.arguments()) for step in (case.qp_step, case.readable))
    assert compiled.status is readable.status is PlanStatus.OPTIMAL
    np.testing.assert_allclose(compiled.u, readable.u, atol=1e-6 * BAR)
    assert compiled.motion is not None
    wanted = case.predictor.motion(case.x, compiled.u, case.d[:-1])
    for name in ("u", "x", "K", "F"):
        np.testing.assert_allclose(getattr(compiled.motion, name), getattr(wanted, name), rtol=1e-10, atol=1e-9)


@pytest.mark.compiles
def test_where_rows_bind_the_commands_are_those_of_the_whole_qp(case):
    x = np.array([case.problem.limits.theta[1] - 0.01, 4.0, *case.x[2:]])
    compiled, readable = (step(*case.arguments(x=x)) for step in (case.qp_step, case.readable))
    qp = readable.qp
    z, multipliers = DAQP(qp)
    assert multipliers[z.size :].any()
    assert compiled.motion is not None  # no other solver was asked
    assert compiled.status is readable.status is PlanStatus.OPTIMAL
    np.testing.assert_allclose(compiled.u, readable.u, atol=1e-5 * BAR)


@pytest.mark.compiles
def test_no_eigenvalue_of_the_hessian_is_below_the_charge_for_changes(case):
    qp = case.qp_step(*case.arguments(solve=lambda qp, limit: None)).qp
    n, w = qp.f.size - 2, case.problem.weights
    assert np.linalg.eigvalsh(qp.H[:n, :n]).min() >= w.rate * BAR**2 / case.dt**2 * (1 - 1e-9)


LIES = {
    "above": lambda z, push: (z + 0.1, push),
    "below": lambda z, push: (z - 0.1, push),
    "not a number": lambda z, push: (z + np.nan, push),
    "nothing is a number": lambda z, push: (z + np.nan, push + np.nan),
    "at the wrong bounds": lambda z, push: (-z, -push),
    "nothing": lambda z, push: (0 * z, 0 * push),
}


@pytest.mark.compiles
@pytest.mark.parametrize("lie", LIES.values(), ids=LIES.keys())
def test_a_wrong_answer_is_refused_or_put_right(case, lie):
    wanted = case.readable(*case.arguments())
    arguments = case.arguments(solve=lambda qp, limit: lie(*DAQP(qp, limit)))
    case.qp_step.reset()
    compiled, readable = case.qp_step(*arguments), case.readable(*arguments)
    assert compiled.status in (PlanStatus.OPTIMAL, PlanStatus.REFUSED)
    if compiled.status is PlanStatus.OPTIMAL:
        np.testing.assert_allclose(compiled.u, wanted.u, atol=1e-6 * BAR)
    assert readable.status is compiled.status is PlanStatus.REFUSED


@pytest.mark.compiles
@pytest.mark.parametrize("away", [0.0, 0.3])
@pytest.mark.parametrize("off", [0.028, 5.1e-3])
def test_no_answer_passes_that_is_farther_from_the_solution_than_is_said(case, off, away):
    case.theta += away
    try:
        qp = case.qp_step(*case.arguments(solve=lambda qp, limit: None)).qp
    finally:
        case.theta -= away
    answer = certified(DAQP, qp, math.inf, case.problem.curvature)
    assert answer.status is PlanStatus.OPTIMAL
    solved = [qp.certify(answer.z, answer.multipliers).gap]
    flattest = np.linalg.eigh(qp.H[:-2, :-2])[1][:, 0]  # where a step costs least
    for direction in (flattest, -flattest, *RNG.normal(size=(5, flattest.size))):
        away_from = answer.z.copy()
        away_from[:-2] += off * direction / np.linalg.norm(direction)
        found = certified(lambda some, limit, z=away_from: (z, DAQP(some)[1]), qp, math.inf, case.problem.curvature)
        assert found.status is PlanStatus.REFUSED
        solved.append(qp.certify(away_from, answer.multipliers).gap)
    assert solved[0] < min(solved[1:]) / 2


@pytest.mark.compiles
def test_an_answer_that_comes_late_is_not_used(case):
    assert case.qp_step(*case.arguments(deadline=-1.0)).status is PlanStatus.LATE


@pytest.mark.compiles
def test_a_wrong_guess_does_not_change_the_answer(case):
    first = case.qp_step(*case.arguments())
    guess = case.qp_step.structured.guess
    guess[:] = RNG.integers(-1, 2, guess.size)
    np.testing.assert_allclose(case.qp_step(*case.arguments()).u, first.u, atol=1e-6 * BAR)


def bound_of(case, **changed):
    """The sign of the multipliers that DAQP finds for the changes of the commands."""
    readable = case.readable(*case.arguments(DAQP, **changed))
    return np.sign(DAQP(readable.qp)[1][: readable.qp.f.size - 2])


@pytest.mark.compiles
def test_the_guess_is_the_last_sample_s_active_set_one_sample_earlier(case):
    case.qp_step.reset()
    assert not case.qp_step.active_set.any()
    assert case.qp_step(*case.arguments()).motion is not None
    bound = bound_of(case)
    np.testing.assert_array_equal(case.qp_step.active_set, bound)
    x, u, d, feed, previous, *_ = case.arguments()
    case.qp_step.structured.take(x, u, d, feed, previous)
    starts, bound = case.problem.starts, bound.reshape(-1, 2)
    for start, guess in zip(starts, case.qp_step.active_set.reshape(-1, 2), strict=True):
        block = sum(starts <= start + 1) - 1  # in which that sample was
        np.testing.assert_array_equal(guess, bound[block])


@pytest.mark.compiles
def test_between_the_qps_of_one_sample_the_guess_stays_where_it_is(case):
    case.qp_step.reset()
    given = case.arguments()
    first = case.qp_step(*given)
    bound, structured = bound_of(case), case.qp_step.structured
    structured.take(*given[:5])
    np.testing.assert_array_equal(structured.guess, bound)
    again = case.qp_step(*given)
    assert structured.exchanges == 0  # the sweep settled at once
    np.testing.assert_allclose(again.u, first.u, atol=1e-6 * BAR)


@pytest.mark.compiles
def test_while_a_row_binds_the_guess_is_that_of_the_changes_that_bind(case):
    x = np.array([case.problem.limits.theta[1] - 0.01, 4.0, *case.x[2:]])
    case.qp_step(*case.arguments(x=x))
    bound = bound_of(case, x=x)
    assert bound.any()
    np.testing.assert_array_equal(changes_in(case.qp_step.active_set), bound)


# --- the structured way -----------------------------------------------------------------------------------------------


def changes_in(held):
    """What is held at the slew; ±2 are commands at an end of the supply."""
    return np.where(np.abs(held) == 1, held, 0)


def box_of(qp):
    """The QP without its rows and slacks."""
    n, nothing = qp.f.size - 2, np.zeros(0)
    return QP(qp.H[:n, :n].copy(), qp.f[:n], qp.lower[:n], qp.upper[:n], qp.R[:0, :n], nothing, nothing)


@pytest.mark.compiles
@pytest.mark.parametrize("away", [0.0, 0.02, 0.05, 0.3])  # [rad] of the reference from the state: the slew limit binds
@pytest.mark.parametrize("told", [True, False], ids=["from the set", "from nothing"])
def test_riccati_recursions_and_daqp_come_to_the_same_point(case, away, told):
    case.theta += away
    try:
        qp = case.qp_step(*case.arguments(solve=lambda qp, limit: None)).qp
    finally:
        case.theta -= away
    exact, multipliers = DAQP(qp)
    structured, n = case.qp_step.structured, qp.f.size - 2
    structured.guess[:] = np.sign(multipliers[:n]) if told else 0
    assert structured.solved()
    rows_bind = multipliers[n:].any()
    assert structured.exchanges == 0 or not told or rows_bind  # from the set the sweep settles
    np.testing.assert_allclose(structured.z, exact[:n], atol=1e-5 if rows_bind else 1e-8)
    assert (changes_in(structured.guess) == np.sign(multipliers[:n])).all()
    case.qp_step.reset()


@pytest.mark.compiles
def test_at_long_horizons_too_the_recursions_confirm_the_solver_s_set():
    mpc, x, confirmed, bound = TrackingMPC(Plant(), N=80), Plant().at_rest(0.0, 7.6), 0, 0
    structured = mpc._qp_step.structured
    for k in range(30):
        last = mpc.ladder.previous(np.zeros(2), np.zeros(2)) if k else None
        plan = mpc.step(x, 0.5 * (-1) ** (k // 10), 7.6)
        if last is not None:
            reference, given = structured.given.reference, structured.given
            feed = FeedForward(reference.x.copy(), reference.y.copy(), reference.u.copy(), None)
            exact, multipliers = DAQP(box_of(condense(mpc.problem, structured.model, feed, *given.last)))
            structured.guess[:] = np.sign(multipliers)
            if structured.solved() and structured.exchanges == 0:
                confirmed += 1
                np.testing.assert_allclose(structured.z, exact, atol=1e-6)
            bound += multipliers.any()
        x = plan.x[1]
    assert bound > 20
    assert confirmed >= 28


@pytest.mark.compiles
@pytest.mark.parametrize("blocks", [(1,) * 20, (1,) * 10 + (2,) * 5], ids=["samples", "blocks"])
def test_sample_after_sample_the_commands_are_those_of_a_solver(blocks):
    compiled = TrackingMPC(Plant(), N=20, blocks=blocks)
    other = TrackingMPC(Plant(), N=20, blocks=blocks, solver=lambda qp, limit: DAQP(qp, limit))  # is always asked
    x, K, settled, asked, bound = Plant().at_rest(0.0, 7.6), np.full(21, 7.6), 0, 0, 0
    for k in range(60):
        theta = 0.2 * np.sin(6.0 * 0.01 * (k + np.arange(21)))
        plan, wanted = compiled.step(x, theta, K, 0.1), other.step(x, theta, K, 0.1)
        np.testing.assert_allclose(plan.u, wanted.u, atol=1e-5 * BAR)
        settled += compiled._qp_step.structured.exchanges == 0
        asked += plan.times.condense > 0.0
        bound += np.abs(np.diff(plan.u, axis=0)).max() >= compiled.limits.step * (1 - 1e-6)
        x = plan.x[1]
    assert settled > 30
    assert asked == 0
    assert 5 < bound < 55


@pytest.mark.compiles
def test_the_time_of_a_settled_step_is_that_of_its_solution():
    mpc, x = TrackingMPC(Plant(), N=80), Plant().at_rest(0.0, 7.6)
    steps = [mpc.step(x, 0.0, 7.6).times for _ in range(10)][5:]
    assert all(times.condense == 0.0 for times in steps)
    assert max(times.solve / times.total for times in steps) > 0.1  # the greatest: others want the processor, too


# --- the feed-forward -------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", ["report", "substeps, gravity, blocks"])
def test_the_compiled_feed_forward_is_the_readable_one(name, joints):
    name, options, *_ = CASES[name]  # which are compiled for other tests, too
    plant = Plant(joint=joints[name], **options)
    readable = InverseDynamics(plant, 0.04, 8, 5.0)
    compiled = CompiledFeedForward(module.compiled_plant(plant, 0.04), readable)
    far = 1.2 * joints[name].angle_range[1]
    for theta in (np.linspace(-0.2, 0.3, 9), np.linspace(0.0, far, 9)):  # within reach, and beyond
        for K in (np.linspace(5.0, 9.0, 9), np.full(9, 50.0)):
            feeds = (inverse(theta, K, np.linspace(0.0, 1.0, 9)) for inverse in (compiled, readable))
            columns = ((*feed.x.T, *feed.y.T, *feed.u.T, np.array(feed.moved)) for feed in feeds)
            for found, wanted in zip(*columns, strict=True):
                np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9 * np.abs(wanted).max())


@pytest.mark.slow
def test_a_copy_of_a_controller_goes_its_own_way(case):
    mpc = TrackingMPC(case.plant, case.dt, N=sum(case.problem.blocks))
    x, theta, K = case.x, float(case.theta[0]), float(case.K[0])
    mpc.step(x, theta, K)
    other = deepcopy(mpc)
    wanted = mpc.step(x, theta + 0.05, K).u
    other.step(x, theta, K)
    mpc.reset()
    mpc.step(x, theta, K)
    np.testing.assert_allclose(mpc.step(x, theta + 0.05, K).u, wanted, atol=1e-6 * BAR)


@pytest.mark.compiles
def test_the_readable_step_s_answer_is_certified_too(case):
    step = case.readable(*case.arguments())
    assert certified(DAQP, step.qp, math.inf, case.problem.curvature).status is PlanStatus.OPTIMAL


@pytest.mark.parametrize("dead_band", [0.0, 0.1 * BAR])
def test_a_gauge_below_zero_begins_the_first_command_at_zero(dead_band):
    known, x = Compensation(dead_time=0.03, dead_band=dead_band), Plant().at_rest(0.05, 7.6)
    x[1:3] = 2.0, -800.0
    plans = [
        TrackingMPC(Plant(), N=10, compensation=known, compiled=compiled).step(x, 0.1, 7.6)
        for compiled in (True, False)
    ]
    np.testing.assert_allclose(plans[0].u, plans[1].u, atol=1e-6)
    assert plans[0].u[0, 0] == pytest.approx(Plant().slew * 0.01)
