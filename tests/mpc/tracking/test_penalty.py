"""The soft limits are exact: where the hard ones can be kept, nothing is different."""

from math import inf

import numpy as np
import pytest

from allocator.joint.antagonist import report_joint
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc import Plant, TrackingMPC, Weights
from mpc.tracking.qp.solvers import solver
from tests.mpc.tracking.hard_limits import hard_solutions

pytestmark = pytest.mark.compiles

MARGIN = 10.0  # of the default weights above the largest sum of multipliers
SAROSI = Plant(report_joint(SAROSI_DMSP_20_400N), lag=0.12)
LOOPS = {
    "report's muscles": (Plant(), {}),
    "Sarosi's muscles": (SAROSI, {}),
    "Sarosi's muscles, calm": (SAROSI, {"weights": Weights.calm()}),
    "blocked": (Plant(), {"blocks": (1, 1, 1, 1, 2, 2, 4, 8)}),
    "10 N at least": (Plant(), {"min_force": 10.0}),
}


@pytest.fixture(scope="module", params=LOOPS.values(), ids=LOOPS.keys())
def controller(request):
    plant, options = request.param
    return TrackingMPC(plant, **options)


@pytest.fixture(scope="module")
def solved(controller):
    """Over 250 states near the limits, of which the hard limits can be kept from about half."""
    return list(hard_solutions(controller, 250, seed=1))


def test_the_default_weights_exceed_the_multipliers_of_the_hard_limits_by_a_margin(controller, solved):
    theta, force = (max(getattr(hard, name) for hard in solved) for name in ("theta", "force"))
    assert 0 < MARGIN * theta < controller.weights.slack
    assert 0 < MARGIN * force < controller.weights.slack_force


def test_the_soft_problem_has_the_hard_one_s_solution_whenever_there_is_one(solved):
    bound = 0
    for hard in solved:
        z, _ = solver("daqp")(hard.qp, inf)
        np.testing.assert_allclose(z, hard.z, atol=1e-7)
        bound += hard.theta > 0 or hard.force > 0
    assert len(solved) > 80
    assert bound > 10
