"""With a co-contraction floor the search stays complete: nothing of a grid above the floor is better."""

import numpy as np
import pytest

from allocator import Limits, allocate
from tests.exact_everywhere.joints import joint_of

JOINTS = [
    ("Tondu2021", "lever-A"),
    ("TonduLopez2000", "lever-B"),
    ("Wickramatunge2010", "table"),
    ("Sarosi2012", "pulley"),
]
WEIGHTS = (1.0, 0.3)


def above_floor(joint, theta, least_sum, n=161):
    """Pressures (P1, P2) of a grid of the box above the floor, the floor itself among them."""
    box = joint.pressure_box(theta, Limits(min_force=0.0))
    (lo1, hi1), (lo2, hi2) = ((float(side.lo), float(side.hi)) for side in box)
    P1, P2 = (P.ravel() for P in np.meshgrid(np.linspace(lo1, hi1, n), np.linspace(lo2, hi2, n)))
    keep = P1 + P2 >= least_sum
    floor = np.linspace(max(lo1, least_sum - hi2), min(hi1, least_sum - lo2), 2001)
    return np.concatenate([P1[keep], floor]), np.concatenate([P2[keep], least_sum - floor])


@pytest.mark.parametrize("priority", ["torque", "stiffness", "weighted"])
@pytest.mark.parametrize(("muscle", "geometry"), JOINTS)
def test_nothing_above_the_floor_is_better(muscle, geometry, priority):
    joint, rng = joint_of(muscle, geometry), np.random.default_rng(2)
    options = {"priority": priority, "weights": WEIGHTS if priority == "weighted" else None, "joint": joint}
    for theta in rng.uniform(*joint.angle_range, 8):
        box = joint.pressure_box(theta, Limits(min_force=0.0))
        share = rng.uniform(0.1, 0.9)
        least_sum = sum(float(side.lo + share * (side.hi - side.lo)) for side in box)
        P1, P2 = above_floor(joint, theta, least_sum)
        T, K = joint.torque(theta, P1, P2), joint.stiffness(theta, P1, P2)
        made = rng.integers(P1.size)
        targets = [(T[made], K[made])] + [
            (rng.choice(T) * 1.2, rng.choice(K) * rng.uniform(0.8, 1.3)) for _ in range(4)
        ]
        for T_target, K_target in targets:
            a = allocate(theta, K_target, T_target, limits=Limits(min_cocontraction=least_sum / 2), **options)
            assert a.P1 + a.P2 >= least_sum - 1e-6
            e_T, e_K = np.abs(T - T_target), np.abs(K - K_target)
            mine_T, mine_K = abs(a.T_error), abs(a.K_error)
            if priority == "weighted":
                cost, mine = WEIGHTS[0] * e_T**2 + WEIGHTS[1] * e_K**2, WEIGHTS[0] * mine_T**2 + WEIGHTS[1] * mine_K**2
                assert mine <= cost.min() * (1 + 1e-9) + 1e-9
            else:
                first, mine = (e_T, mine_T) if priority == "torque" else (e_K, mine_K)
                assert mine <= first.min() + 1e-9 * (np.abs(T).max() + np.abs(K).max())
            assert a.gap <= 1e-9
        assert allocate(theta, K[made], T[made], limits=Limits(min_cocontraction=least_sum / 2), **options).success
