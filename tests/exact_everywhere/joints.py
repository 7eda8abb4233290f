"""Every muscle model on every kind of geometry: the joints of the tests of "exact"."""

from functools import cache

import numpy as np

from allocator import AntagonistJoint, Lever, Pulley, Table
from allocator.identification import fit, load_dataset
from allocator.muscles import MODELS
from allocator.muscles.catalogue import TONDU_DMSP_20_400N
from allocator.units import DEG

_ANGLES = np.linspace(-0.8, 0.8, 33)
GEOMETRIES = {  # name → mechanism, end stops [rad]
    "pulley": (Pulley(0.40, 0.02, 0.1375), (-125 * DEG, 125 * DEG)),  # Tondu 2021, (24), (25)
    "lever-A": (Lever(0.25, 0.1655, 0.05094, 0.051), (-0.45, 0.45)),
    "lever-B": (Lever(0.30, 0.19, 0.045, 0.085), (-0.45, 0.45)),
    "table": (  # no mirror symmetry
        Table(
            0.30,
            _ANGLES,
            0.12 + 0.10 * _ANGLES + 0.015 * np.sin(2 * _ANGLES),
            0.11 - 0.09 * _ANGLES - 0.02 * np.sin(1.5 * _ANGLES),
        ),
        (-0.75, 0.75),
    ),
}
REPORT = "Tondu2021-report"
MUSCLES = (*MODELS, REPORT)


@cache
def muscle_of(name):
    """Return the report's muscle, or the model of this name fitted to the shipped map of a DMSP-20-300."""
    if name == REPORT:
        return TONDU_DMSP_20_400N
    measured = load_dataset("dmsp-20-300-map")
    return fit(MODELS[name], measured.contraction, measured.pressure, measured.force, folds=0).muscle


@cache
def joint_of(muscle, geometry):
    """Return the joint of two such muscles, 0 to 5 bar."""
    mechanism, stops = GEOMETRIES[geometry]
    return AntagonistJoint(mechanism, muscle_of(muscle), muscle_of(muscle), angle_limits=stops)
