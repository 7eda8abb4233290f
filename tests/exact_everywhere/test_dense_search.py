"""The dense search is checked by closed forms, by random pressures and by a global optimiser."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import differential_evolution

from allocator import Status, allocate

from .curves import image
from .dense_search import best, search
from .joints import joint_of
from .judge import PRIORITIES, WEIGHTS, asked, excess_of, false_intervals, judged
from .targets import random_targets

CURVED = ("TonduLopez2000", "Wickramatunge2010", "Andrikopoulos2016", "Tondu2021", "Tondu2021-report")


def setting(muscle, geometry, angles, each, seed=5):
    joint, rng = joint_of(muscle, geometry), np.random.default_rng(seed)
    reach = image(joint, np.sort(rng.uniform(*joint.angle_range, angles)))
    return joint, reach, random_targets(reach, each, rng)


def relative(reach, targets, T_error, K_error):
    return np.abs(np.stack([T_error / reach.T_scale[targets.row], K_error / reach.K_scale[targets.row]]))


@pytest.mark.parametrize("priority", PRIORITIES)
@pytest.mark.parametrize("muscle", ["Sarosi2012", "Hogan1984", "MartensBoblan2017"])
def test_on_affine_muscles_it_finds_the_closed_form(muscle, priority):
    joint, reach, targets = setting(muscle, "table", 8, 40)
    theta, weights = reach.theta[targets.row], WEIGHTS if priority == "weighted" else None
    right = allocate(theta, targets.K, targets.T, joint=joint, priority=priority, weights=weights)
    found = search(joint, reach, targets, priority, WEIGHTS)
    errors = [relative(reach, targets, answer.T_error, answer.K_error) for answer in (right, found)]
    scales = reach.T_scale[targets.row], reach.K_scale[targets.row]
    for one, other in (errors, errors[::-1]):
        assert not (excess_of(one, other, priority, scales) > 0).any()


@pytest.mark.parametrize("priority", PRIORITIES)
@pytest.mark.parametrize("muscle", CURVED)
def test_no_random_pressures_are_better(muscle, priority):
    joint, reach, targets = setting(muscle, "lever-B", 4, 5)
    found, rng = search(joint, reach, targets, priority, WEIGHTS), np.random.default_rng(6)
    mine = relative(reach, targets, found.T_error, found.K_error)
    scales = reach.T_scale[targets.row], reach.K_scale[targets.row]
    for _ in range(200):
        shares = rng.beta(0.5, 0.5, size=(2, targets.T.size))
        P1, P2 = (
            lo[targets.row] + share * (hi - lo)[targets.row]
            for share, lo, hi in zip(shares, reach.lo, reach.hi, strict=True)
        )
        theta = reach.theta[targets.row]
        errors = joint.torque(theta, P1, P2) - targets.T, joint.stiffness(theta, P1, P2) - targets.K
        assert not (excess_of(mine, relative(reach, targets, *errors), priority, scales) > 0).any()


@pytest.mark.parametrize("muscle", CURVED)
def test_differential_evolution_finds_nothing_better(muscle):
    joint, reach, targets = setting(muscle, "lever-A", 1, 2)
    (theta,), found = reach.theta, search(joint, reach, targets, "weighted", WEIGHTS)
    for i, (T, K) in enumerate(zip(targets.T, targets.K, strict=True)):

        def cost(P, T=T, K=K):
            return WEIGHTS[0] * (joint.torque(theta, *P) - T) ** 2 + WEIGHTS[1] * (joint.stiffness(theta, *P) - K) ** 2

        bounds = [(float(lo[0]), float(hi[0])) for lo, hi in zip(reach.lo, reach.hi, strict=True)]
        other = differential_evolution(
            cost, bounds, rng=1, tol=1e-10, maxiter=200, polish=False, vectorized=True, updating="deferred"
        )
        mine = WEIGHTS[0] * found.T_error[i] ** 2 + WEIGHTS[1] * found.K_error[i] ** 2
        assert mine <= other.fun * (1 + 1e-9) + 1e-12
        assert mine == pytest.approx(other.fun, rel=0.5, abs=1e-6)  # it may stay in a local minimum


def test_where_no_pressures_are_taut_nothing_is_found():
    joint = joint_of("Tondu2021", "pulley")
    found = best(joint, [0.0, joint.angle_range[1]], [0.0, 0.0], [8.0, 8.0], "torque")
    assert np.isfinite(found.P1[0])
    assert np.isnan(found.P1[1])


@pytest.mark.parametrize("priority", PRIORITIES)
def test_what_is_wrong_with_answers_is_found_out(priority):
    joint, reach, targets = setting("Sarosi2012", "table", 6, 20)
    right = asked(joint, reach, targets, priority)
    assert not any(np.any(flags) for flags in judged(joint, reach, targets, priority, right))
    assert not false_intervals(joint, reach, targets, right).any()

    def verdict(**changed):
        return judged(joint, reach, targets, priority, replace(right, **changed))

    lo, hi = (ends[0][targets.row] for ends in (reach.lo, reach.hi))
    moved = np.where(right.P1 > (lo + hi) / 2, right.P1 - 1e-4 * (hi - lo), right.P1 + 1e-4 * (hi - lo))
    assert verdict(P1=moved).beaten.all()
    assert verdict(P1=hi + 10.0).outside.all()
    assert verdict(P1=np.full(hi.shape, np.nan)).beaten.all()
    exact = right.status == Status.EXACT
    refused = verdict(status=np.where(exact, np.int8(Status.STIFFNESS_LIMITED), right.status))
    np.testing.assert_array_equal(refused.refused, exact)
    np.testing.assert_array_equal(refused.false_status, exact)
    assert exact.any()
    assert not exact.all()
    assert verdict(status=np.zeros_like(right.status)).false_status[~exact].all()


@pytest.mark.parametrize("reversed_ends", [True, False])
def test_a_false_interval_is_found_out(reversed_ends):
    joint, reach, targets = setting("Sarosi2012", "table", 2, 5)
    right = asked(joint, reach, targets, "torque")
    wide = np.subtract(*right.stiffness_interval) < -1e-3
    assert wide.any()
    answer = replace(right)
    low, high = right.stiffness_interval
    answer.__dict__["stiffness_interval"] = (high, low) if reversed_ends else (low, 0.9 * high)
    assert false_intervals(joint, reach, targets, answer)[wide].all()
