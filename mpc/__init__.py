"""Dynamics and control of the antagonistic joint: plants, linear time-varying MPC, observer, closed-loop simulation.

The names load when they are first used, so that the command line begins at once.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mpc.compensation import Compensation
    from mpc.controller import TrackingMPC
    from mpc.improvement import SlowStep
    from mpc.nonlinear import NonlinearMPC
    from mpc.observer import KalmanObserver
    from mpc.pace import LongStep
    from mpc.plan import Plan, PlanStatus, Rung
    from mpc.plant import Plant
    from mpc.reality import RealPlant
    from mpc.reference import Reference, sine
    from mpc.simulation import Run, simulate
    from mpc.weights import Weights
else:
    _HOMES = {
        "Compensation": "compensation",
        "KalmanObserver": "observer",
        "LongStep": "pace",
        "NonlinearMPC": "nonlinear",
        "Plan": "plan",
        "PlanStatus": "plan",
        "Plant": "plant",
        "RealPlant": "reality",
        "Reference": "reference",
        "Rung": "plan",
        "Run": "simulation",
        "SlowStep": "improvement",
        "TrackingMPC": "controller",
        "Weights": "weights",
        "simulate": "simulation",
        "sine": "reference",
    }

    def __getattr__(name):
        """The public name `name`, from the module that has it."""
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)

    def __dir__():
        """The public names too."""
        return sorted({*globals(), *_HOMES})


__all__ = [
    "Compensation",
    "KalmanObserver",
    "LongStep",
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
