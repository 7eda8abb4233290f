"""Checks of answers before their times count."""

import numpy as np

from allocator import Stiffness, allocate
from benchmarks.speed.targets import Answers, Array, Targets

NO_SHORT_CUT = 1e-300  # a negligible tolerance [N·m/rad] for which `allocate` has no kernel


class BenchmarkFailure(Exception):
    """Two answers that should agree differ."""


def check_same(who: str, targets: Targets, found: Answers) -> None:
    """Check pressures to 1e-9, status and limits against the readable implementation for a part of the targets."""
    from allocator.allocation.two_muscles.exact import solve

    step = max(1, targets.n // 2000)
    some = tuple(x[::step] for x in targets.arrays)
    expected = allocate(*some, joint=targets.joint, method="exact", stiffness=Stiffness(tolerance=NO_SHORT_CUT))
    P1, P2, _ = solve(expected._problem)
    for name, mine, right in (
        ("P1", found.P1[::step], P1),
        ("P2", found.P2[::step], P2),
        ("T", found.T[::step], expected.T),
        ("K", found.K[::step], expected.K),
    ):
        wrong = np.abs(mine - right) > 1e-9 * np.abs(right) + 1e-9 * np.abs(right).max()
        if wrong.any():
            raise BenchmarkFailure(f"{who}: {name} of {wrong.sum()} targets is not the reference's")
    for name, codes, others in (("status", found.status, expected.status), ("limits", found.limits, expected.limits)):
        if (wrong := codes[::step] != others).any():
            raise BenchmarkFailure(f"{who}: {name} of {wrong.sum()} targets is not the reference's")


def check_pressures(who: str, found: Array, right: Array, tolerance: float, share: float = 1.0) -> None:
    """Check that pressures (n, 2) are within `tolerance` [Pa] of the exact ones for this share of the targets."""
    near = np.abs(found - right).max(axis=1) <= tolerance
    if near.mean() < share:
        raise BenchmarkFailure(f"{who}: {near.mean():.0%} of the answers are within {tolerance:g} Pa of the exact one")
