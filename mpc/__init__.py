"""Dynamics and control of the antagonistic joint: plant, linear time-varying MPC, closed-loop simulation."""

from mpc.controller import TrackingMPC
from mpc.plan import Plan, PlanStatus, Rung
from mpc.plant import Plant
from mpc.reference import Reference, sine
from mpc.simulation import Run, simulate
from mpc.weights import Weights

__all__ = ["Plan", "PlanStatus", "Plant", "Reference", "Rung", "Run", "TrackingMPC", "Weights", "simulate", "sine"]
