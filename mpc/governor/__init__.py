"""The governor lets through what is safe: the nearest pressures to whatever somebody commands.

    from mpc.governor import PressureGovernor
    governor = PressureGovernor(machines.arm26(), dt=0.01, slew=20 * BAR, inertia=(0.12, 0.04), lag=0.05)
    governor.warm_up()
    P_safe = governor(q, omega, P, command)

J. Kolmanovsky, E. Garone and S. Di Cairano, "Reference and command governors: a tutorial on their theory and automotive
applications", ACC 2014; E. Garone and M. M. Nicotra, "Explicit reference governor for constrained nonlinear systems",
IEEE TAC 61(5), 2016: a command is let through if the energy that would go with it cannot reach the limit.
"""

from mpc.governor.governor import Governed, GovernorStatus, PressureGovernor

__all__ = ["Governed", "GovernorStatus", "PressureGovernor"]
