"""Solvers of the controllers' optimisation problems, as values of the argument `solver`."""

from typing import TYPE_CHECKING

from allocator.faces import face

if TYPE_CHECKING:
    from mpc.tracking.qp.solvers import DAQP as DAQP
    from mpc.tracking.qp.solvers import OSQP as OSQP
    from mpc.tracking.qp.solvers import SCS as SCS
    from mpc.tracking.qp.solvers import Clarabel as Clarabel
    from mpc.tracking.qp.solvers import Riccati as Riccati
    from mpc.yardsticks.shooting import IPOPT as IPOPT
    from mpc.yardsticks.shooting import Fatrop as Fatrop
else:
    __all__, __getattr__, __dir__ = face(__name__, __file__)
