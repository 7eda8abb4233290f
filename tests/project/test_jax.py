"""The function for JAX that the guide shows has the gradients that differences have."""

import re
from pathlib import Path

import numpy as np
import pytest

from allocator import allocate

GUIDE = Path(__file__).parents[2] / "docs" / "guides" / "learning.md"


@pytest.fixture(scope="module")
def pressures():
    blocks = re.findall(r"^```python\n(.*?)^```", GUIDE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    (block,) = [block for block in blocks if "custom_vjp" in block]
    names: dict = {}
    exec(block, names)
    return names["pressures"]


def differences(asked, h=1e-6):
    def both(row):
        found = allocate(*row)
        return np.array([found.P1, found.P2])

    return np.stack([(both(asked + h * e) - both(asked - h * e)) / (2 * h) for e in np.eye(3)], axis=-1)


@pytest.mark.slow
@pytest.mark.parametrize(
    "asked", [(0.3, 7.5, 1.0), (-0.5, 8.0, -2.0), (0.5, 12.0, 1.0)], ids=["free", "other", "limit"]
)
def test_gradients_are_differences(pressures, asked):
    import jax

    asked = np.array(asked)
    found = np.stack(jax.jacrev(pressures, argnums=(0, 1, 2))(*map(jax.numpy.asarray, asked)), axis=-1)
    expected = differences(asked)
    assert found == pytest.approx(expected, rel=1e-5, abs=1e-6 * np.abs(expected).max())


@pytest.mark.slow
def test_batches_are_mapped_and_compiled(pressures):
    import jax

    rng = np.random.default_rng(0)
    rows = np.stack([rng.uniform(-0.5, 0.5, 20), rng.uniform(7, 9, 20), rng.uniform(-1, 1, 20)])
    cost = jax.jit(jax.vmap(jax.grad(lambda theta, K, T: (pressures(theta, K, T) / 1e5).sum(), argnums=(0, 1, 2))))
    for i, gradient in enumerate(np.array(cost(*rows)).T):
        assert gradient == pytest.approx(differences(rows[:, i]).sum(axis=0) / 1e5, rel=1e-5, abs=1e-6)
    together = pressures(*map(jax.numpy.asarray, rows))
    assert np.asarray(together) == pytest.approx(np.stack([allocate(*rows).P1, allocate(*rows).P2], axis=-1))
