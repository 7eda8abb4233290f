"""The whole step in one compiled call is the stages one by one, to the last bit, and leaves to them the rest."""

import pickle
import sys
from concurrent.futures import ThreadPoolExecutor
from copy import copy, deepcopy

import numpy as np
import pytest

from allocator import BAR, DEG
from allocator.errors import InvalidInput
from allocator.joint.hysteresis import PrandtlIshlinskii
from mpc import Compensation, KalmanObserver, PlanStatus, Plant, RealPlant, Rung, TrackingMPC, Weights
from mpc.codegen.tables import table_of
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.tracking.linearise import Motion
from mpc.tracking.preview import BadNumbers

pytestmark = pytest.mark.compiles

N = 12
REAL = RealPlant.standard()
SETTINGS = {
    "report": {},
    "blocks": {"blocks": (1, 1, 1, 1, 2, 2, 4)},
    "least forces": {"min_force": 30.0},
}


class Pair:
    """A controller with whole steps, and the same one that goes stage by stage."""

    def __init__(self, plant=None, **settings):
        plant = Plant() if plant is None else plant
        self.whole, self.staged = TrackingMPC(plant, N=N, **settings), TrackingMPC(plant, N=N, **settings)
        assert self.whole._whole is not None
        self.staged._whole = None
        self.x = plant.at_rest(0.0, 7.6)
        self.taken = []  # whether the whole step answered

    def step(self, x, theta, K, d=0.0):
        plan, wanted = self.whole.step(x, theta, K, d), self.staged.step(x, theta, K, d)
        self.taken.append(not self.whole._whole.behind)
        near = 0.0 if self.whole.compensation == Compensation() else 1e-9  # what is known is reckoned in another order
        assert (plan.moved is None) == (wanted.moved is None)
        for name in ("u", "x", "K", "slack", "slack_force") + ("moved",) * (plan.moved is not None):
            np.testing.assert_allclose(getattr(plan, name), getattr(wanted, name), rtol=near, atol=near)
        for name in ("u", "x", "K"):
            assert not getattr(plan, name).flags.writeable
        assert (plan.status, plan.rung) == (wanted.status, wanted.rung)
        np.testing.assert_array_equal(self.whole._qp_step.active_set, self.staged._qp_step.active_set)
        return plan


def reference(k, ahead=N):
    """A sine with jumps, of which slew and joint range take something."""
    t = 0.01 * (k + np.arange(ahead + 1))
    return 0.4 * np.sin(6.0 * t) + 1.2 * (np.floor(t / 0.4) % 3 == 2), 7.6 + 0.8 * (np.floor(t / 0.5) % 2 == 1)


@pytest.mark.parametrize("settings", SETTINGS.values(), ids=SETTINGS.keys())
def test_a_loop_of_whole_steps_is_that_of_the_stages(settings):
    pair, rng = Pair(**settings), np.random.default_rng(4)
    x, bound = pair.x, 0
    for k in range(120):
        plan = pair.step(x + rng.normal(size=4) * [1e-4, 1e-2, 2e3, 2e3], *reference(k), 0.5 * (k > 60))
        bound += np.abs(np.diff(plan.u, axis=0)).max() >= pair.whole.limits.step * (1 - 1e-6)
        x = plan.x[1]
    assert all(pair.taken)
    assert bound > 10


NOT_ORDINARY = {
    "no angle": (lambda x: [np.nan, *x[1:]], 0.1, 7.6, 0.0),
    "no pressure": (lambda x: [*x[:3], np.nan], 0.1, 7.6, 0.0),
    "a pressure that cannot be": (lambda x: [*x[:3], 9 * BAR], 0.1, 7.6, 0.0),
    "no reference": (lambda x: x, np.nan, 7.6, 0.0),
    "no stiffness": (lambda x: x, 0.1, -1.0, 0.0),
    "a preview with a gap": (lambda x: x, np.r_[np.zeros(N), np.nan], 7.6, 0.0),
    "a torque that is none": (lambda x: x, 0.1, 7.6, np.inf),
    "a torque beyond all numbers": (lambda x: x, 0.1, 7.6, 1e300),
}


