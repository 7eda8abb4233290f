"""The tolerances of the allocation say when a target counts as met, and when a limit as binding."""

from typing import NamedTuple

from allocator.joint.limits import BINDS


class Tolerance(NamedTuple):
    """A `Tolerance` is what counts as met and as binding."""

    met: float  # of the torque or stiffness scale: a target missed by less is met
    binds: float  # of the supply range: a pressure nearer to a bound lies on it


CLOSED_FORM = Tolerance(met=1e-9, binds=BINDS)
OPTIMISER = Tolerance(met=1e-6, binds=1e-7)
UNCERTAIN = Tolerance(met=1e-6, binds=1e-6)  # of cone programmes
