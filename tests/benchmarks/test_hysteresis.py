"""What the benchmark of told hysteresis says, on one seed."""

import numpy as np
import pytest

from allocator.units import DEG
from benchmarks.closed_loop import hysteresis as bench
from mpc.model.friction.maxwell_slip import MaxwellSlip


@pytest.mark.slow
def test_the_identified_operator_is_worth_a_fifth_of_the_error_against_dahl_as_wide():
    name = "Maxwell slip"
    dahl, operator = (bench.tracked(name, what, 1.0, 1, ("sine", "chirp")) for what in (bench.DAHL, bench.OPERATOR))
    assert (operator.rms < 0.8 * dahl.rms).all()


@pytest.mark.slow
@pytest.mark.parametrize("plant", ["operator of the angle"])
def test_what_is_identified_has_the_plant_s_own_loop(plant):
    """The torque of a great loop, K times half its width, which is known of the plants: 5°."""
    slip = MaxwellSlip.of(bench.identified(bench.swept(bench.PLANTS[plant])))
    assert np.dot(slip.springs, slip.widths) == pytest.approx(2.5 * DEG, rel=0.1)
