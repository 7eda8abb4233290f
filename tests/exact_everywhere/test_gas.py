"""No pressures are better than the answers for a stiffness with trapped gas, on every geometry.

The dense search uses only a joint's values at given pressures: those of a joint with shut valves, or at a frequency. A
law with a gas stiffness that jumps with the pressure (Wickramatunge2010) has a separate test by a grid, since the dense
search requires smoothness between samples.
"""

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest

from allocator import Status, Stiffness, allocate
from allocator.allocation.optimisers.backends import CERTIFIED
from allocator.joint.gas import StiffnessKind

from .curves import image
from .dense_search import Targets
from .joints import GEOMETRIES, joint_of
from .judge import PRIORITIES, WEIGHTS, false_intervals, judged
from .targets import made_targets, random_targets

ANGLES, EACH = 1, 6
KINDS = {
    "shut": StiffnessKind.of("shut"),
    "agonist-shut": StiffnessKind.of((True, False)),
    "2 Hz": StiffnessKind.of("open", 2.0, (0.1, 0.03)),
}
CASES = [
    *product(("Tondu2021-report", "Tondu2021"), GEOMETRIES),
    *product(("TonduLopez2000",), ("pulley", "table")),
    *product(("Andrikopoulos2016",), ("lever-A", "lever-B")),
    *product(("Sarosi2012", "TableMuscle", "MartensBoblan2017"), ("lever-B", "table")),
]


class FeltJoint:
    """Joint whose stiffness includes trapped gas, for the dense search."""

    def __init__(self, joint, kind):
        self.real, self.kind = joint, kind

    def __getattr__(self, name):
        return getattr(self.real, name)

    def sides(self, theta):
        return self.real.sides(theta, self.kind.fixed)

    def stiffness(self, theta, P1, P2):
        one, two = self.sides(theta)
        return one.stiffness(P1) + two.stiffness(P2)

    def jacobian(self, theta, P1, P2):
        one, two = self.sides(theta)
        torque, _ = self.real.jacobian(theta, P1, P2)
        return torque, (one.stiffness_gain(P1), two.stiffness_gain(P2))


def filled_joint(muscle, geometry):
    joint = joint_of(muscle, geometry)
    filled = replace(joint.agonist, rest_volume=1.2e-4, tube_volume=2e-5)
    return replace(joint, agonist=filled, antagonist=replace(filled, tube_volume=4e-5))


@cache
def reach_of(muscle, geometry, kind):
    """Return the joint, its reach at angles without a limit by the gas, and targets there: random and made ones."""
    real, rng = filled_joint(muscle, geometry), np.random.default_rng(18)
    joint, (left, right) = FeltJoint(real, KINDS[kind]), real.angle_range
    theta = np.sort(left + rng.uniform(0.02, 0.98, 12 * ANGLES) * (right - left))
    box = real.box(theta, shares=KINDS[kind].fixed)
    most = [min(real.pressure_limits[1], m.max_pressure) for m in (real.agonist, real.antagonist)]
    free = np.all([interval.hi == P for interval, P in zip(box, most, strict=True)], axis=0)
    reach = image(joint, theta[free])
    reach = reach.take(np.linspace(0, reach.theta.size - 1, ANGLES + 2)[1:-1].astype(int))
    both = random_targets(reach, EACH, rng), made_targets(joint, reach, EACH, rng)
    return joint, reach, *both


@pytest.fixture(params=CASES, ids="-".join)
def case(request):
    """Return a kind for each joint, so that every geometry occurs with all of them."""
    kinds = list(KINDS)
    return reach_of(*request.param, kinds[CASES.index(request.param) % len(kinds)])


@pytest.fixture(params=PRIORITIES)
def priority(request):
    return request.param


def asked(joint, reach, targets, priority):
    weights, theta = WEIGHTS if priority == "weighted" else None, reach.theta[targets.row]
    return allocate(
        theta,
        targets.K,
        targets.T,
        joint=joint.real,
        priority=priority,
        weights=weights,
        stiffness=Stiffness(joint.kind),
    )


@pytest.mark.slow
def test_no_answer_is_beaten_and_no_status_is_false(case, priority):
    joint, reach, *both = case
    targets = Targets(*map(np.concatenate, zip(*both, strict=True)))
    answer = asked(joint, reach, targets, priority)
    verdict = judged(joint, reach, targets, priority, answer)
    assert not verdict.outside.any()
    assert not verdict.beaten.any(), f"{verdict.beaten.sum()} of {verdict.beaten.size}, by {verdict.excess.max():.1e}"
    assert not verdict.refused.any(), f"{verdict.refused.sum()} of {verdict.refused.size}"
    assert not verdict.false_status.any()
    assert not verdict.unequalled.any(), "the dense search is not dense enough to judge"
    assert (answer.gap <= 1e-11).all()
    assert (answer.kkt_residual <= CERTIFIED).all()


@pytest.mark.slow
def test_the_intervals_are_those_of_the_dense_search(case):
    """They depend on the torque of the answer, and not on the priority that led to it."""
    joint, reach, *both = case
    targets = Targets(*map(np.concatenate, zip(*both, strict=True)))
    assert not false_intervals(joint, reach, targets, asked(joint, reach, targets, "weighted")).any()


@pytest.mark.parametrize("muscle", ["Sarosi2012", "Tondu2021-report", "TonduLopez2000"])
@pytest.mark.parametrize("kind", KINDS)
def test_what_pressures_in_the_box_made_is_met(muscle, kind, priority):
    joint, reach, _random, made = reach_of(muscle, "lever-A", kind)
    assert made.T.size
    assert asked(joint, reach, made, priority).success.all()


@pytest.mark.parametrize("priority", ["torque", "stiffness", "weighted"])
def test_a_stiffness_that_jumps_with_the_pressure_is_searched_on_both_sides(priority):
    """Compare with a grid of 400 × 400 pressures; lexicographic answers may only be better in the first goal."""
    joint, rng = filled_joint("Wickramatunge2010", "lever-A"), np.random.default_rng(3)
    theta = 0.2
    box = joint.box(np.array([theta]), shares=(1.0, 1.0))
    P1, P2 = (np.linspace(side.lo[0], side.hi[0], 400) for side in box)
    assert P1[0] < 2.5e5 < P1[-1]  # the kink
    P1, P2 = P1[:, None], P2[None]
    T, K = joint.torque(theta, P1, P2), joint.stiffness(theta, P1, P2, valves="shut")
    w_T, w_K = WEIGHTS
    weights = WEIGHTS if priority == "weighted" else None
    for _ in range(30):
        i, j = rng.integers(0, 400, 2)
        made = rng.uniform() < 0.5
        T_asked, K_asked = (T[i, j], K[i, j]) if made else (rng.uniform(-40, 40), rng.uniform(5, 120))
        a = allocate(
            theta, K_asked, T_asked, joint=joint, stiffness=Stiffness("shut"), priority=priority, weights=weights
        )
        assert joint.stiffness(theta, a.P1, a.P2, valves="shut") == pytest.approx(a.K, rel=1e-12)
        assert not made or a.status == Status.EXACT
        cost = w_T * (T - T_asked) ** 2 + w_K * (K - K_asked) ** 2
        mine = w_T * a.T_error**2 + w_K * a.K_error**2
        if priority == "weighted":
            assert mine <= cost.min() * (1 + 1e-9) + 1e-12
        else:
            first, error = (T, T_asked) if priority == "torque" else (K, K_asked)
            assert abs((a.T_error, a.K_error)[priority != "torque"]) <= np.abs(first - error).min() + 1e-9
