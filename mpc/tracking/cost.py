"""Tracking cost of a sample: a table of residuals with one of the `Weights` each.

    ½ Σ_{k=1…N-1} [w_θ (θ_k - θ*_k)² + w_ω (ω_k - θ*'_k)² + w_K (K_k - K*_k)²]
  + ½ Σ_{k=0…N-1} [w_u |e_k|² + w_r |e_k - e_{k-1}|²/dt²]                              e_k = u_k - u*_k

A residual is an entry of one of four kinds of rows, each the difference of a quantity and its reference in the
`FeedForward`:

    x     x_k - x*_k           state (θ, ω, P1, P2)               k = 1 … N-1, the last state is the terminal cost's
    y     y_k - y*_k           outputs (K, F1, F2)                k = 1 … N-1, of arms (svec K, F1, …, Fm)
    e     u_k - u*_k           commands                           k = 0 … N-1
    rate  (e_k - e_{k-1})/dt   their rate                         k = 0 … N-1

To add a weight, add a field to `Weights` and a line to `residuals`. Everything else follows: `charges` is the cost of
numbers (`benchmarks.objective`) and of CasADi symbols (`mpc.yardsticks.shooting`). `diagonal` has the weights by rows,
from which the QP (`mpc.tracking.qp.condense`, `mpc.tracking.compiled`, the exported C) and the terminal cost
(`mpc.tracking.terminal`) are built.
"""

from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import NamedTuple, Self

import numpy as np

from allocator import checks
from allocator.calculus import Array, Value
from allocator.units import BAR, DEG
from mpc.model.plant import NU


@dataclass(frozen=True)
class Weights:
    """Weights of the cost and of its slacks.

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
    terminal_rate: float = 1 / (0.05 * BAR) ** 2  # [cost]/[Pa/s]², beyond the horizon
    slack: float = 1e10  # ρ [cost]/[rad], joint range left
    slack_square: float = 1e10  # ρ₂ [cost]/[rad]²
    slack_force: float = 1e7  # ρ_F [cost]/[N], forces below the least one
    slack_force_square: float = 1e5  # ρ_F₂ [cost]/[N]²

    def __post_init__(self) -> None:
        """Raise `InvalidInput` unless all are positive, because otherwise the QP's solution is not unique."""
        for entry in fields(self):
            value = checks.positive(f"Weights: {entry.name}", getattr(self, entry.name), "-")
            object.__setattr__(self, entry.name, value)

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


NY = 1 + NU  # outputs: stiffness and both forces


class Residual(NamedTuple):
    """Quantity with one weight; its cost is half its square, summed over entries and samples."""

    weight: str  # field of `Weights`
    rows: str  # field of `Rows`
    entries: tuple[int, ...]  # of the row


def residuals(n: int = 1, m: int = 2, stiffnesses: int = 1) -> tuple[Residual, ...]:
    """Return the table for n joints and m muscles; a matrix K counts by svec K.

    `stiffnesses` is the number of entries of svec K, whose square is that of K's entries.
    """
    joints, stiffness, muscles = range(n), range(stiffnesses), range(m)
    return (
        Residual("theta", "x", tuple(joints)),  # θ_k - θ*_k
        Residual("omega", "x", tuple(n + i for i in joints)),  # ω_k - θ*'_k
        Residual("K", "y", tuple(stiffness)),  # K_k - K*_k
        Residual("u", "e", tuple(muscles)),  # e_k
        Residual("rate", "rate", tuple(muscles)),  # (e_k - e_{k-1})/dt
    )


class Rows(NamedTuple):
    """Rows of a sample by kind: residuals (numbers, arrays [size, ...] or symbols) or their weights (size,)."""

    x: Value  # 4
    y: Value  # 3
    e: Value  # 2
    rate: Value  # 2


STATES, COMMANDS = ("x", "y"), ("e", "rate")  # kinds of rows that the state and the commands have


def charges(weights: Weights, rows: Rows, kinds: Iterable[str] = Rows._fields) -> dict[str, Value]:
    """Return the cost by weight of those residuals in `rows` that are of the `kinds`."""
    return {
        r.weight: getattr(weights, r.weight) / 2 * sum(getattr(rows, r.rows)[i] ** 2 for i in r.entries)
        for r in residuals()
        if r.rows in kinds
    }


def diagonal(weights: Weights, n: int = 1, m: int = 2, stiffnesses: int = 1) -> Rows:
    """Return the weight of every entry of every kind of rows, 0 for free entries: the cost is ½ Σ w r²."""
    made = Rows(*map(np.zeros, (2 * n + m, stiffnesses + m, m, m)))
    for r in residuals(n, m, stiffnesses):
        getattr(made, r.rows)[list(r.entries)] += getattr(weights, r.weight)
    return made


def charged(weights: Array) -> list[tuple[int, float]]:
    """Return the nonzero entries (index, weight) of a diagonal."""
    return [(i, w) for i, w in enumerate(weights.tolist()) if w]
