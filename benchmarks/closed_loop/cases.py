"""Trajectories, plants, and the controllers' assumptions about them."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from allocator.units import BAR
from mpc import Compensation, Reference, Weights
from mpc.model.friction.dahl import WIDTH_AT, Friction
from mpc.model.real import RealPlant
from mpc.trials.loops import Settings
from mpc.trials.motions.trajectories import LEAD, chirp, point_to_point, rested_sine, steps, stiffness_step
from mpc.yardsticks.baselines import PIDGains

SEEDS = 41  # the first; tuning used others
LOAD = 1.0  # [N·m]
STANDARD = RealPlant.standard()
MODEL = STANDARD.nominal
TOLD = STANDARD.known()
SETTINGS = Settings(MODEL, compensation=TOLD, weights=Weights.calm())


class Case(NamedTuple):
    """Trajectory, and the part of it that counts."""

    reference: Reference
    load_from: float  # [s]
    before_load: bool = True  # errors count up to the load; else to the end


CASES = {
    "sine": Case(rested_sine(), 9.0),
    "min-jerk": Case(point_to_point(), 7.0),
    "chirp": Case(chirp(), 9.0),
    "steps": Case(steps(), LEAD + 4.8),
    "stiffness step": Case(stiffness_step(), 0.5, before_load=False),
}


class Tested(NamedTuple):
    """Plant, the controllers' assumptions about it, and their horizon."""

    real: RealPlant
    told: Compensation = TOLD
    N: int = 20


PLANTS = {
    "standard": Tested(STANDARD),
    "gains swapped": Tested(RealPlant.standard((0.9, 1.1))),
    "both +10 %": Tested(RealPlant.standard((1.1, 1.1))),
}
FREE = replace(STANDARD, friction=Friction())
VARIANTS = {  # of plant and horizon, with the same tuning and assumptions
    "Dahl friction": Tested(replace(STANDARD, friction=STANDARD.friction.as_dahl(MODEL))),  # of the assumed form
    "friction removed": Tested(FREE),
    "lag 0.10 s": Tested(replace(STANDARD, nominal=replace(MODEL, lag=0.10))),
    "lag 0.15 s": Tested(replace(STANDARD, nominal=replace(MODEL, lag=0.15))),
    "N = 15": Tested(STANDARD, N=15),
    "N = 40": Tested(STANDARD, N=40),
}


def _alone(**effect: object) -> Tested:
    real = replace(RealPlant(MODEL), **effect)
    return Tested(real, real.known())


ALONE = {  # all but the last with true assumptions
    "nominal": _alone(),
    "gain errors alone": _alone(force_gains=(1.1, 0.9)),
    "hysteresis alone": _alone(friction=STANDARD.friction),
    "dead time alone": _alone(dead_time=STANDARD.dead_time),
    "dead band alone": _alone(dead_band=0.1 * BAR),
    "slow filling alone": _alone(flow=STANDARD.flow),
    "all but friction": Tested(FREE, FREE.known()),
    "sensors alone": _alone(encoder=STANDARD.encoder, pressure_noise=STANDARD.pressure_noise),
    "nominal, all effects assumed": Tested(RealPlant(MODEL)),
}
EVERY = PLANTS | VARIANTS | ALONE


def placed(rate: float) -> PIDGains:
    """Return gains with the three poles of J θ'' + b θ' + K θ = T at -`rate` [1/s], K at P1 + P2 = 5 bar."""
    J, K = MODEL.inertia, float(MODEL.stiffness(np.array([0.0, 0.0, WIDTH_AT, WIDTH_AT])))
    return PIDGains(3 * J * rate**2 - K, J * rate**3, 3 * J * rate - MODEL.damping)


PLACED = {f"pid, poles at -{rate:g}/s": placed(rate) for rate in (6.0, 8.0, 10.0, 12.0)}  # on the standard plant
