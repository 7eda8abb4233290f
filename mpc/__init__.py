"""Dynamics and control of joints and arms: plants, linear time-varying MPC, observer, simulated loops.

Named sub-packages have the rest of the public names: `mpc.arm`, `mpc.bench`, `mpc.export`, `mpc.governor`,
`mpc.learning`, `mpc.model`, `mpc.solvers` and `mpc.trials`. All names are imported on first use.
"""

from typing import TYPE_CHECKING

from allocator.faces import face

if TYPE_CHECKING:
    from mpc.identification.plant import IdentifiedPlant as IdentifiedPlant
    from mpc.model.arm.model import Arm as Arm
    from mpc.model.compensation import Compensation as Compensation
    from mpc.model.plant import Plant as Plant
    from mpc.model.real import RealPlant as RealPlant
    from mpc.observer.filter import Noise as Noise
    from mpc.observer.kalman import KalmanObserver as KalmanObserver
    from mpc.tracking.controller import LongStep as LongStep
    from mpc.tracking.controller import TrackingMPC as TrackingMPC
    from mpc.tracking.cost import Weights as Weights
    from mpc.tracking.plan import Plan as Plan
    from mpc.tracking.plan import PlanStatus as PlanStatus
    from mpc.tracking.plan import Rung as Rung
    from mpc.tracking.qp.step import CompilingBeside as CompilingBeside
    from mpc.tracking.qp.step import SlowStep as SlowStep
    from mpc.trials.many.entry import simulate_many as simulate_many
    from mpc.trials.many.runs import Runs as Runs
    from mpc.trials.margins import margins as margins
    from mpc.trials.metrics import metrics as metrics
    from mpc.trials.motions.reference import Reference as Reference
    from mpc.trials.motions.reference import sine as sine
    from mpc.trials.pictures.plotting import tracking_figure as tracking_figure
    from mpc.trials.robust import robust_weights as robust_weights
    from mpc.trials.simulation import Run as Run
    from mpc.trials.simulation import simulate as simulate
    from mpc.tuning.draws import Spreads as Spreads
    from mpc.tuning.search import tune as tune
    from mpc.yardsticks.nonlinear import NonlinearMPC as NonlinearMPC
else:
    __all__, __getattr__, __dir__ = face(__name__, __file__)
