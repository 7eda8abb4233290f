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
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array, Value
from mpc.model.plant import NU
from mpc.tracking.weights import Weights

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
