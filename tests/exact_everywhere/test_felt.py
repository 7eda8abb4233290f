"""No pressures are better than the answers for felt stiffness: a dense search in every geometry, a few targets each.

The whole comparison for affine muscles is `python -m benchmarks.felt allocation`.
"""

import numpy as np
import pytest

from allocator import DEG, AntagonistJoint, PrandtlIshlinskii
from benchmarks.felt.allocation import GEOMETRIES, LOOPS, PRIORITIES, muscle_of, verdict
from benchmarks.felt.dense import Reach, judged, targets

PAIRINGS = {"equal": ("Sarosi2012", "Sarosi2012"), "different": ("MartensBoblan2017", "TonduLopez1995")}


@pytest.mark.slow
@pytest.mark.parametrize("geometry", GEOMETRIES)
@pytest.mark.parametrize("pairing", PAIRINGS)
def test_no_felt_answer_is_beaten(pairing, geometry):
    for k, loop in enumerate(LOOPS):
        case = PAIRINGS[pairing], geometry, (0.7 * DEG, 2 * DEG, 6 * DEG)[k], loop, "shut" if k == 1 else "open"
        n, beaten, unequalled, outside, worst = verdict(case, angles=2, each=20, seed=4)
        assert n > 0
        assert (beaten, unequalled, outside) == (0, 0, 0), f"by {worst:.1e}"


CURVED = "Tondu2021", "TonduLopez2000", "Wickramatunge2010"
CONSTANT = PrandtlIshlinskii((0.7, 0.2, 0.1), (1 * DEG, 4 * DEG), stiffness=5.0)


@pytest.mark.slow
@pytest.mark.parametrize("muscle", CURVED)
def test_no_felt_answer_of_curved_laws_with_constant_springs_is_beaten(muscle):
    mechanism, stops = GEOMETRIES["pulley"]
    one = muscle_of(muscle)
    joint, rng = AntagonistJoint(mechanism, one, one, angle_limits=stops, hysteresis=CONSTANT), np.random.default_rng(5)
    for theta in (-0.4, 0.15):
        reach = Reach(joint, theta, 2 * DEG)
        T, K = targets(reach, 20, rng)
        for priority in PRIORITIES:
            found = judged(reach, T, K, priority)
            assert found.excess.max() <= 1e-8
            assert found.equalled.all()
            assert found.inside.all()
