"""Answers are optimal, proved by what this library did not compute: faces, multipliers, directions, another solver."""

import numpy as np
import pytest

from allocator import Limits, Status, allocate, warm_up
from allocator.allocation.box.arguments import problem_from
from allocator.mechanism import Mechanism, Pulleys, Sites, machines
from allocator.mechanism.routes import Link
from allocator.muscles.catalogue import SAROSI_DMSP_20_200N, SAROSI_DMSP_20_400N
from allocator.units import BAR

from .enumeration import best_of_all_faces
from .multipliers import kkt_by_hand

ARM = machines.arm26()
LIMITED = (Status.TORQUE_LIMITED, Status.STIFFNESS_LIMITED, Status.BOTH_LIMITED)


def random_targets(mechanism, q, N, seed=0):
    """N targets (T, K) at a posture: half made by pressures, half far off."""
    rng = np.random.default_rng(seed)
    lo, hi = mechanism.pressure_box(q)
    P = rng.uniform(lo, hi, (N, mechanism.m))
    T, K = mechanism.torque(q, P), mechanism.stiffness(q, P)
    half = N // 2
    T[half:] = T[half:] * rng.uniform(1, 4, (N - half, 1))
    K[half:] *= rng.uniform(0.4, 2.5, (N - half, 1, 1))
    return T, K