@pytest.mark.parametrize("case", NOT_ORDINARY.values(), ids=NOT_ORDINARY.keys())
@pytest.mark.filterwarnings("ignore::mpc.tracking.preview.BadNumbers")
def test_what_is_not_ordinary_the_stages_answer_and_give_back(case):
    look, *rest = case
    pair = Pair()
    for k in range(20):
        odd = k in (5, 6, 11)
        x = pair.x + np.array([0.01 * np.sin(k), 0.0, 0.0, 0.0])
        pair.step(look(x.tolist()) if odd else x, *(rest if odd else reference(k)))
    assert [k for k, taken in enumerate(pair.taken) if not taken] == [5, 6, 11]


def test_the_first_step_may_be_one_that_is_not_ordinary():
    pair = Pair()
    pair.step([np.nan, 0.0, 3e5, 3e5], 0.1, 7.6)
    pair.step(pair.x, 0.1, 7.6)
    assert pair.taken == [False, True]


def test_whatever_type_a_number_has_the_step_is_the_same_one():
    pair, x = Pair(), Pair().x
    for theta, K, d in ((0.125, 8, 0), (np.float32(0.125), np.float64(8.0), np.float64(0.0)), ([0.125] * 13, 8.0, 0.0)):
        pair.step(tuple(x), theta, K, d)
        pair.step(x, np.full(N + 1, 0.125), np.full(2 * N + 2, 8.0)[::2], 0.0)
    assert all(pair.taken)


@pytest.mark.parametrize("x", [0.1, [0.0, 0.0, 1e5], np.zeros((2, 4)), "rest", None], ids=repr)
def test_a_wrong_shape_or_kind_is_an_error_of_either_way(x):
    pair = Pair()
    for controller in (pair.whole, pair.staged):
        with pytest.raises((InvalidInput, TypeError, ValueError)):
            controller.step(x, 0.1, 7.6)
    with pytest.raises(InvalidInput, match="theta_ref has the shape"):
        pair.whole.step(pair.x, np.zeros(1), 7.6)
    with pytest.raises(InvalidInput, match="d"):
        pair.whole.step(pair.x, 0.1, 7.6, np.zeros(2))
    pair.step(pair.x, 0.1, 7.6)


def test_a_warning_of_bad_numbers_names_who_called_the_step():
    with pytest.warns(BadNumbers) as said:
        Pair().whole.step(Plant().at_rest(0.0, 7.6), np.nan, 7.6)
    assert said[0].filename == __file__


def test_after_a_change_of_parts_or_settings_the_whole_step_is_not_used():
    pair = Pair()
    pair.step(pair.x, 0.1, 7.6)
    pair.whole.iterations = pair.staged.iterations = 3
    pair.step(pair.x, 0.1, 7.6)
    pair.whole.iterations = pair.staged.iterations = 1
    pair.step(pair.x, 0.1, 7.6)
    asked, solve = [], pair.whole._solve
    pair.whole._solve = lambda qp, limit: (asked.append(qp), None)[1]
    assert pair.whole.step(pair.x, 0.2, 7.6).rung is not Rung.QP
    assert asked
    pair.whole._solve = solve
    assert pair.whole.step(pair.x, 0.2, 7.6).rung is Rung.QP
    assert pair.taken == [True, False, True]


def test_a_step_that_is_late_leads_down_the_ladder_as_ever():
    pair = Pair()
    for k in range(8):
        late = k in (3, 4)
        pair.whole.budget = pair.staged.budget = 0.0 if late else None
        plan = pair.step(pair.x, *reference(k))
        assert (plan.status is PlanStatus.LATE) == late
    assert [k for k, taken in enumerate(pair.taken) if not taken] == [3, 4]


def test_copies_and_a_reset_go_on_as_the_stages_do():
    pair = Pair()
    for k in range(4):
        pair.step(pair.x, *reference(k))
    pair.whole, pair.staged = deepcopy(pair.whole), deepcopy(pair.staged)
    pair.staged._whole = None
    pair.step(pair.x, *reference(4))
    pair.whole = pickle.loads(pickle.dumps(pair.whole))
    pair.step(pair.x, *reference(5))
    pair.whole.reset(), pair.staged.reset()
    pair.step(pair.x, *reference(6))
    assert all(pair.taken)


def test_the_qp_that_is_shown_is_that_of_the_next_step():
    pair = Pair()
    for k in range(4):
        pair.step(pair.x, *reference(k))
    one, other = (controller.qp(pair.x, *reference(4)) for controller in (pair.whole, pair.staged))
    np.testing.assert_array_equal(one.H, other.H)
    np.testing.assert_array_equal(one.f, other.f)


