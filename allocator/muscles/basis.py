"""Basis of a force law: the functions of the pressure that it combines at a fixed contraction."""

from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np

from allocator.calculus import Array

Kind = Literal["rational", "exponential", "quadratic", "smooth"]


@dataclass(frozen=True)
class Basis:
    """A basis is the functions φ_j of F(P, ε) = Σ f_j(ε) φ_j(P) that are known, between two kinks of the law.

    "rational": 1, P, 1/(P + shape); "exponential": P, P E, P E² with E = exp(-P/shape); "quadratic": 1, P, P²;
    "smooth": Chebyshev polynomials, of which it takes as many as leave nothing but rounding.

    The coefficients f_j need not be written down, they follow from the law at as many pressures.
    """

    kind: Kind
    shape: float = 0.0  # [Pa]
    kinks: tuple[float, ...] = ()  # pressures at which ∂F/∂P may jump, rising [Pa]

    def nodes(self, lo: float, hi: float, size: int) -> Array:
        """Return `size` Chebyshev nodes between lo and hi [Pa] to sample a law at, those of E if there is one."""
        z = np.cos(np.pi * (np.arange(size) + 0.5) / size)
        if self.kind == "exponential":
            E = (1 + z) / 2 * (np.exp(-lo / self.shape) - np.exp(-hi / self.shape)) + np.exp(-hi / self.shape)
            return np.asarray(-self.shape * np.log(E))
        return np.asarray(lo + (hi - lo) * (1 + z) / 2)

    def functions(self, P: Array, lo: float, hi: float, size: int) -> Array:
        """Return φ_j at the pressures P (m,): (m, size); Chebyshev's are those of lo … hi."""
        if self.kind == "rational":
            return np.stack([np.ones_like(P), P, 1 / (P + self.shape)], 1)
        if self.kind == "exponential":
            E = np.exp(-P / self.shape)
            return np.stack([P, P * E, P * E**2], 1)
        if self.kind == "quadratic":
            return np.stack([np.ones_like(P), P, P**2], 1)
        return np.asarray(np.polynomial.chebyshev.chebvander((2 * P - lo - hi) / (hi - lo), size - 1), float)


@cache
def sampling(basis: Basis, lo: float, hi: float, size: int) -> tuple[Array, Array, Array]:
    """Return the nodes (size,) between lo and hi [Pa], the matrix from values to coefficients, the greatest |φ_j|."""
    nodes = basis.nodes(lo, hi, size)
    values = basis.functions(nodes, lo, hi, size)
    scale = np.abs(values).max(axis=0)
    return nodes, np.linalg.inv(values / scale) / scale[:, None], scale