def random_mechanism(n, m, seed=0):
    """Pulleys with arms at one to three joints each, every joint with muscles of both signs."""
    rng = np.random.default_rng(seed)
    arms = np.zeros((m, n))
    for j in range(m):
        arms[j, j % n] = 0.02 * (1 if (j // n) % 2 == 0 else -1) * rng.uniform(0.7, 1.3)
        for other in rng.choice(n, size=min(n, int(rng.integers(0, 3))), replace=False):
            arms[j, other] += rng.uniform(-0.015, 0.015)
    return Mechanism(Pulleys(0.4, arms, 0.1375), SAROSI_DMSP_20_400N)


def as_least_squares(mechanism, q, T, K, priority="torque", weights=None, previous=None):
    asked = {"limits": Limits(min_force=0.0, max_force=None, previous=previous, max_step=None)}
    problem, _ = problem_from(mechanism, q, K, T, priority=priority, weights=weights, **asked)
    return problem


@pytest.mark.parametrize(
    ("priority", "weights"), [("torque", None), ("stiffness", None), ("weighted", (1e4, 1.0)), ("weighted", (1.0, 3.0))]
)
@pytest.mark.parametrize("near", [False, True], ids=["least", "nearest to the previous"])
def test_no_face_of_the_box_has_a_better_answer(priority, weights, near):
    q = np.array([0.4, -0.3])
    T, K = random_targets(ARM, q, 40)
    previous = np.array([2.0, 3, 2, 4, 3, 1]) * BAR if near else None
    a = allocate(q, K, T, joint=ARM, priority=priority, weights=weights, limits=Limits(previous=previous))
    p = as_least_squares(ARM, q, T, K, priority, weights, previous)
    (_, ends), (lo, hi, centre) = p.rows, p.x_bounds
    expected = best_of_all_faces(p.A[0], p.b, ends, lo[0], hi[0], centre[0])
    assert a.P / p.unit == pytest.approx(expected, abs=1e-9)
    assert 5 < (a.status == 0).sum() < 35


@pytest.mark.slow
def test_no_face_has_a_better_answer_for_a_thousand_targets():
    q = np.array([0.4, -0.3])
    T, K = random_targets(ARM, q, 1000, seed=5)
    a = allocate(q, K, T, joint=ARM)
    p = as_least_squares(ARM, q, T, K)
    (_, ends), (lo, hi, centre) = p.rows, p.x_bounds
    expected = best_of_all_faces(p.A[0], p.b, ends, lo[0], hi[0], centre[0])
    assert a.P / p.unit == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(("n", "m"), [(2, 6), (3, 9), (4, 12), (7, 20)])
def test_the_optimality_conditions_hold(n, m):
    mechanism = ARM if m == 6 else random_mechanism(n, m)
    q = np.full(n, 0.1)
    T, K = random_targets(mechanism, q, 60 if n < 7 else 12, seed=2)
    a = allocate(q, K, T, joint=mechanism)
    p = as_least_squares(mechanism, q, T, K)
    assert kkt_by_hand(p, a.P / p.unit).max() < 1e-9
    assert a.kkt_residual.max() < 1e-12
    lo, hi = a.box
    assert ((a.P >= lo) & (a.P <= hi)).all()
    made = len(T) // 2
    assert a.success[:made].all()
    assert not a.success[made:].all()


@pytest.mark.slow
def test_thousands_of_targets_half_of_them_beyond_reach():
    q = np.array([0.4, -0.3])
    T, K = random_targets(ARM, q, 4000, seed=1)
    assert warm_up(joint=ARM)
    a = allocate(q, K, T, joint=ARM)
    p = as_least_squares(ARM, q, T, K)
    assert a.kkt_residual.max() < 1e-12
    some = slice(None, None, 4)
    part = as_least_squares(ARM, q, T[some], K[some])
    assert kkt_by_hand(part, a.P[some] / p.unit).max() < 1e-9
    assert a.success[:2000].all()
    assert (~a.success).sum() > 1600
    check_separations(a, ARM, q, T, K)


def check_separations(a, mechanism, q, T, K):
    """Three lines for every target beyond reach, and none for the others."""
    y0, M = mechanism.targets_map(q)
    lo, hi = mechanism.pressure_box(q)
    y = mechanism.stacked(T, K)
    beyond = np.isin(a.status, LIMITED)
    d = a.separation.direction[beyond]
    reach = d @ y0 + np.maximum((d @ M) * lo, (d @ M) * hi).sum(axis=1)
    assert (reach < (d * y[beyond]).sum(axis=1)).all()
    assert reach == pytest.approx(a.separation.reach[beyond], rel=1e-12, abs=1e-12)
    assert np.abs(d).max(axis=1) == pytest.approx(1.0)
    assert np.isnan(a.separation.reach[~beyond]).all()
    return beyond.sum()


@pytest.mark.parametrize("priority", ["torque", "stiffness", "weighted"])
def test_what_is_beyond_reach_is_proved_so(priority):
    q = np.array([0.2, 0.5])
    T, K = random_targets(ARM, q, 100, seed=4)
    a = allocate(q, K, T, joint=ARM, priority=priority, weights=(2.0, 1.0) if priority == "weighted" else None)
    assert check_separations(a, ARM, q, T, K) > 30


@pytest.mark.parametrize(("priority", "weights"), [("torque", None), ("stiffness", None), ("weighted", (1e2, 1.0))])
def test_daqp_finds_the_same(priority, weights):
    rng = np.random.default_rng(8)
    q = rng.uniform(-0.8, 0.8, (40, 2))
    T, K = random_targets(ARM, np.array([0.4, -0.3]), 40)
    exact = allocate(q, K, T, joint=ARM, priority=priority, weights=weights)
    daqp = allocate(q, K, T, joint=ARM, priority=priority, weights=weights, method="qp")
    assert daqp.P == pytest.approx(exact.P, abs=1e-7 * 5 * BAR)
    assert np.array_equal(daqp.status, exact.status)


@pytest.mark.slow
def test_compiled_and_plain_python_give_the_same():
    from allocator.allocation.box import kernel
    from allocator.allocation.box.kernel.data import workspace
    from allocator.allocation.box.pivoting import solve

    T, K = random_targets(ARM, np.array([0.4, -0.3]), 30)
    p = as_least_squares(ARM, np.array([0.4, -0.3]), T, K)
    assert warm_up(joint=ARM)
    compiled = solve(p)
    (_, ends), (lo, hi, centre) = p.rows, p.x_bounds
    x, mu, rounds = np.empty_like(lo), np.empty_like(compiled.mu), np.zeros(len(lo), np.int64)
    targets = p.A, p.b, np.zeros(5, bool), ends, lo, hi, centre, p.which
    kernel.allocate_batch(*targets, False, x, np.zeros((len(lo), 11), np.int8), mu, rounds, workspace(5, 6, 2))
    assert x == pytest.approx(compiled.x, abs=1e-12)
    assert np.array_equal(rounds, compiled.rounds)


def test_a_trajectory_gets_the_same_answers_in_fewer_rounds():
    t = np.linspace(0, 1, 60)
    q = 0.5 * np.stack([np.sin(2 * np.pi * t), np.cos(2 * np.pi * t)], axis=-1)
    K = np.array([[18.0, 5.0], [5.0, 12.0]])
    alone = allocate(q, K[None], [6.0, 3.0], joint=ARM)
    along = allocate(q, K[None], [6.0, 3.0], joint=ARM, along=0)
    assert along.P == pytest.approx(alone.P, abs=1e-9 * 5 * BAR)
    assert along.rounds.mean() < 0.7 * alone.rounds.mean()


def test_torque_is_never_given_up_for_stiffness():
    """Equalities, not weights: where the torques can be had they are, to rounding, however far the stiffness is."""
    q = np.array([0.4, -0.3])
    rng = np.random.default_rng(6)
    P = rng.uniform(*ARM.pressure_box(q), (50, 6))
    T = ARM.torque(q, P)
    a = allocate(q, np.diag([40.0, 35.0])[None], T, joint=ARM)
    assert (a.status == Status.STIFFNESS_LIMITED).all()
    assert np.abs(a.T_error).max() < 1e-12 * np.abs(T).max()


def test_only_the_asked_entries_count():
    q = [0.4, -0.3]
    own = allocate(q, [10.0, 9.0], [9.0, 4.0], joint=ARM)
    assert own.success
    assert np.diag(own.K) == pytest.approx([10.0, 9.0])
    assert np.isnan(own.K_error[0, 1])
    whole = allocate(q, np.diag([10.0, 9.0]), [9.0, 4.0], joint=ARM)
    assert abs(whole.K[0, 1]) < abs(own.K[0, 1])
    assert not whole.success  # taut biarticular muscles couple the joints
    number = allocate(q, 9.5, [9.0, 4.0], joint=ARM)
    assert np.diag(number.K) == pytest.approx([9.5, 9.5])
    twice = allocate(q, np.diag([10.0, 9.0]), [9.0, 4.0], joint=ARM, weights=(1.0, [[1.0, 0.0], [0.0, 1.0]]))
    assert twice.P == pytest.approx(own.P, rel=1e-12)


def test_previous_pressures_choose_among_equals():
    q, P = np.array([0.4, -0.3]), np.array([3, 2, 2.5, 3.5, 4, 1.5]) * BAR
    T, K = ARM.torque(q, P), ARM.stiffness(q, P)
    assert allocate(q, K, T, joint=ARM, limits=Limits(previous=P)).P == pytest.approx(P, rel=1e-10)
    least = allocate(q, K, T, joint=ARM)
    assert (least.P**2).sum() < (P**2).sum()
    held = allocate(q, K + np.eye(2), T, joint=ARM, limits=Limits(previous=P, max_step=0.2 * BAR))
    assert np.abs(held.P - P).max() <= 0.2 * BAR * (1 + 1e-12)
    assert any("rate" in name for name in held.active)


def test_two_muscles_side_by_side_share_the_load():
    """Equal columns leave the first levels undecided: the last one decides, equally."""
    arms = [(0.02,), (0.02,), (-0.02,)]
    a = allocate([0.1], 11.0, 2.0, joint=Mechanism(Pulleys(0.4, arms, 0.1375), SAROSI_DMSP_20_400N))
    assert a.success
    assert a.P[0] == pytest.approx(a.P[1], rel=1e-12)


def test_a_posture_that_does_not_hold_itself_says_so():
    """Muscles that end far beyond the axis push over whatever they pull on: bends outweigh their own stiffness."""
    paths = [[(-1, (x, -0.15)), (0, (x, 0.15))] for x in (0.005, -0.005)]
    mechanism = Mechanism(Sites(0.35, [Link()], paths), SAROSI_DMSP_20_400N)
    a = allocate([0.0], 5.0, 0.0, joint=mechanism, limits=Limits(min_force=50.0))
    assert a.status == Status.UNSTABLE
    assert not a.holds
    assert a.least_stiffness < 0
    assert mechanism.stiffness([0.0], a.P)[0, 0] == pytest.approx(a.least_stiffness)
    assert "does not hold itself" in a.message


def test_limits_that_leave_nothing_have_their_status():
    q = [0.4, -0.3]
    slack = allocate(q, 9.0, 1.0, joint=ARM, limits=Limits(min_force=3000.0))
    assert slack.status == Status.SLACK
    kept = allocate(q, 9.0, 1.0, joint=ARM, limits=Limits(min_force=[200.0, 0, 0, 0, 0, 0]))
    assert kept.forces[0] >= 200.0 - 1e-9
    away = allocate(q, 9.0, 1.0, joint=ARM, limits=Limits(previous=np.zeros(6), max_step=0.1 * BAR))
    assert away.status == Status.SLACK
    stretched = allocate([-1.0, -1.0], 9.0, 1.0, joint=ARM)
    assert stretched.status != Status.OUTSIDE_JOINT_RANGE
    far = allocate([-1.5, 0.0], 9.0, 1.0, joint=ARM)
    assert far.status == Status.OUTSIDE_JOINT_RANGE
    assert "shoulder range" in far.active


def test_different_muscles_and_unequal_lengths():
    routes = Pulleys([0.4, 0.3, 0.35], [(0.02,), (-0.015,), (-0.01,)], [0.12, 0.15, 0.1])
    mechanism = Mechanism(routes, (SAROSI_DMSP_20_400N, SAROSI_DMSP_20_200N, SAROSI_DMSP_20_400N))
    P = np.array([3.0, 2.5, 3.5]) * BAR
    a = allocate([0.2], mechanism.stiffness([0.2], P), mechanism.torque([0.2], P), joint=mechanism)
    assert a.success
    assert (a.P**2).sum() <= (P**2).sum()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_targets_at_corners_of_the_box_are_proved_too(seed):
    """Dependent columns, corners moved by a millionth, weights a million apart: where rounding may decide wrongly."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    m = int(rng.integers(n, 3 * n + 3))
    arms = rng.choice([0, 0, 0.02, -0.02, 0.015, -0.015], size=(m, n))
    arms[:, 0] += np.where(arms.any(axis=1), 0.0, 0.02)
    mechanism, q = Mechanism(Pulleys(0.4, arms, 0.1375), SAROSI_DMSP_20_400N), rng.uniform(-0.3, 0.3, n)
    lo, hi = mechanism.pressure_box(q)
    P = lo + np.round(rng.uniform(0, 1, (60, m)) * (1 + seed % 2)) / (1 + seed % 2) * (hi - lo)
    T, K = mechanism.torque(q, P), mechanism.stiffness(q, P)
    K = K + 1e-6 * np.abs(K).max() * np.eye(n)
    asked = ({"priority": "torque"}, {"priority": "stiffness"}, {"priority": "weighted", "weights": (900.0, 1.0)})
    for options in asked:
        a = allocate(q, K, T, joint=mechanism, **options)
        assert a.kkt_residual.max() < 1e-9
        missed = ~(a.torque_met & a.stiffness_met)
        assert np.array_equal(missed, a.separation.reach < a.separation.asked)


def test_fields_that_are_computed_later_are_those_of_the_targets_that_were_asked():
    """The caller reuses the arrays of the targets, as a loop does."""
    q, K, T = np.full((3, 2), 0.2), np.full((3, 2), 8.0), np.full((3, 2), 1.0)
    previous = np.full((3, 6), 1.5 * BAR)
    wanted = allocate(q.copy(), K.copy(), T.copy(), joint=ARM, limits=Limits(previous=previous.copy()))
    found = allocate(q, K, T, joint=ARM, limits=Limits(previous=previous))
    for array, other in ((q, 5.0), (K, 60.0), (T, 40.0), (previous, 4 * BAR)):
        array[:] = other
    for name in ("status", "kkt_residual", "T", "K", "theta", "T_error", "K_error", "lower_bounds"):
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name), err_msg=name)
    assert (found.P == wanted.P).all()
