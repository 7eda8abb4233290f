"""The plant that `antagonist track` drives by default is not the controller's model."""

import numpy as np
import pytest

from allocator import BAR, report_joint
from allocator.muscles.catalogue import MUSCLES, SAROSI_DMSP_20_400N
from mpc import Compensation, Plant
from mpc.model.friction.dahl import Friction
from mpc.trials.other_plant import STIFFNESS_BAND, other_plant


@pytest.mark.parametrize("muscle", [MUSCLES["tondu-dmsp-20-400n"], SAROSI_DMSP_20_400N], ids=lambda m: type(m).__name__)
def test_its_muscles_have_another_law_with_nearly_the_same_forces(muscle):
    model = Plant(report_joint(muscle))
    other = other_plant(model)
    fitted = other.plant.nominal.joint.agonist
    assert type(fitted) is not type(muscle)
    P, eps = np.meshgrid(np.linspace(1, 5, 9) * BAR, np.linspace(0.02, 0.2, 10))
    wanted = muscle.force(P, eps)
    error = np.sqrt(np.mean((fitted.force(P, eps) - wanted) ** 2)) / wanted.max()
    assert 0.003 < error < 0.05
    assert type(fitted).__name__ in other.unknown


def test_the_differences_are_those_that_a_file_does_not_tell():
    known = Compensation(friction=Friction(coulomb=0.1), lag_up=0.1, lag_down=0.2)
    named, told = other_plant(Plant()).unknown, other_plant(Plant(), known=known)
    for words in ("a quarter of the friction", "lags 20 % longer"):
        assert words in named
        assert words not in told.unknown
    assert (told.plant.friction, told.plant.lag_up, told.plant.lag_down) == (known.friction, 0.1, 0.2)
    assert "flow" not in named  # an identification finds it


def test_its_law_is_another_one_also_where_the_model_has_the_usual_other_law():
    once = other_plant(Plant()).plant.nominal
    assert type(other_plant(once).plant.nominal.joint.agonist) is not type(once.joint.agonist)


def test_its_stiffness_differs_from_the_model_s_within_the_band_that_the_picture_shows():
    model = Plant()
    x = np.array([[theta, 0.0, 3e5 + dP, 3e5 - dP] for theta in (-0.5, 0.0, 0.5) for dP in (-5e4, 0.0, 5e4)])
    ratio = other_plant(model).plant.along(x)[0] / model.along(x)[0]
    assert np.abs(ratio - 1).max() > 0.005
    assert np.abs(ratio - 1).max() < STIFFNESS_BAND
