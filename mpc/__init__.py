"""Dynamics and control of joints and arms: plants, linear time-varying MPC, observer, simulated loops.

All names are imported on first use, so that the command line starts quickly.
"""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mpc.identification.plant import IdentifiedPlant
    from mpc.model.compensation import Compensation
    from mpc.model.plant import Plant
    from mpc.model.real_plant import RealPlant
    from mpc.observer.kalman import KalmanObserver
    from mpc.tracking.controller import LongStep, TrackingMPC
    from mpc.tracking.plan import Plan, PlanStatus, Rung
    from mpc.tracking.qp.solvers import DAQP, OSQP, SCS, Clarabel, Riccati
    from mpc.tracking.qp.step import CompilingBeside, SlowStep
    from mpc.tracking.weights import Weights
    from mpc.trials.many.entry import simulate_many
    from mpc.trials.many.runs import Runs
    from mpc.trials.reference import Reference, sine
    from mpc.trials.robust import robust_weights
    from mpc.trials.simulation import Run, simulate
    from mpc.tuning.search import tune
    from mpc.yardsticks.nlp_solvers import IPOPT, Fatrop
    from mpc.yardsticks.nonlinear import NonlinearMPC
else:
    _HOMES = {
        "Clarabel": "tracking.qp.solvers",
        "Compensation": "model.compensation",
        "CompilingBeside": "tracking.qp.step",
        "DAQP": "tracking.qp.solvers",
        "Fatrop": "yardsticks.nlp_solvers",
        "IPOPT": "yardsticks.nlp_solvers",
        "IdentifiedPlant": "identification.plant",
        "KalmanObserver": "observer.kalman",
        "LongStep": "tracking.controller",
        "NonlinearMPC": "yardsticks.nonlinear",
        "OSQP": "tracking.qp.solvers",
        "Plan": "tracking.plan",
        "PlanStatus": "tracking.plan",
        "Plant": "model.plant",
        "RealPlant": "model.real_plant",
        "Reference": "trials.reference",
        "Riccati": "tracking.qp.solvers",
        "Rung": "tracking.plan",
        "Run": "trials.simulation",
        "Runs": "trials.many.runs",
        "SCS": "tracking.qp.solvers",
        "SlowStep": "tracking.qp.step",
        "TrackingMPC": "tracking.controller",
        "Weights": "tracking.weights",
        "robust_weights": "trials.robust",
        "simulate": "trials.simulation",
        "simulate_many": "trials.many.entry",
        "sine": "trials.reference",
        "tune": "tuning.search",
    }

    def __getattr__(name):
        """Return the public name `name`, from the module that has it."""
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(_import_module(f"{__name__}.{_HOMES[name]}"), name)

    def __dir__():
        return sorted({*globals(), *_HOMES})


__all__ = [
    "Clarabel",
    "Compensation",
    "CompilingBeside",
    "DAQP",
    "Fatrop",
    "IPOPT",
    "IdentifiedPlant",
    "KalmanObserver",
    "LongStep",
    "NonlinearMPC",
    "OSQP",
    "Plan",
    "PlanStatus",
    "Plant",
    "RealPlant",
    "Reference",
    "Riccati",
    "Rung",
    "Run",
    "Runs",
    "SCS",
    "SlowStep",
    "TrackingMPC",
    "Weights",
    "robust_weights",
    "simulate",
    "simulate_many",
    "sine",
    "tune",
]
