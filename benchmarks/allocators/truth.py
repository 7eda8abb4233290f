"""Checks of every answer's claims before anything is counted; a false claim ends the benchmark."""

from collections.abc import Callable

import numpy as np

from allocator import BAR, DEG, Status
from allocator.allocation.optimisers.backends import CERTIFIED
from benchmarks.allocators.contenders import Answer
from benchmarks.allocators.cost import beats, unproved
from benchmarks.allocators.effect import effect
from benchmarks.allocators.targets import Array, Flags, TargetSet

MET = 2e-6  # of the joint's torque and stiffness at full pressure and the target: greatest miss of an EXACT answer


class BenchmarkFailure(Exception):
    """False claim of an answer."""


def check(targets: TargetSet, priority: str, name: str, answer: Answer, exact: Answer) -> None:
    """Raise BenchmarkFailure for the first allocator's answer that breaks a limit or a claim, or beats the optimum."""
    if answer.status is None:
        return  # the inverse claims nothing
    found = effect(targets, answer)

    def demand(holds: Flags, said: Callable[[int], str]) -> None:
        for i in np.flatnonzero(~holds)[:1]:
            asked = f"θ = {targets.theta[i] / DEG:.6g}°, K = {targets.K[i]:.9g} N·m/rad, T = {targets.T[i]:.9g} N·m"
            given = f"P1 = {answer.P1[i] / BAR:.9g} bar, P2 = {answer.P2[i] / BAR:.9g} bar"
            raise BenchmarkFailure(
                f"{name} with priority {priority} on {targets.joint_name}: {said(i)} ({asked}; {given})"
            )

    status, residual = answer.status, answer.residual
    demand(found.within, lambda i: "the answer breaks a limit")
    demand(
        answer.failed | (residual <= CERTIFIED),
        lambda i: f"status {Status(status[i]).name}, but the residual is {residual[i]:.3g} of the supply range",
    )
    T_scale, K_scale = scales(targets)
    e_T, e_K = np.abs(found.T - targets.T), np.abs(found.K - targets.K)
    missed = (e_T > MET * T_scale) | (e_K > MET * K_scale) | ~targets.in_range
    demand(
        ~(missed & (status == Status.EXACT)),
        lambda i: f"status EXACT, but the torque is off by {e_T[i]:.3g} N·m, the stiffness by {e_K[i]:.3g} N·m/rad",
    )
    beaten = beats(targets, priority, answer, exact) & ~unproved(exact)
    demand(~beaten, lambda i: "the answer is better than the exact one")


def scales(targets: TargetSet) -> tuple[Array, Array]:
    """Return scales of torque [N·m] and stiffness [N·m/rad] at each target."""
    high, sides = targets.joint.pressure_limits[1], targets.joint.sides(targets.reached)
    T_scale = np.abs(targets.T) + sum(np.abs(side.torque(high)) for side in sides)
    return T_scale, np.abs(targets.K) + sum(np.abs(side.stiffness(high)) for side in sides)
