"""Where the search for a joint's muscles starts: an equation error, linear in a muscle F = P A(ε).

With A = α0 + α1 ε + α2 ε² the unloaded equilibrium a1 F1 - a2 F2 = 0 at the measured angles is linear in α, and the
convention mean A = 10 cm² keeps it from the solution zero. (With a passive force B(ε) it would explain everything by
forces near zero.) Any model is then fitted to these forces as if they had been measured, which
puts its parameters where the angles are about right.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.identification.joint.problem import CONVENTIONAL_AREA
from allocator.identification.joint.samples import JointSamples
from allocator.identification.muscle.fit import fit
from allocator.muscles import Muscle

_CONVENTION_WEIGHT = 1e3
_MOST_SAMPLES = 300  # of the pseudo-measurement


class PseudoForces(NamedTuple):
    """Pseudo-forces are those that explain the equilibria roughly."""

    contraction: Array  # (k,) [-]
    pressure: Array  # (k,) [Pa]
    force: Array  # (k,) [N]


def pseudo_forces(samples: JointSamples) -> PseudoForces:
    """Return the forces of both muscles at the samples."""
    (eps1, a1, _), (eps2, a2, _), _ = samples.routes(np.clip(samples.theta, *samples.reach()))
    one, two = _basis(samples.P1, eps1), _basis(samples.P2, eps2)  # (n, 3)
    still = samples.torque == 0 if (samples.torque == 0).sum() > 3 else np.ones(samples.n, bool)
    rows = (a1[:, None] * one - a2[:, None] * two)[still]
    convention = _basis(1.0, eps1).mean(axis=0)
    size = np.linalg.norm(rows, axis=0)
    size[size == 0] = 1.0
    scale = np.linalg.norm(rows) / np.linalg.norm(convention)
    A = np.vstack([rows, _CONVENTION_WEIGHT * scale * convention])
    b = np.append(np.zeros(still.sum()), _CONVENTION_WEIGHT * scale)
    p = np.linalg.lstsq(A / size, b, rcond=1e-9)[0] / size
    F = np.concatenate([one @ p, two @ p]) * CONVENTIONAL_AREA
    return PseudoForces(np.concatenate([eps1, eps2]), np.concatenate([samples.P1, samples.P2]), F)


def _basis(P: Array | float, eps: Array) -> Array:
    return np.stack([P + 0 * eps, P * eps, P * eps**2], axis=1)


def starting_muscle(model: type[Muscle], samples: JointSamples, hold: Mapping[str, float]) -> Muscle:
    """Return the muscle of this model that comes nearest to the pseudo-forces."""
    eps, P, F = pseudo_forces(samples)
    every = max(1, eps.size // _MOST_SAMPLES)
    try:
        return fit(model, eps[::every], P[::every], F[::every], hold=hold, folds=0).muscle
    except InvalidInput as error:
        raise InvalidInput(
            f"no start for {model.__name__} was found in these equilibria ({error}); pass start="
        ) from None


__all__ = ["PseudoForces", "pseudo_forces", "starting_muscle"]
