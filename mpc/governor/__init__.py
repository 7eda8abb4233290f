"""Safe pressures next to any commands: the governor of a mechanism.

    from mpc.governor import Interval, PressureGovernor
    known = {"strength": Interval(0.9, 1.1), "damping": Interval(0.2, 0.3), "lag": Interval(0.04, 0.06)}
    governor = PressureGovernor(machines.arm26(), dt=0.01, slew=20 * BAR, inertia=(0.12, 0.04), **known)
    governor.warm_up()
    P_safe = governor(q, omega, P, command)

A command passes if its energy cannot reach the limit (I. Kolmanovsky, E. Garone and S. Di Cairano, "Reference and
command governors: a tutorial on their theory and automotive applications", ACC 2014; E. Garone and M. M. Nicotra,
"Explicit reference governor for constrained nonlinear systems", IEEE TAC 61(5), 2016).
"""

from mpc.governor.governor import Governed, GovernorStatus, PressureGovernor
from mpc.governor.model import Interval

__all__ = ["Governed", "GovernorStatus", "Interval", "PressureGovernor"]
