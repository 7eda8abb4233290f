"""The whole step in one compiled call is the stages one by one, to the last bit, and leaves to them the rest."""

import pickle
from copy import copy, deepcopy

import numpy as np
import pytest

from allocator import BAR
from allocator.errors import InvalidInput
from mpc import PlanStatus, Plant, Rung, TrackingMPC
from mpc.tracking.preview import BadNumbers

N = 12
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
        for name in ("u", "x", "K"):
            np.testing.assert_array_equal(getattr(plan, name), getattr(wanted, name))
            assert not getattr(plan, name).flags.writeable
        assert (plan.status, plan.rung, plan.slack, plan.slack_force) == (
            wanted.status, wanted.rung, wanted.slack, wanted.slack_force,
        )  # fmt: skip
        assert plan.moved == wanted.moved
        np.testing.assert_array_equal(self.whole._qp_step.active_set, self.staged._qp_step.active_set)
        return plan


def reference(k):
    """A sine with jumps, of which slew and joint range take something."""
    t = 0.01 * (k + np.arange(N + 1))
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
    assert repr(pair.whole.step(pair.x, 0.1, 7.6)).startswith("Plan(u=array(")
    np.testing.assert_array_equal(copy(plan).u, plan.u)
    assert plan.times.total > plan.times.solve > 0.0
    with pytest.raises(AttributeError, match="no 'v'"):
        _ = plan.v
    with pytest.raises(AttributeError):
        plan.rung = Rung.HOLD
