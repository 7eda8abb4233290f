"""Temporarily wrong encoder readings: every controller, four muscle laws."""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from allocator import report_joint, stiffness_interval
from allocator.muscles.catalogue import (
    MARTENS_DMSP_20_300,
    SAROSI_DMSP_20_400N,
    TONDU_DMSP_20_400N,
    TONDU_MCKIBBEN,
)
from allocator.units import DEG
from mpc import Plant, RealPlant, Weights, simulate, sine
from mpc.model.faults import Fault, WrongReadings
from mpc.trials.loops import Settings, loop

WRAPS = (3.2, 3.5, 3.8, 4.0, 4.3, 4.6, 4.9, 5.2, 5.5, 5.8, 6.0, 6.15, 6.28)  # [rad]
LENGTHS = (1, 3, 20)  # samples
LAWS = {
    "Sarosi 2012": SAROSI_DMSP_20_400N,
    "Tondu 2021": TONDU_DMSP_20_400N,
    "Tondu McKibben": TONDU_MCKIBBEN,
    "Martens": MARTENS_DMSP_20_300,
}
CONTROLLERS = ("mpc", "lqr", "predictive-pid", "pid")
DT, BEGIN, AFTER = 0.01, 2.0, 0.5  # [s]


class Wrong(NamedTuple):
    """Greatest error from 0.5 s after the beginning of the fault on."""

    law: str
    controller: str
    samples: int
    added: bool
    value: float  # [rad]
    error: float  # [°]
    usual: float  # [°] without the fault


def joint_of(law: str) -> Plant:
    """Return the report's joint with these muscles."""
    return Plant(report_joint(LAWS[law]), lag=0.12)


def runs(law: str, name: str) -> Iterator[Wrong]:
    """Yield all faults of one controller on one joint."""
    plant = joint_of(law)
    K = float(np.mean(stiffness_interval(0.0, 0.0, joint=plant.joint)))
    reference = sine(amplitude=20 * DEG, K=K, K_amplitude=0.0, duration=4.0, ramp=0.5, dt=DT)
    pair = loop(name, Settings(plant, weights=Weights.calm()), observer=True)

    def error(*faults: Fault) -> float:
        run = simulate(replace(RealPlant(plant), faults=faults), pair[0], reference, observer=pair[1])
        return float(np.abs(run.theta - run.theta_ref)[round((BEGIN + AFTER) / DT) :].max()) / DEG

    usual = error()
    for samples in LENGTHS:
        for added in (False, True):
            for value in WRAPS:
                fault = WrongReadings(BEGIN, BEGIN + samples * DT, (0,), value, added)
                yield Wrong(law, name, samples, added, value, error(fault), usual)
