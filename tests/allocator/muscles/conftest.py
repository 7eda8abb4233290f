"""The muscles over which the contract is tested: every published parameter set, and every model fitted to a table."""

from functools import cache

import numpy as np
import pytest

from allocator.calculus import exp
from allocator.identification import fit, load_dataset
from allocator.muscles import MODELS, FunctionMuscle, Hogan1984, PolynomialMcKibben, Tondu2021
from allocator.muscles.catalogue import MUSCLES
from allocator.units import BAR, DEG

PUBLISHED = {
    **MUSCLES,
    "hogan": Hogan1984(1500.0, 0.30, 5 * BAR),
    "tondu-with-c": Tondu2021.identify(0.0109, 25.5 * DEG, low=(3 * BAR, 0.225), high=(5 * BAR, 0.275), c=5 * BAR),
    "polynomial-3-4-5-bar": PolynomialMcKibben.identify(
        0.0109, 25.5 * DEG, (3 * BAR, 4 * BAR, 5 * BAR), (0.225, 0.253, 0.275)
    ),
    "two-functions": FunctionMuscle(lambda e: 3e-3 - 1e-2 * e, lambda e: -200 * (1 - exp(-20 * e))),
}
FITTED = {f"{name}-fitted-to-the-measured-map": model for name, model in MODELS.items()}


@cache
def fitted(model):
    map_ = load_dataset("dmsp-20-300-map")
    return fit(model, map_.contraction, map_.pressure, map_.force, folds=0).muscle


@pytest.fixture(scope="session", params=[*PUBLISHED, *FITTED])
def muscle(request):
    name = request.param
    return PUBLISHED[name] if name in PUBLISHED else fitted(FITTED[name])


@pytest.fixture
def domain(muscle):
    """Pressures [12, 1] and contractions [25] that the muscle covers, up to 6 bar."""
    highest = min(muscle.max_pressure, 6 * BAR)
    P = np.linspace(0.07, 1, 12)[:, None] * highest  # none at 2.5 bar, where Wickramatunge's law has a kink
    least, most = max(muscle.min_contraction, 0.0), min(muscle.max_contraction, 0.26)
    return P, least + (most - least) * np.linspace(0.01, 0.99, 25)


@pytest.fixture
def taut(muscle, domain):
    """Pressures and contractions [n] at which the muscle pulls."""
    P, eps = np.broadcast_arrays(*domain)
    pulls = (muscle.force(P, eps) > 1.0) & muscle.covers(P, eps)
    assert pulls.sum() > 40
    return P[pulls], eps[pulls]
