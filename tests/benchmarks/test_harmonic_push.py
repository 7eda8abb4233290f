"""Stiffness felt at a frequency: shaken in simulation against (G4), inside and outside the dead band."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import BAR, DEG, InvalidInput
from allocator.joint.antagonist import report_joint
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from benchmarks.closed_loop.push import Shake, felt
from mpc import Plant, RealPlant, Reference
from mpc.yardsticks.baselines import FeedForwardControl

GAS = Plant(report_joint(SAROSI_DMSP_20_400N), gas=True)
REST = np.array([0.0, 0.0, 3 * BAR, 3 * BAR])
ISOBARIC, SHUT = GAS.stiffness(REST), GAS.joint.stiffness(0.0, *REST[2:], valves="shut")
BAND = 0.15 * BAR


class Still:
    """Whoever sees the state itself needs no observer."""

    def reset(self):
        pass

    def estimate(self, y, u):
        return np.where(np.isnan(y), 0.0, y), 0.0


def shaken(frequency, real=None, **shake):
    rest = Reference([0.0, 0.5], [0.0, 0.0], [float(ISOBARIC)] * 2)
    real = RealPlant(GAS) if real is None else real
    return felt(real, GAS, (FeedForwardControl(GAS), Still()), rest, 0.5, Shake(frequency, **shake))


@pytest.mark.slow
@pytest.mark.parametrize("frequency", [0.05, 0.5, 2.0, 20.0])
def test_outside_the_dead_band_the_stiffness_felt_is_the_dynamic_one(frequency):
    found = shaken(frequency)
    expected = complex(GAS.joint.dynamic_stiffness(0.0, *REST[2:], frequency, GAS.lags))
    assert found.expected == pytest.approx(expected, rel=1e-3)
    assert abs(found.measured - expected) < 0.01 * abs(expected)
    assert found.measured.imag > 0  # the gas damps
    assert found.angle == pytest.approx(1 * DEG, rel=0.5)


@pytest.mark.slow
@pytest.mark.parametrize("frequency", [0.05, 0.5, 2.0, 20.0])
def test_inside_the_dead_band_it_is_that_of_shut_valves_at_every_frequency(frequency):
    found = shaken(frequency, RealPlant(GAS, dead_band=BAND))
    assert abs(found.measured - SHUT) < 0.01 * SHUT


@pytest.mark.slow
def test_a_push_that_leaves_the_dead_band_is_felt_softer_than_shut_and_stiffer_than_held():
    found = shaken(0.05, RealPlant(GAS, dead_band=BAND), angle=20 * DEG)
    assert ISOBARIC * 1.02 < found.measured.real < SHUT * 0.98


@pytest.mark.slow
def test_valves_that_are_shut_make_the_isobaric_stiffness_of_a_slow_push_the_shut_one():
    assert shaken(0.2, shut=True).measured == pytest.approx(SHUT, rel=1e-3)
    bare = replace(GAS, gas=None)
    assert shaken(0.2, RealPlant(bare), shut=True).measured == pytest.approx(ISOBARIC, rel=1e-3)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"frequency": -2.0}, "frequency = -2 Hz"),
        ({"frequency": 0.0}, "frequency = 0 Hz"),
        ({"frequency": 1.0, "angle": 20.0}, "angle = 20 rad has to be above 0"),
    ],
)
def test_a_shake_that_makes_no_sense_is_refused(wrong, said):
    with pytest.raises(InvalidInput, match=said):
        Shake(**wrong)
