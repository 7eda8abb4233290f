"""Dynamics and control of the antagonistic joint: plants, linear time-varying MPC, observer, closed-loop simulation."""

from mpc.compensation import Compensation
from mpc.controller import TrackingMPC
from mpc.improvement import SlowStep
from mpc.nonlinear import NonlinearMPC
from mpc.observer import KalmanObserver
from mpc.plan import Plan, PlanStatus, Rung
from mpc.plant import Plant
from mpc.reality import RealPlant
from mpc.reference import Reference, sine
from mpc.simulation import Run, simulate
from mpc.weights import Weights

__all__ = [
    "Compensation",
    "KalmanObserver",
    "NonlinearMPC",
    "Plan",
    "PlanStatus",
    "Plant",
    "RealPlant",
    "Reference",
    "Rung",
    "Run",
    "SlowStep",
    "TrackingMPC",
    "Weights",
    "simulate",
    "sine",
]
