"""Controllers and observers travel to other processes, and go on there to the last bit."""

import pickle
import subprocess
import sys
from copy import deepcopy
from functools import cache
from multiprocessing import get_context

import numpy as np
import pytest

from allocator import BAR
from mpc import Compensation, KalmanObserver, NonlinearMPC, Plant, TrackingMPC
from mpc.yardsticks.baselines import FeedForwardControl, LQRControl, PIDControl, PredictivePIDControl

pytestmark = pytest.mark.compiles

PLANT, K = Plant(), 7.6
KNOWN = Compensation(dead_time=0.02, dead_band=0.05 * BAR)
MADE = {
    "TrackingMPC": lambda: TrackingMPC(PLANT, N=12, compensation=KNOWN),
    "TrackingMPC, budget, clarabel": lambda: TrackingMPC(PLANT, N=5, budget=10.0, solver="clarabel"),
    "NonlinearMPC": lambda: NonlinearMPC(PLANT, N=5, compensation=KNOWN),
    "FeedForwardControl": lambda: FeedForwardControl(PLANT, compensation=KNOWN),
    "PIDControl": lambda: PIDControl(PLANT, compensation=KNOWN),
    "PredictivePIDControl": lambda: PredictivePIDControl(PLANT, compensation=KNOWN),
    "LQRControl": lambda: LQRControl(PLANT, compensation=KNOWN),
}
REST = PLANT.at_rest(0.0, K)


def went_on(pair, first, last):
    """Commands and states of the loop of controller, observer and a joint that is shaken, over some samples."""
    controller, observer, u = pair
    said = []
    for k in range(first, last):
        shaken = REST + np.array([0.02 * np.sin(k), np.nan, *(np.cos(k + np.arange(2)) * 0.1 * BAR)])
        x, d = observer.estimate(shaken, u)
        plan = controller.step(x, 0.2 + 0.4 * (k > 6), K, d)
        u = plan.u[0]
        said += [*x, d, *plan.u.ravel()]
    return np.array(said), (controller, observer, u)


@cache
def begun(name):
    """A loop in the middle, as bytes and as a copy, and how it goes on."""
    pair = went_on((MADE[name](), KalmanObserver(PLANT, 0.01, compensation=KNOWN), REST[2:]), 0, 5)[1]
    pickled, copied = pickle.dumps(pair), deepcopy(pair)
    return pickled, copied, went_on(pair, 5, 12)[0]


@pytest.mark.parametrize("name", MADE)
def test_what_was_pickled_goes_on_in_the_same_way(name):
    pickled, _, wanted = begun(name)
    assert (went_on(pickle.loads(pickled), 5, 12)[0] == wanted).all()


@pytest.mark.parametrize("name", MADE)
def test_a_deep_copy_goes_on_in_the_same_way_and_shares_no_memory(name):
    _, copied, wanted = begun(name)
    assert (went_on(deepcopy(copied), 5, 12)[0] == wanted).all()
    assert (went_on(copied, 5, 12)[0] == wanted).all()


ELSEWHERE = """
import pickle, sys
sys.path.insert(0, sys.argv[1])
from test_copies import went_on
pairs = pickle.load(sys.stdin.buffer)
sys.stdout.buffer.write(pickle.dumps([went_on(pickle.loads(pair), 5, 12)[0] for pair in pairs]))
"""


@pytest.mark.slow
def test_in_a_fresh_process_it_goes_on_in_the_same_way():
    pickled = pickle.dumps([begun(name)[0] for name in MADE])
    command = [sys.executable, "-W", "error", "-c", ELSEWHERE, str(__file__).rpartition("/")[0]]
    ran = subprocess.run(command, input=pickled, capture_output=True, check=False, timeout=300)
    assert ran.returncode == 0, ran.stderr.decode()
    for name, said in zip(MADE, pickle.loads(ran.stdout), strict=True):
        assert (said == begun(name)[2]).all(), name


def test_workers_that_are_spawned_can_be_given_a_controller():
    controller = TrackingMPC(PLANT, N=12)
    with get_context("spawn").Pool(1) as pool:
        [plan] = pool.starmap(controller.step, [(REST, 0.3, K)])
    assert (plan.u == controller.step(REST, 0.3, K).u).all()
