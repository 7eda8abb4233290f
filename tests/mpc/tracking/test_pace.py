"""A controller that cannot keep the pace of its samples says so when it is built, once; others say nothing."""

import warnings
from time import perf_counter, sleep, thread_time

import pytest

from mpc import Plant, TrackingMPC
from mpc.tracking.pace import LongStep, check_pace
from mpc.tracking.qp.solvers import DAQP


@pytest.mark.parametrize("stiff", [{"inertia": 1e-6}, {"lag": 5e-6}], ids=["inertia", "lag"])
def test_a_plant_too_stiff_for_its_sample_time_is_said_with_the_measured_time_and_the_number(stiff):
    began = perf_counter()
    with pytest.warns(LongStep, match=r"a step takes .* ms, longer than its sample dt = 2 ms: the plant moves") as said:
        TrackingMPC(Plant(**stiff), dt=0.002, N=100)
    assert perf_counter() - began < 20.0
    assert (len(said), said[0].filename) == (1, __file__)
    [(name, value)] = stiff.items()
    assert f"{name} {value:g} " in str(said[0].message)
    assert "\n" not in str(said[0].message)


def test_a_horizon_too_long_for_its_sample_time_is_said():
    with pytest.warns(LongStep, match="a horizon shorter than N = 400, longer blocks or a longer dt take less") as said:
        TrackingMPC(Plant(), N=400, solver="daqp")
    assert (len(said), said[0].filename) == (1, __file__)


@pytest.mark.parametrize("options", [{}, {"N": 40}, {"N": 400}, {"budget": 0.01}, {"iterations": 3}])
def test_what_keeps_the_pace_is_built_quickly_and_says_nothing(options):
    TrackingMPC(Plant(), **options)  # compiled by now
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        began = perf_counter()
        TrackingMPC(Plant(), **options)
    assert perf_counter() - began < 2.0


def test_the_quickest_of_some_calls_counts_and_one_that_is_quick_is_enough():
    took = []

    def step():
        took.append(0.05 if len(took) < 2 else 0.0)
        until = thread_time() + took[-1]
        while thread_time() < until:
            pass
        sleep(0.04)  # while others have the processor

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
