"""A governor knows that motion compresses the gas in the muscles."""

from dataclasses import replace

import numpy as np
import pytest

from allocator.errors import InvalidInput
from allocator.muscles import FunctionMuscle
from allocator.units import BAR, DEG
from mpc import Arm
from mpc.governor import PressureGovernor
from mpc.governor.rules import memory_for

ARM, DT = Arm.machine("arm26"), 0.01
LAW_ONLY = replace(ARM.mechanism, muscles=(FunctionMuscle(lambda e: 3e-3 * (1 - e / 0.3), lambda e: -900.0 * e),) * 6)


def test_the_simulated_arm_compresses_gas_as_the_arm_does():
    governor, u = PressureGovernor.of_arm(ARM, DT), np.array([3.0, 2.0, 1.5, 2.5, 3.5, 1.5]) * BAR
    names, rules, memory = {}, governor.made.rules, memory_for(governor.made.rules)
    exec(governor._packed.text, names)
    x = np.concatenate([[0.1, -0.2], [2.0, -3.0], np.full(6, 2.5 * BAR)])
    memory.within[:] = rules.ends
    names["begin"](rules, 0, x[:2], x[2:4], x[4:], u, memory)
    step, without, y = ARM.discrete(DT, 0.02), replace(ARM, gas=False).discrete(DT, 0.02), x
    for _ in range(8):
        assert all(names["advance"](rules, 0, 0, memory) for _ in range(rules.counts[0]))
        x, y = (np.array(move(z, u, np.zeros(2))).ravel() for move, z in ((step, x), (without, y)))
    assert memory.pressures == pytest.approx(x[4:], abs=300.0)
    assert memory.angles == pytest.approx(x[:2], abs=0.1 * DEG)
    assert np.abs(y[4:] - x[4:]).max() > 5000  # [Pa]


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"gas": 1.3}, r"gas = 1.3 has to be a Gas\(kappa, atmosphere\), True or False"),
        ({"lag": 0.0}, "no motion compresses gas behind regulators without a lag; give lag"),
        ({"mechanism": LAW_ONLY}, "how much gas this FunctionMuscle holds is not known"),
    ],
)
def test_gas_that_makes_no_sense_is_refused(changed, said):
    given = {"mechanism": ARM.mechanism, "dt": DT, "slew": 5 * BAR, "inertia": 0.1, "lag": 0.1, "gas": True} | changed
    with pytest.raises(InvalidInput, match=said):
        PressureGovernor(**given)
