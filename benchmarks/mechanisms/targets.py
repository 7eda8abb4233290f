"""Machines and targets of the measurements."""

from typing import NamedTuple

import numpy as np

from allocator.allocation.box.arguments import problem_from
from allocator.allocation.box.problem import BoxProblem
from allocator.mechanism import Mechanism, Pulleys, machines
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N

POSTURE = np.array([0.4, -0.3])


class Targets(NamedTuple):
    """Targets of a mechanism at a posture (n,) or at postures (N, n); the first half is feasible."""

    mechanism: Mechanism
    q: np.ndarray
    T: np.ndarray  # (N, n)
    K: np.ndarray  # (N, n, n)

    @property
    def problem(self) -> BoxProblem:
        """Problem of the library."""
        return problem_from(self.mechanism, self.q, self.K, self.T)[0]


def random_targets(mechanism: Mechanism, q: np.ndarray, N: int, seed: int = 0) -> Targets:
    """Return half made by random taut pressures, half with up to 4 times such torques and 0.4 to 2.5 times the
    stiffness.
    """
    rng = np.random.default_rng(seed)
    P = rng.uniform(*mechanism.pressure_box(q), (N, mechanism.m))
    T, K = np.array(mechanism.torque(q, P)), np.array(mechanism.stiffness(q, P))
    far = N - N // 2
    T[N // 2 :] *= rng.uniform(1, 4, (far, 1))
    K[N // 2 :] *= rng.uniform(0.4, 2.5, (far, 1, 1))
    order = rng.permutation(N)
    return Targets(mechanism, q if q.ndim == 1 else q[order], T[order], K[order])


def arm_at_postures(N: int, seed: int = 0) -> Targets:
    """Return targets of the arm with six muscles, each at its own posture."""
    q = np.random.default_rng(seed).uniform(-0.8, 0.8, (N, 2))
    return random_targets(machines.arm26(), q, N, seed)


def random_mechanism(n: int, m: int, seed: int = 0) -> Mechanism:
    """Return a mechanism with pulleys at one to three joints per muscle, and muscles of both signs at every joint."""
    rng = np.random.default_rng(seed)
    arms = np.zeros((m, n))
    for j in range(m):
        arms[j, j % n] = 0.02 * (1 if (j // n) % 2 == 0 else -1) * rng.uniform(0.7, 1.3)
        for other in rng.choice(n, size=min(n, int(rng.integers(0, 3))), replace=False):
            arms[j, other] += rng.uniform(-0.015, 0.015)
    return Mechanism(Pulleys(0.4, arms, 0.1375), SAROSI_DMSP_20_400N)
