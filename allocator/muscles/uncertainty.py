"""Derivatives of a muscle's force and stiffness by its parameters, for the delta method.

A quantity y(p) of a muscle whose parameters p have the covariance C has, to first order, the variance

    var y = g C gᵀ,   g = ∂y/∂p

Where several muscles share the parameters (a joint with two of the same kind) their gradients are added first.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.muscles.base import Muscle

_STEP = 1e-30  # of the complex step, absolute
_CONTRACTION_STEP = 1e-5  # of the central difference in ε [-]


class ParameterSensitivities(NamedTuple):
    """Gradients by the parameters; (…) is the broadcast shape of pressure and contraction."""

    names: tuple[str, ...]  # m names, as in `Muscle.parameters`
    force: Array  # ∂F/∂p (…, m) [N / unit of p]
    slope: Array  # ∂F_ε/∂p (…, m) [N / unit of p]


def covariance_root(covariance: ArrayLike) -> Array:
    """Return L (m, m) with L Lᵀ = `covariance`, from its eigenvalues: directions that the data left open have none.

    The parameters are scaled first: their units differ by powers of ten, and rounding would drown the small ones.
    """
    C = np.asarray(covariance, float)
    scale = np.sqrt(np.maximum(np.diag(C), 1e-300))
    values, vectors = np.linalg.eigh(C / np.outer(scale, scale))
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def parameter_gradient(
    muscle: Muscle, quantity: Callable[[Muscle], Value], shape: tuple[int, ...], names: Sequence[str] | None = None
) -> Array:
    """Return ∂(quantity)/∂p (*shape, m) for the parameters `names` (default: all), exact by complex steps."""
    parameters = muscle.parameters
    names = [*parameters] if names is None else names
    gradient = np.zeros((*shape, len(names)))
    for column, name in enumerate(names):
        moved = muscle.unchecked([*(parameters | {name: parameters[name] + _STEP * 1j}).values()])
        gradient[..., column] = np.imag(quantity(moved)) / _STEP
    return gradient


def force_gradient(muscle: Muscle, P: ArrayLike, eps: ArrayLike, names: Sequence[str] | None = None) -> Array:
    """Return ∂F/∂p (…, m) for the parameters `names` (default: all), exact to rounding."""
    P, eps = np.broadcast_arrays(np.asarray(P, float), np.asarray(eps, float))
    return parameter_gradient(muscle, lambda m: m.law(P, eps), P.shape, names)


def parameter_sensitivities(muscle: Muscle, P: Array, eps: Array) -> ParameterSensitivities:
    """Return ∂F/∂p and ∂F_ε/∂p at pressure `P` [Pa] and contraction `eps` [-], which broadcast.

    The first is exact; the second its central difference in ε with a step of 1e-5 (relative error about 1e-9).
    """
    h = _CONTRACTION_STEP
    ahead, behind = (force_gradient(muscle, P, np.asarray(eps, float) + step) for step in (h, -h))
    return ParameterSensitivities(tuple(muscle.parameters), force_gradient(muscle, P, eps), (ahead - behind) / (2 * h))


def deviation(gradient: Array, covariance: Array) -> Array:
    """Return √(g C gᵀ) (…) of a quantity with the `gradient` g (…, m) in parameters of the `covariance` C (m, m)."""
    variance = np.einsum("...i,ij,...j->...", gradient, covariance, gradient)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))  # -1e-20 by rounding is 0


def standard_deviation(muscle: Muscle, gradient: Array) -> Array:
    """Return √(g C gᵀ) (…) of a quantity with the `gradient` g (…, m) in the parameters of a fitted muscle.

    The covariance contains the noise of the samples, and not the error of the law itself.
    Raises `InvalidInput` if the muscle has no covariance.
    """
    if muscle.covariance is None:
        raise InvalidInput(f"this {type(muscle).__name__} has no covariance: it was not fitted")
    return deviation(gradient, np.asarray(muscle.covariance))


def force_std(muscle: Muscle, P: Array, eps: Array) -> Array:
    """Return the standard deviation of F(P, ε) [N] from the covariance of the parameters."""
    return standard_deviation(muscle, force_gradient(muscle, P, eps))


def slope_std(muscle: Muscle, P: Array, eps: Array) -> Array:
    """Return the standard deviation of F_ε(P, ε) [N] from the covariance of the parameters."""
    return standard_deviation(muscle, parameter_sensitivities(muscle, P, eps).slope)
