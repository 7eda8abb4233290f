"""Is every answer what it claims to be? Checked before anything is counted; a lie ends the benchmark."""

from collections.abc import Callable

import numpy as np

from allocator import BAR, DEG, Status
from allocator.allocation.backends import CERTIFIED
from benchmarks.allocators.contenders import WEIGHTS, Answer
from benchmarks.allocators.measures import effect
from benchmarks.allocators.targets import Array, Flags, TargetSet

MET = 2e-6  # of the joint's torque and stiffness at full pressure and the target: an EXACT answer misses by less
SAME_FIRST = 1e-9  # [N·m], [N·m/rad] first errors this near are the same
BEATEN_FIRST, BEATEN_SECOND = 1e-6, 1e-4  # of max(1, error); [N·m], [N·m/rad]: better by more is better


class BenchmarkFailure(Exception):
    """An answer is not what it claims to be."""


def check(targets: TargetSet, priority: str, name: str, answer: Answer, exact: Answer) -> None:
    """Raise BenchmarkFailure for the first allocator's answer that breaks a limit, a claim, or beats the optimum."""
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
    demand(~beats(targets, priority, answer, exact), lambda i: "the answer is better than the exact one")


def beats(targets: TargetSet, priority: str, answer: Answer, exact: Answer) -> Flags:
    """Where an answer is better than the proved optimum by more than the tolerance."""
    first, second = costs(targets, priority, answer)
    least, then = costs(targets, priority, exact)
    better = first < least - BEATEN_FIRST * np.maximum(1.0, least)
    better |= (np.abs(first - least) < SAME_FIRST) & (second < then - BEATEN_SECOND)
    return np.asarray(better if exact.local is None else better & ~exact.local)


def costs(targets: TargetSet, priority: str, answer: Answer) -> tuple[Array, Array]:
    """What is made small first, and then."""
    found = effect(targets, answer)
    e_T, e_K = np.abs(found.T - targets.T), np.abs(found.K - targets.K)
    if priority == "weighted":
        w_T, w_K = WEIGHTS
        return w_T * e_T**2 + w_K * e_K**2, np.zeros(e_T.shape)
    return (e_T, e_K) if priority == "torque" else (e_K, e_T)


def scales(targets: TargetSet) -> tuple[Array, Array]:
    """What counts as a large torque [N·m] and stiffness [N·m/rad] at each target."""
    high, sides = targets.joint.pressure_limits[1], targets.joint.sides(targets.reached)
    T_scale = np.abs(targets.T) + sum(np.abs(side.torque(high)) for side in sides)
    return T_scale, np.abs(targets.K) + sum(np.abs(side.stiffness(high)) for side in sides)
