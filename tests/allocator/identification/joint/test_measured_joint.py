"""A real lever joint: 1335 measured equilibria of three muscle lengths, both pressures swept both ways.

The data are for development only, not shipped (see the fixture `shared`).
"""

import csv
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from allocator import Lever
from allocator.identification.joint.fit import fit_joint
from allocator.units import BAR, DEG

pytestmark = pytest.mark.slow

DATA = Path("data") / "joint_angle_grid.csv"
LENGTHS = ("240", "250", "260")


@pytest.fixture(scope="module")
def measured(shared):
    lines = shared(DATA).read_text(encoding="utf-8").splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    length = np.array([row["rest_length_mm"] for row in rows])
    column = {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}
    return {
        "theta": column["theta_rad"],
        "P1": column["pressure1_bar"] * BAR,
        "P2": column["pressure2_bar"] * BAR,
        "direction": np.where(column["sweep"] == 1, -1, 1),  # 1: P2 raised, θ falls; 2: P1 raised, θ rises
        "group": length,
    }


@pytest.fixture(scope="module")
def fitted(measured):
    geometry = {mm: Lever(float(mm) / 1000, 0.1655, 0.05094, 0.051) for mm in LENGTHS}

    @cache
    def fitted(model, **options):
        return fit_joint(**measured, geometry=geometry, dead_band=1.5 * BAR, model=model, choices=False, **options)

    return fitted


def test_the_mean_of_both_sweeps_is_met_to_1_1_degrees_by_the_sarosi_form(fitted):
    fit = fitted("Sarosi2012", average=True)
    assert fit.rms < 1.1 * DEG
    assert fit.samples.n == 420


def test_both_sweeps_are_met_to_1_3_degrees_with_friction_and_to_4_4_without(fitted):
    moving = fitted("Sarosi2012")
    still = fitted("Sarosi2012", friction=False, leave_one_out=False)
    assert moving.rms < 1.3 * DEG
    assert 0.13 <= moving.friction <= 0.19
    assert still.rms == pytest.approx(4.4 * DEG, abs=0.2 * DEG)
    assert still.hysteresis_share > 0.9  # section 6: 95 % of the residual of every static model
    assert any("hysteresis" in warning for warning in still.warnings)


def test_the_plainest_affine_law_predicts_a_length_left_out_better_than_the_sarosi_form(fitted):
    plain, sarosi = fitted("AffinePolynomial", average=True), fitted("Sarosi2012", average=True)
    assert plain.rms < 1.3 * DEG
    assert plain.left_out < 2.0 * DEG
    assert sarosi.left_out == pytest.approx(3.0 * DEG, abs=0.4 * DEG)
    assert [group.label for group in plain.groups] == list(LENGTHS)


def test_no_absolute_stiffness_comes_from_a_joint_without_a_weight(fitted):
    fit = fitted("Sarosi2012")
    assert fit.scale is None
    assert any("absolute stiffness is not known" in direction for direction in fit.unseen)
    with pytest.raises(ValueError, match="stiffness of this joint needs the force scale"):
        fit.joint_of("250").stiffness(0.0, 3 * BAR, 3 * BAR)
    ratio = fit.joint_of("250").relative_stiffness(0.0, [2 * BAR, 4 * BAR], [2 * BAR, 4 * BAR])
    assert ratio[1] > 1.3 * ratio[0]
    assert fit.monotone
    assert fit.determinant_positive


def test_pressures_in_the_dead_band_are_dropped_and_counted(fitted):
    assert fitted("Sarosi2012").samples.dropped == {"a pressure below the dead band of 1.5 bar": 483}
