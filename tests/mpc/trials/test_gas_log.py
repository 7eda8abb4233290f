"""The gas from a log of the plant under test: commands at rest within the dead band, the joint turned by hand."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import BAR, DEG
from allocator.identification import fit_gas
from allocator.identification.trapped_gas import at_rest
from allocator.joint.antagonist import report_joint
from allocator.joint.gas import Gas
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc import Plant, RealPlant

VOLUME, KAPPA, BAND = 160e-6, 1.25, 1.0 * BAR


@pytest.mark.slow
def test_a_hand_that_turns_a_resting_joint_tells_its_gas():
    muscle = replace(SAROSI_DMSP_20_400N, rest_volume=VOLUME)
    real = RealPlant(
        Plant(report_joint(muscle), damping=1.0, gas=Gas(KAPPA)),
        dead_band=BAND,
        encoder=0.02 * DEG,
        pressure_noise=0.005 * BAR,
    )
    u, rows = np.full(2, 3 * BAR), []
    experiment = real.begin(0.02, np.array([0.0, 0.0, *u]), seed=1)
    for k in range(1500):
        theta, _, P1, P2 = experiment.measure()
        rows.append([theta, P1, P2])
        experiment.advance(u, 4.0 * np.sin(2 * np.pi * 0.2 * 0.02 * k))
    theta, P1, P2 = np.array(rows).T
    assert np.ptp(theta) > 30 * DEG
    rest = at_rest(np.tile(u, (1500, 1)), P1, P2, BAND)
    assert np.ptp(rest) < 10
    fit = fit_gas(report_joint(SAROSI_DMSP_20_400N), theta, P1, P2, rest)
    for gas, side in zip((fit.agonist, fit.antagonist), real.nominal.joint.sides(float(np.median(theta))), strict=True):
        wanted = KAPPA / side.volume(0.0)
        assert abs(gas.stiffening.value - wanted) < max(4 * gas.stiffening.std, 0.01 * wanted)
        assert gas.stiffening.std < 0.02 * wanted
        volume = gas.volume_for(KAPPA)
        assert volume.value == pytest.approx(VOLUME, abs=4 * volume.std + 3e-6)
