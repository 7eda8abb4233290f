"""Test sets of targets."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from allocator import DEG, AntagonistJoint, Lever, Pulley, allocate, report_joint
from allocator.muscles.catalogue import SAROSI_DMSP_20_200N, SAROSI_DMSP_20_400N, TONDU_MCKIBBEN

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

STRETCH = 3.0  # width of random targets relative to the feasible set
TURN = 2 * np.pi  # [rad] `allocate` refuses more than a turn as degrees
STOPS = (-80 * DEG, 80 * DEG)
LEVER = Lever(rest_length=0.40, anchor=0.30, lever=0.03, offset=0.0435)

JOINTS = {
    "Tondu2021 on a pulley (the report's)": report_joint(),
    "Sarosi2012 on a pulley": AntagonistJoint(
        Pulley(0.40, 0.02, 0.1375), SAROSI_DMSP_20_400N, SAROSI_DMSP_20_400N, angle_limits=STOPS
    ),
    "Sarosi2012 (400N, 200N) on a lever": AntagonistJoint(
        LEVER, SAROSI_DMSP_20_400N, SAROSI_DMSP_20_200N, angle_limits=STOPS
    ),
    "ideal McKibben on a pulley": AntagonistJoint(
        Pulley(0.40, 0.02, 0.185), TONDU_MCKIBBEN, TONDU_MCKIBBEN, angle_limits=STOPS
    ),
}


@dataclass(frozen=True)
class TargetSet:
    """n targets of one joint; arrays (n,)."""

    name: str
    joint_name: str
    theta: Array  # [rad]
    K: Array  # [N·m/rad]
    T: Array  # [N·m]

    @property
    def joint(self) -> AntagonistJoint:
        """Joint of the targets."""
        return JOINTS[self.joint_name]

    @cached_property
    def reached(self) -> Array:
        """Nearest feasible angle [rad] to the requested one, at which pressures are judged."""
        return np.clip(self.theta, *self.joint.angle_range)

    @property
    def in_range(self) -> Flags:
        """Whether the angle is feasible."""
        return np.asarray(self.theta == self.reached)

    @cached_property
    def torque_reachable(self) -> Flags:
        """Whether angle and torque are feasible within all limits, for any stiffness."""
        T_min, T_max = allocate(self.theta, self.K, self.T, joint=self.joint).torque_interval
        return np.asarray(self.in_range & (T_min <= self.T) & (self.T <= T_max))

    def take(self, index: slice) -> Self:
        """Return a part of the targets."""
        return replace(self, theta=self.theta[index], K=self.K[index], T=self.T[index])

    def thinned(self, n: int) -> Self:
        """Return about n of the targets, evenly spread."""
        return self.take(slice(None, None, max(1, self.theta.size // n)))


def report_grid(angles: int, stiffnesses: int) -> TargetSet:
    """Return the ranges of the report's Fig. 8: K = 6…9 N·m/rad, θ = ±125°, T = 0."""
    theta, K = np.meshgrid(np.linspace(-125, 125, angles) * DEG, np.linspace(6, 9, stiffnesses))
    return TargetSet("Fig. 8", next(iter(JOINTS)), theta.ravel(), K.ravel(), np.zeros(theta.size))


def random_targets(joint_name: str, n: int, seed: int) -> TargetSet:
    """Return θ, and T and K at the nearest angle inside, over three times the feasible ranges (|θ| ≤ 2π, K > 0)."""
    rng, joint = np.random.default_rng(seed), JOINTS[joint_name]
    left, right = widened(np.array(joint.angle_range[0]), np.array(joint.angle_range[1]))
    theta = rng.uniform(max(left, -TURN), min(right, TURN), n)
    at = np.clip(theta, *joint.angle_range)
    agonist, antagonist = joint.pressure_box(at)
    corners = [(P1, P2) for P1 in (agonist.lo, agonist.hi) for P2 in (antagonist.lo, antagonist.hi)]
    T = rng.uniform(*widened(*extremes(np.array([joint.torque(at, *corner) for corner in corners]))))
    K_low, K_high = widened(*extremes(np.array([joint.stiffness(at, *corner) for corner in corners])))
    return TargetSet("random", joint_name, theta, rng.uniform(np.maximum(K_low, 0.01), K_high), T)


def feasible_targets(joint_name: str, n: int, seed: int) -> TargetSet:
    """Return T and K of random pressures within all limits at random angles, without K ≤ 0 (on levers)."""
    rng, joint = np.random.default_rng(seed), JOINTS[joint_name]
    theta = rng.uniform(*joint.angle_range, 4 * n)
    P1, P2 = (rng.uniform(side.lo, side.hi) for side in joint.pressure_box(theta))
    K, T = joint.stiffness(theta, P1, P2), joint.torque(theta, P1, P2)
    stable = np.flatnonzero(K > 0)[:n]
    return TargetSet("feasible", joint_name, theta[stable], K[stable], T[stable])


def extremes(corners: Array) -> tuple[Array, Array]:
    return corners.min(axis=0), corners.max(axis=0)


def widened(low: Array, high: Array) -> tuple[Array, Array]:
    """Return the interval stretched about its middle."""
    middle, half = (low + high) / 2, STRETCH * (high - low) / 2
    return middle - half, middle + half


def test_sets(quick: bool) -> Iterator[TargetSet]:
    """Return every set of the comparison."""
    yield report_grid(*((7, 4) if quick else (51, 13)))
    for seed, name in enumerate(JOINTS):
        yield random_targets(name, 24 if quick else 900, seed)
