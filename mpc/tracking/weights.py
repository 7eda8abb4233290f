"""Weights of the tracking cost."""

from dataclasses import dataclass, fields
from typing import Self

from allocator import checks
from allocator.units import BAR, DEG


@dataclass(frozen=True)
class Weights:
    """Weights of the cost in `mpc.tracking.cost` and of its slacks.

    Each is written as one over the square of an error that costs ½.

    The weights of the slacks are exact penalties: tens of times the largest sums of multipliers of the hard limits,
    2e8/rad and 2e5/N, in 250 random states near them (`tests/mpc/tracking/hard_limits.py`). Much larger ones would cost
    the QP solvers digits. If the other weights exceed these defaults, those of the slacks have to grow in proportion.
    """

    theta: float = 1 / (0.02 * DEG) ** 2  # w_θ [cost]/[rad]², angle
    omega: float = 1 / (2 * DEG) ** 2  # w_ω [cost]/[rad/s]², velocity
    K: float = 1 / 0.05**2  # w_K [cost]/[N·m/rad]², stiffness
    u: float = 1 / (0.5 * BAR) ** 2  # w_u [cost]/[Pa]², command away from the feed-forward
    rate: float = 1 / (10 * BAR) ** 2  # w_r [cost]/[Pa/s]², its rate away from the feed-forward's
    terminal_rate: float = 1 / (0.05 * BAR) ** 2  # [cost]/[Pa/s]², beyond the horizon: see `mpc.tracking.terminal`
    slack: float = 1e10  # ρ [cost]/[rad], joint range left
    slack_square: float = 1e10  # ρ₂ [cost]/[rad]²
    slack_force: float = 1e7  # ρ_F [cost]/[N], forces below the least one
    slack_force_square: float = 1e5  # ρ_F₂ [cost]/[N]²

    def __post_init__(self) -> None:
        """Raise `InvalidInput` unless all are positive, because otherwise the QP's solution is not unique."""
        for entry in fields(self):
            object.__setattr__(
                self, entry.name, checks.positive(f"Weights: {entry.name}", getattr(self, entry.name), "-")
            )

    @classmethod
    def calm(cls, detuning: float = 1.0) -> Self:
        """Return weights for a joint that differs from its model: errors cost less, changes of commands more.

        They were chosen on joints of `benchmarks.strangers` whose seeds its report does not use. A `detuning` s > 1
        divides the weight of the angle by s and multiplies that of the rate by s²: the loop is slower and more robust
        (`mpc.robust_weights` finds s for a joint). Raises `InvalidInput` unless s is positive and finite.
        """
        s = checks.positive("detuning", detuning, "")
        return cls(theta=1 / (0.16 * DEG) ** 2 / s, omega=1 / (2.5 * DEG) ** 2, rate=(s / (0.5 * BAR)) ** 2)


CALM = Weights(theta=1 / (0.234 * DEG) ** 2, omega=1 / (10.07 * DEG) ** 2, rate=1 / (1.526 * BAR) ** 2)
"""Weights for an arm with dead time, noise and muscles some percent off, found by `benchmarks.arm.rough`."""