def test_a_plan_is_the_same_value_however_it_is_looked_at():
    pair = Pair()
    plan = pair.whole.step(pair.x, 0.1, 7.6)
    for other in (pickle.loads(pickle.dumps(pair.whole.step(pair.x, 0.1, 7.6))), copy(plan), deepcopy(plan)):
        assert other.u.shape == (N, 2)
    assert repr(pair.whole.step(pair.x, 0.1, 7.6)).startswith("Plan: OPTIMAL by QP, ")
    np.testing.assert_array_equal(copy(plan).u, plan.u)
    assert plan.times.total > plan.times.solve > 0.0
    with pytest.raises(AttributeError, match="no 'v'"):
        _ = plan.v
    with pytest.raises(AttributeError):
        plan.rung = Rung.HOLD


@pytest.mark.parametrize("every", [1, 3, 100])
def test_whoever_looks_at_a_part_finds_what_the_stages_remember(every):
    pair = Pair(REAL.nominal, compensation=REAL.known())
    parts = [(c.ladder, c.rest_mode, c._preview) for c in (pair.whole, pair.staged)]  # held from the beginning
    x = REAL.at_rest(0.0, 5.5)
    for k in range(12):
        plan = pair.step(x, *moving(k, pair.whole.ahead))
        if k % every == 0 or k == 11:
            for name in ("motion", "u_star", "_left", "_held"):
                compare(*(getattr(ladder, name) for ladder, _, _ in parts))
            compare(*(rest_mode.numbers for _, rest_mode, _ in parts))
            for name in ("last_sent", "expected", "waiting", "_blind"):
                compare(*(getattr(preview, name) for *_, preview in parts))
            compare(*(preview.frictions[0].theta for *_, preview in parts))
            compare(*(preview.frictions[0].memory for *_, preview in parts))
        x = plan.x[1]
    assert all(pair.taken)


def compare(one, other):
    """Insist that two memories are equal, but for rounding."""
    if isinstance(one, Motion):
        for name in ("u", "x", "K", "F"):
            compare(getattr(one, name), getattr(other, name))
    else:
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


def test_a_step_that_fails_leaves_parts_and_state_as_they_were():
    pair = Pair()
    for k in range(3):
        pair.step(pair.x, *reference(k))
    whole = pair.whole._whole
    newest = whole._newest.out
    before = newest.copy(), pair.whole._qp_step.active_set
    theta, K = reference(3)
    for ask in ((np.full(4, np.nan), theta, K, 0.0), (pair.x, theta, K, 1e300), (pair.x, theta[1:], K, 0.0)):
        assert whole.plan(*ask, 0.0, np.inf) is None
    assert whole.plan(pair.x, theta, K, 0.0, 0.0, 0.0) is None  # late
    assert whole._newest.out is newest
    np.testing.assert_array_equal(newest, before[0])
    np.testing.assert_array_equal(pair.whole._qp_step.active_set, before[1])
    pair.step(pair.x, theta, K)
    assert all(pair.taken)


def test_previews_in_strides_and_ones_that_cannot_be_written_are_read_as_they_are():
    pair, (theta, K) = Pair(), reference(5)
    wide = np.zeros((N + 1, 3))
    wide[:, 0], wide[:, 2] = theta, K
    wide.setflags(write=False)
    state = np.repeat(pair.x, 2)[::2]
    state.setflags(write=False)
    np.testing.assert_array_equal(pair.step(state, wide[:, 0], wide[:, 2]).u, Pair().step(pair.x, theta, K).u)
    assert all(pair.taken)


def test_the_table_takes_no_array_that_does_not_lie_there_as_it_is_read():
    inputs = Pair().whole._whole._arrays._inputs
    assert table_of(inputs).dtype.names == inputs._fields
    for wrong in (inputs.asked.astype(np.float32), np.zeros(8)[::2]):
        with pytest.raises(TypeError, match="in one piece"):
            table_of(inputs._replace(asked=wrong))


# --- dead time, friction, dead band -----------------------------------------------------------------------------------

KNOWN = {
    "standard": REAL.known(),
    "Maxwell slip": Compensation(MaxwellSlip.of_width(REAL.nominal, 4 * DEG), 0.02, 0.1 * BAR),
    "hysteresis of the angle": Compensation(PrandtlIshlinskii((0.7, 0.2, 0.1), (0.01, 0.03)), 0.0, 0.05 * BAR),
    "dead time": Compensation(dead_time=0.03),
    "dead band": Compensation(dead_band=0.1 * BAR),
    "Coulomb friction": Compensation(Friction(coulomb=0.2)),
}


