"""A controller that cannot keep the pace of its samples says so when it is built, once; others say nothing."""

import warnings

import pytest

from mpc import Plant, TrackingMPC
from mpc.tracking import controller
from mpc.tracking.controller import LongStep, check_pace
from mpc.tracking.qp.solvers import DAQP

pytestmark = pytest.mark.compiles


@pytest.fixture
def tick(monkeypatch):
    """Let every step take these seconds of a clock of our own, from the next one on."""
    now, took = [0.0], [0.0]

    def clock():
        now[0] += took[0]
        return now[0]

    monkeypatch.setattr(controller, "thread_time", clock)
    return lambda seconds: took.__setitem__(0, seconds)


@pytest.mark.parametrize("stiff", [{"inertia": 1e-6}, {"lag": 5e-6}], ids=["inertia", "lag"])
def test_a_plant_too_stiff_for_its_sample_time_is_said_with_the_measured_time_and_the_number(stiff, tick):
    tick(0.003)
    with pytest.warns(LongStep, match=r"a step takes 3 ms, longer than its sample dt = 2 ms: the plant moves") as said:
        TrackingMPC(Plant(**stiff), dt=0.002, N=100)
    assert (len(said), said[0].filename) == (1, __file__)
    [(name, value)] = stiff.items()
    assert f"{name} {value:g} " in str(said[0].message)
    assert "\n" not in str(said[0].message)


def test_a_horizon_too_long_for_its_sample_time_is_said(tick):
    tick(0.011)
    with pytest.warns(LongStep, match="a horizon shorter than N = 400, longer blocks or a longer dt take less") as said:
        TrackingMPC(Plant(), N=400, solver="daqp")
    assert (len(said), said[0].filename) == (1, __file__)


@pytest.mark.parametrize("options", [{}, {"N": 40}, {"N": 400}, {"budget": 0.01}, {"iterations": 3}])
def test_what_keeps_the_pace_says_nothing(options, tick):
    tick(0.009)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        TrackingMPC(Plant(), **options)


def test_the_quickest_of_some_calls_counts_and_one_that_is_quick_is_enough(tick):
    took = []

    def step():
        took.append(0.05 if len(took) < 2 else 0.0)
        tick(took[-1])

    check_pace(step, Plant(), 0.03, 20)
    assert len(took) == 3
    check_pace(step, Plant(), 0.03, 20)
    assert len(took) == 4


def test_building_leaves_nothing_behind():
    seen = []
    controller = TrackingMPC(Plant(), N=5, solver=lambda qp, limit: (seen.append(qp), DAQP()(qp, limit))[1])
    assert seen
    first = controller.step(Plant().at_rest(0.0, 7.6), 0.0, 7.6)
    assert (first.u[0] == controller.limits.limited(Plant().at_rest(0.0, 7.6)[2:], first.u)[0]).all()
    assert controller.budget is None
