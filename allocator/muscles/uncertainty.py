"""How a muscle's force and stiffness depend on its parameters: what the delta method needs.

A quantity y(p) of a muscle whose parameters p have the covariance C has, to first order, the variance

    var y = g C gᵀ,   g = ∂y/∂p

Where several muscles share the parameters (a joint with two of the same kind) their gradients are added first.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.muscles.base import Muscle

_STEP = 1e-30  # of the complex step, absolute
_CONTRACTION_STEP = 1e-5  # of the central difference in ε [-]


class ParameterSensitivities(NamedTuple):
    """Sensitivities are gradients with respect to the parameters; (…) is the broadcast shape of pressure and
    contraction.
    """

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


def force_gradient(muscle: Muscle, P: Array, eps: Array, names: tuple[str, ...] | None = None) -> Array:
    """Return ∂F/∂p (…, m) for the parameters `names` (default: all), exact to rounding by complex steps."""
    values = list(muscle.parameters.values())
    places = [i for i, name in enumerate(muscle.parameters) if names is None or name in names]
    P, eps = np.broadcast_arrays(np.asarray(P, float), np.asarray(eps, float))
    columns = np.zeros((*P.shape, len(places)))
    for column, i in enumerate(places):
        moved = muscle.unchecked([*values[:i], values[i] + _STEP * 1j, *values[i + 1 :]])
        columns[..., column] = np.imag(moved.law(P, eps)) / _STEP
    return columns


def parameter_sensitivities(muscle: Muscle, P: Array, eps: Array) -> ParameterSensitivities:
    """Return ∂F/∂p and ∂F_ε/∂p at pressure `P` [Pa] and contraction `eps` [-], which broadcast.

    The first is exact; the second its central difference in ε with a step of 1e-5 (relative error about 1e-9).
    """
    h = _CONTRACTION_STEP
    ahead, behind = (force_gradient(muscle, P, np.asarray(eps, float) + step) for step in (h, -h))
    return ParameterSensitivities(tuple(muscle.parameters), force_gradient(muscle, P, eps), (ahead - behind) / (2 * h))


def standard_deviation(muscle: Muscle, gradient: Array) -> Array:
    """Return √(g C gᵀ) (…) of a quantity with the `gradient` g (…, m) in the parameters of a fitted muscle.

    Only what the samples did not determine is missing from it: the error of the law itself is not in the covariance.
    Raises `InvalidInput` if the muscle has no covariance.
    """
    if muscle.covariance is None:
        raise InvalidInput(f"this {type(muscle).__name__} has no covariance: it was not fitted")
    variance = np.einsum("...i,ij,...j->...", gradient, np.asarray(muscle.covariance), gradient)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))  # -1e-20 by rounding is 0


def force_std(muscle: Muscle, P: Array, eps: Array) -> Array:
    """Return the standard deviation of F(P, ε) [N] from the covariance of the parameters."""
    return standard_deviation(muscle, force_gradient(muscle, P, eps))


def slope_std(muscle: Muscle, P: Array, eps: Array) -> Array:
    """Return the standard deviation of F_ε(P, ε) [N] from the covariance of the parameters."""
    return standard_deviation(muscle, parameter_sensitivities(muscle, P, eps).slope)