def moving(k, ahead):
    """A sine that begins and ends at rest, with a jump."""
    t = np.minimum(0.01 * (k + np.arange(ahead + 1)), 1.6)
    return 0.3 * np.sin(5.0 * t) * np.minimum(t, 1.0) + 0.3 * (t > 1.1), np.full(ahead + 1, 5.5)


@pytest.mark.parametrize("known", KNOWN.values(), ids=KNOWN.keys())
def test_with_what_is_known_of_a_real_joint_the_whole_step_is_that_of_the_stages(known):
    pair = Pair(REAL.nominal, compensation=known, weights=Weights.calm())
    observer = KalmanObserver(REAL.nominal, 0.01, compensation=known)
    x0 = REAL.at_rest(0.0, 5.5)
    experiment, u = REAL.begin(0.01, x0, 3), x0[2:]
    silent = {60, 61, 62, *range(90, 125)}  # for a moment, and until the controller is blind
    for k in range(230):
        x, d = observer.estimate(np.where(k in silent, np.nan, experiment.measure()), u)
        u = pair.step(x, *moving(k, pair.whole.ahead), d).u[0]
        experiment.advance(u)
    taken = np.array(pair.taken)
    assert taken[:90].mean() > 0.9
    assert taken[126:150].all()
    assert taken[126:].all()


def test_friction_of_an_own_kind_is_left_to_the_stages():
    class Own(Friction):
        """A friction that the compiled step does not know."""

    mpc = TrackingMPC(REAL.nominal, N=N, compensation=Compensation(Own(mu=0.1)))
    assert mpc._whole is None
    assert mpc.step(REAL.at_rest(0.0, 5.5), 0.1, 5.5).rung is Rung.QP


def test_a_swing_that_rings_is_that_of_the_stages():
    pair = Pair(REAL.nominal, compensation=REAL.known())
    x, ahead, ringing = REAL.at_rest(0.0, 5.5), pair.whole.ahead, []
    for k in range(400):
        held = k < 380
        theta = np.zeros(ahead + 1) if held else 0.01 * (k - 379 + np.arange(ahead + 1))
        pair.step(x + np.array([0.02 * np.sin(0.3 * k), 0.0, 0.0, 0.0]), theta, 5.5)
        assert pair.whole.rest_mode.ringing == pair.staged.rest_mode.ringing
        ringing.append(pair.whole.rest_mode.ringing)
    assert all(pair.taken)
    assert any(ringing)
    assert not ringing[-1]


@pytest.mark.parametrize("known", [KNOWN["standard"], KNOWN["dead band"]], ids=["standard", "dead band"])
def test_a_rest_with_its_corrections_is_that_of_the_stages(known):
    pair, rng = Pair(REAL.nominal, compensation=known, weights=Weights.calm()), np.random.default_rng(2)
    x, held, error = REAL.at_rest(0.3, 5.5), [], 0.0
    for k in range(600):
        error += (k > 330) * (0.05 * DEG * np.sin(k / 50) + 0.05 * DEG - error) / 40
        noise = rng.normal(size=4) * np.array([1e-5, 0.0, 200.0, 200.0])
        plan = pair.step(x + noise + error * np.eye(4)[0], 0.3, 5.5)
        held.append(plan.u[0] if plan.status is PlanStatus.RESTING else np.zeros(2))
    assert all(pair.taken)
    assert (np.array(held)[-50:] > 0).all()
    assert len(np.unique(np.array(held)[:, 0])) > 2  # corrected
    pushed = pair.step(x + np.array([1 * DEG, 0.0, 0.0, 0.0]), 0.3, 5.5)
    assert pushed.status is PlanStatus.OPTIMAL
    assert all(pair.taken)


def test_threads_that_share_a_controller_get_plans_from_their_own_states():
    shared, often = TrackingMPC(Plant(), N=N), sys.getswitchinterval()

    def begun(k):
        x = np.array([0.1 + 0.001 * (k % 50), 0.0, 3e5, 2e5])
        return np.abs(shared.step(x, theta_ref=0.2, K_ref=7.6).x[0] - x).max()

    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(8) as threads:
            assert max(threads.map(begun, range(5000))) < 1e-9
    finally:
        sys.setswitchinterval(often)
    assert pickle.loads(pickle.dumps(shared))._turns is not shared._turns
    assert deepcopy(shared)._turns is not shared._turns
