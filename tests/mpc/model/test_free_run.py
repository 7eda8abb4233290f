"""Free runs over a log against the differential equations, integrated by SciPy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from allocator import BAR, DEG, InvalidInput, report_joint
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc import Compensation, Plant, RealPlant
from mpc.identification.plant import free_run

JOINT = report_joint(SAROSI_DMSP_20_400N)
PLANT = Plant(JOINT, inertia=0.03, damping=0.4, lag=(0.1, 0.1), gas=False)
T = np.array([0.0, 0.02, 0.05, 0.06, 0.3, 0.33, 0.5, 0.8])  # s, at uneven times
P1 = np.array([2.5, 3.5, 3.5, 2.0, 2.0, 3.0, 3.0, 3.0]) * BAR
P2 = np.array([2.5, 2.5, 1.8, 1.8, 3.2, 3.2, 2.6, 2.6]) * BAR


def solved(rate, x0):
    return solve_ivp(rate, (0, T[-1]), x0, t_eval=T, rtol=1e-9, atol=1e-9, max_step=5e-4).y[0]


@pytest.mark.parametrize(
    ("up", "down", "dead", "flow"), [(0.1, 0.1, 0.0, np.inf), (0.05, 0.2, 0.037, np.inf), (0.05, 0.1, 0.02, 5 * BAR)]
)
def test_a_log_s_commands_act_as_the_equations_of_joint_and_regulators_say(up, down, dead, flow):
    known = Compensation(dead_time=dead, lag_up=up, lag_down=down, flow=flow)

    def rate(t, x):
        acting = max(np.searchsorted(T, t - dead, side="right") - 1, 0)
        error = np.array([P1[acting], P2[acting]]) - x[2:]
        P = np.clip(np.where(error > 0, error / up, error / down), -flow, flow)
        torque = float(JOINT.torque(x[0], *x[2:]))
        return [x[1], (torque - PLANT.damping * x[1]) / PLANT.inertia, *P]

    found = free_run(RealPlant.of(PLANT, known), T, P1, P2, begin=0.0)
    expected = solved(rate, [0.0, 0.0, P1[0], P2[0]])
    assert np.ptp(expected) > 10 * DEG
    np.testing.assert_allclose(found, expected, rtol=0, atol=0.02 * DEG)


def test_pressures_that_were_measured_in_the_muscles_act_without_any_regulator():
    t, slow = np.linspace(0, 1, 101), Compensation(dead_time=0.1, lag_up=0.3, dead_band=0.3 * BAR)
    one, two = (2.5 + 0.5 * np.sin(5 * t)) * BAR, (2.5 - 0.7 * np.sin(3 * t)) * BAR

    def rate(at, x):
        torque = float(JOINT.torque(x[0], np.interp(at, t, one), np.interp(at, t, two)))
        return [x[1], (torque - PLANT.damping * x[1]) / PLANT.inertia]

    expected = solve_ivp(rate, (0, 1), [0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-9).y[0]
    found = free_run(RealPlant.of(PLANT, slow), t, one, two, commanded=False)
    np.testing.assert_allclose(found, expected, rtol=0, atol=0.02 * DEG)


def test_a_log_whose_rows_do_not_fit_is_refused_by_name():
    with pytest.raises(InvalidInput, match="one of each for every sample"):
        free_run(RealPlant(PLANT), T, P1, P2[1:])
    with pytest.raises(InvalidInput, match="t has to increase"):
        free_run(RealPlant(PLANT), T[::-1], P1, P2)
