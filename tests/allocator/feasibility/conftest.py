"""Joints with every usable muscle model, for the edges of the feasible set."""

from functools import cache

import pytest

from allocator import AntagonistJoint, Pulley
from allocator.identification import fit, load_dataset
from allocator.muscles import MODELS
from allocator.units import DEG

PULLEY = Pulley(rest_length=0.40, radius=0.02, initial_contraction=0.1375)
USABLE = [name for name in MODELS if name != "PolynomialMcKibben"]  # its stiffness cannot be commanded


@cache
def joint_with(model):
    map_ = load_dataset("dmsp-20-300-map")
    muscle = fit(MODELS[model], map_.contraction, map_.pressure, map_.force, folds=0).muscle
    return AntagonistJoint(PULLEY, muscle, muscle, angle_limits=(-80 * DEG, 80 * DEG))


@pytest.fixture(scope="session", params=USABLE)
def fitted_joint(request):
    return joint_with(request.param)
