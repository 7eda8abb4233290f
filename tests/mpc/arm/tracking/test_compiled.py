"""The compiled step of an arm says what the readable one says."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest

from mpc.model.arm.model import Arm
from mpc.tracking import cost
from mpc.tracking.compiled.factory import factory
from mpc.tracking.controller import TrackingMPC, usual_blocks
from mpc.tracking.cost import Weights
from mpc.tracking.feedforward import InverseDynamics
from mpc.tracking.limits import Limits
from mpc.tracking.linearise import Predictor
from mpc.tracking.plan import PlanStatus
from mpc.tracking.qp.condense import TrackingProblem, condense
from mpc.tracking.qp.solvers import DAQP, Riccati
from mpc.tracking.qp.step import PreviousSample, ReadableQPStep, certified
from mpc.tracking.terminal import terminal_factor

pytestmark = pytest.mark.compiles

N, DT = 12, 0.01


class Both:
    """Both are the readable and the compiled parts of one problem."""

    def __init__(self, name, min_force=20.0, gas=None):
        self.arm = arm = replace(Arm.machine(name), gas=gas)
        limits = Limits.of(arm, DT, min_force)
        L, sizes = terminal_factor(arm, DT, Weights()), (arm.n, arm.m, arm.stiffnesses)
        self.problem = TrackingProblem(Weights(), limits, L, usual_blocks(arm, N), DT, *sizes)
        self.predictor = Predictor(arm, DT, N)
        self.inverse = InverseDynamics(arm, DT, N, min_force)
        self.readable = ReadableQPStep(self.problem, self.predictor)
        self.compiled, self.feed_forward = factory(arm, DT, self.problem, self.predictor, self.inverse)

    def situation(self, rng, near=False):
        """Return x, u, d, feed-forward and previous sample; `near` limits of angles and pressures."""
        arm = self.arm
        low, high = arm.angle_limits
        q = high - 0.01 * rng.random(arm.n) if near else rng.uniform(0.3 * low, 0.3 * high)
        P = rng.uniform(0.2e5, 4.9e5, arm.m) if near else rng.uniform(2e5, 4e5, arm.m)
        x = np.concatenate([q, rng.normal(0, 0.3, arm.n), P])
        u = P + rng.normal(0, 0.1e5, (N, arm.m)).cumsum(axis=0)
        d = rng.normal(0, 0.3, (N + 1, arm.n))
        turn = np.linspace(0, 0.1, N + 1)[:, None] * rng.normal(size=arm.n)
        K = np.tile(np.diag(rng.uniform(5, 8, arm.n)), (N + 1, 1, 1))
        feed = self.inverse(q + turn, K, d)
        return x, u, d, feed, PreviousSample(u[0] + rng.normal(0, 0.03e5, arm.m), feed.u[0] * 1.01), (q + turn, K)


MACHINES = "arm26", "arm26 with gas", pytest.param("arm48", marks=pytest.mark.slow)


@pytest.fixture(scope="module", params=MACHINES)
def both(request):
    name, gas, _ = request.param.partition(" with gas")
    made = Both(name, gas=bool(gas))
    assert made.compiled.implementation == "compiled"
    return made


def test_the_whole_qp_is_that_of_the_readable_step(both):
    rng = np.random.default_rng(5)
    for _ in range(4):
        x, u, d, feed, previous, _ = both.situation(rng)
        compiled = both.compiled(x, u, d[:-1], feed, previous, DAQP(), inf).qp
        readable = both.readable(x, u, d[:-1], feed, previous, DAQP(), inf).qp
        scale = np.sqrt(np.diag(readable.H))
        np.testing.assert_allclose(compiled.H / np.outer(scale, scale), readable.H / np.outer(scale, scale), atol=1e-10)
        np.testing.assert_allclose(
            compiled.f / scale, readable.f / scale, rtol=1e-9, atol=1e-9 * abs(readable.f / scale).max()
        )
        for name in ("lower", "upper", "R", "rows_lower", "rows_upper"):
            np.testing.assert_allclose(getattr(compiled, name), getattr(readable, name), rtol=1e-9, atol=1e-10)


def with_sixth(monkeypatch, sixth):
    """Both, with one more line in the table of residuals."""
    table = cost.residuals
    monkeypatch.setattr("mpc.tracking.cost.residuals", lambda *sizes: (*table(*sizes), sixth))
    return Both("arm26")


def test_a_sixth_weight_is_charged_by_the_compiled_step_as_by_the_readable_one(monkeypatch):
    """A second one of the elbow's angle, one of the first muscle's rate, of its pressure, of its force."""
    charged = ("theta", "x", 1), ("rate", "rate", 0), ("omega", "x", 4), ("omega", "y", 3)
    for sixth in (cost.Residual(weight, rows, (entry,)) for weight, rows, entry in charged):
        made = with_sixth(monkeypatch, sixth)
        assert made.compiled.implementation == "compiled"
        test_the_whole_qp_is_that_of_the_readable_step(made)


@pytest.mark.parametrize("near", [False, True], ids=["in the middle", "near the limits"])
def test_the_answer_is_that_of_the_readable_step(both, near):
    rng, answered = np.random.default_rng(6), 0
    for _ in range(6):
        x, u, d, feed, previous, _ = both.situation(rng, near)
        compiled = both.compiled(x, u, d[:-1], feed, previous, DAQP(), inf)
        readable = both.readable(x, u, d[:-1], feed, previous, DAQP(), inf)
        assert compiled.status == readable.status
        if compiled.status is PlanStatus.OPTIMAL:
            answered += 1
            np.testing.assert_allclose(compiled.u, readable.u, atol=200.0)  # Pa: the proof is of 500
            if compiled.motion is not None:
                motion = both.predictor.motion(x, compiled.u, d[:-1])
                np.testing.assert_allclose(compiled.motion.x, motion.x, rtol=1e-9, atol=1e-9)
                np.testing.assert_allclose(compiled.motion.K, motion.K, rtol=1e-9, atol=1e-9)
                np.testing.assert_allclose(compiled.motion.F, motion.F, rtol=1e-9, atol=1e-6)
    assert answered >= 3


def test_the_feed_forward_is_that_of_the_readable_one(both):
    rng = np.random.default_rng(7)
    for scale, still in ((1.0, False), (1.0, True), (3.0, False), (3.0, True)):  # 3.0: beyond what the arm can do
        _, _, d, _, _, (q, K) = both.situation(rng)
        q, d = (np.tile(preview[:1], (N + 1, 1)) if still else preview for preview in (q, d))
        readable, compiled = both.inverse(scale * q, scale * K, d), both.feed_forward(scale * q, scale * K, d)
        np.testing.assert_allclose(compiled.x, readable.x, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(compiled.y, readable.y, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(compiled.u, readable.u, rtol=1e-7, atol=1e-2)
        np.testing.assert_allclose(compiled.moved, readable.moved, rtol=1e-6, atol=1e-9)


def test_blocks_grow():
    arm = Arm.machine("arm26")
    assert usual_blocks(arm, 20) == (1, 1, 2, 4, 6, 6)
    assert usual_blocks(arm, 3) == (1, 1, 1)
    assert usual_blocks(arm, 30) == (1, 1, 2, 4, 6, 6, 6, 4)
    assert TrackingMPC(arm, N=14).blocks == (1, 1, 2, 4, 6)


@pytest.fixture(scope="module", params=[False, True], ids=["no gas", "gas"])
def both_of_two_joints(request):
    """Those of arm26: a structured QP takes a minute to compile for arm48."""
    return Both("arm26", gas=request.param)


@pytest.mark.slow
@pytest.mark.parametrize("near", [False, True], ids=["in the middle", "near the limits"])
def test_the_structured_solution_is_that_of_the_dense_qp(both_of_two_joints, near):
    """For all combinations of binding limits, without a call of DAQP."""
    both = both_of_two_joints
    rng, bound = np.random.default_rng(8), 0
    for _ in range(8):
        x, u, d, feed, previous, _ = both.situation(rng, near)
        answer = both.compiled(x, u, d[:-1], feed, previous, Riccati(), inf)
        model = both.predictor.linearise(x, both.problem.limits.limited(previous.u, u), d[:-1])
        exact = certified(DAQP(), condense(both.problem, model, feed, *previous), inf, both.problem.curvature)
        assert answer.status is exact.status is PlanStatus.OPTIMAL
        assert answer.qp is None  # nothing dense was built
        np.testing.assert_allclose(both.compiled.structured.z, exact.z[:-2], atol=1e-4)
        bound += exact.multipliers.any()
        motion = both.predictor.motion(x, answer.u, d[:-1])
        np.testing.assert_allclose(answer.motion.x, motion.x, rtol=1e-9, atol=1e-9)
    assert bound == 8


@pytest.mark.slow
def test_interrupted_it_keeps_slew_and_supply_and_bounds_what_that_costs(both_of_two_joints):
    both = both_of_two_joints
    rng, interrupted = np.random.default_rng(9), 0
    for n in range(6):
        x, u, d, feed, previous, _ = both.situation(rng, near=True)
        both.compiled.reset()
        answer = both.compiled(x, u, d[:-1], feed, previous, Riccati(exchanges=2 * n), inf)
        model = both.predictor.linearise(x, both.problem.limits.limited(previous.u, u), d[:-1])
        qp, z = condense(both.problem, model, feed, *previous), both.compiled.structured.z
        exact = certified(DAQP(), qp, inf, both.problem.curvature)
        assert ((qp.lower[:-2] - 1e-12 <= z) & (z <= qp.upper[:-2] + 1e-12)).all()
        if answer.status is PlanStatus.UNSOLVED:
            interrupted += 1
            beyond = qp.breaches(np.append(z, [0.0, 0.0]))
            slacks = [beyond[qp.R[:, i] != 0].max(initial=0.0) for i in (-2, -1)]
            assert qp.cost(np.append(z, slacks)) - qp.cost(exact.z) <= answer.gap * (1 + 1e-6)
    assert interrupted > 0
