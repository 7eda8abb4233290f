"""No pressures are better than the answers for felt stiffness: a dense search in every geometry, a few targets each.

The whole comparison is `python -m benchmarks.felt allocation`.
"""

import pytest

from allocator import DEG
from benchmarks.felt.allocation import GEOMETRIES, LOOPS, verdict

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
