"""The angle after a history of pressures, against plants that are integrated through it in small steps."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from allocator import BAR, DEG, PrandtlIshlinskii, report_joint
from allocator.errors import InvalidInput
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N

JOINT = report_joint(SAROSI_DMSP_20_400N)
OPERATOR = PrandtlIshlinskii((0.6, 0.25, 0.15), (2 * DEG, 6 * DEG), base=0.4)
TURNS = np.array([(2.5, 2.5), (3.2, 1.9), (2.2, 2.6), (2.9, 2.2), (3.4, 3.0)]) * BAR  # where the pressures turn round


def ramps(between):
    """Pressures from turn to turn, `between` a ramp."""
    share = np.linspace(0, 1, between, endpoint=False)[:, None]
    pieces = [a + (b - a) * share for a, b in pairwise(TURNS)]
    return np.vstack([*pieces, TURNS[-1:]]).T


def crept(torque, gain, substeps, steps=3000):
    """θ' = torque(θ, P1, P2)/b in explicit steps, so slowly that it is quasi-static; θ at the turns after the first."""
    P1, P2 = ramps(steps)
    theta, found = float(JOINT.equilibrium(P1[0], P2[0])), []
    for k, (one, two) in enumerate(zip(P1.tolist(), P2.tolist(), strict=True)):
        for _ in range(substeps):
            theta += torque(theta, one, two) * gain
        if k and k % steps == 0:
            found.append(theta)
    return np.array(found)


def torque_at(theta, P1, P2):
    agonist, antagonist = JOINT.sides(theta)
    return agonist.torque(P1), antagonist.torque(P2)


@pytest.mark.slow
def test_friction_leaves_the_joint_where_a_plant_with_dahls_friction_comes_to_rest():
    joint, delta, state = replace(JOINT, friction=0.1), 0.5 * DEG, {"z": 0.0, "theta": None}

    def torque(theta, P1, P2):
        before = theta if state["theta"] is None else state["theta"]
        state["z"] += (theta - before - abs(theta - before) * state["z"]) / delta  # z' = (ω - |ω| z)/δ, explicit
        state["theta"] = theta
        t1, t2 = torque_at(theta, P1, P2)
        return t1 + t2 - 0.1 * state["z"] * (t1 - t2)

    P1, P2 = ramps(60)
    theta = joint.equilibrium(P1[1:], P2[1:], history=(P1[:1], P2[:1]))
    np.testing.assert_allclose(theta[59::60], crept(torque, 1 / 200, 14), rtol=0, atol=0.1 * DEG)
    static = JOINT.equilibrium(*TURNS[1:].T)
    assert np.abs(theta[59::60] - static).max() > 2 * DEG  # friction is much of it


@pytest.mark.slow
def test_an_operator_leaves_the_joint_where_a_plant_whose_torque_has_its_inverse_comes_to_rest():
    joint, back = replace(JOINT, hysteresis=OPERATOR), OPERATOR.inverse
    state = {"plays": None}

    def torque(theta, P1, P2):
        plays = back.at_rest(theta) if state["plays"] is None else state["plays"]
        u, state["plays"] = back.step(plays, theta, P1 + P2)
        return float(sum(torque_at(float(u), P1, P2)))

    P1, P2 = ramps(60)
    theta = joint.equilibrium(P1[1:], P2[1:], history=(P1[:1], P2[:1]))
    np.testing.assert_allclose(theta[59::60], crept(torque, 1 / 15, 1), rtol=0, atol=0.1 * DEG)
    assert np.abs(theta[59::60] - JOINT.equilibrium(*TURNS[1:].T)).max() > 1 * DEG


@pytest.mark.slow
def test_springs_of_their_own_leave_the_joint_where_a_plant_with_maxwell_slip_comes_to_rest():
    springs, widths, base = np.array([4.0, 1.5]), np.array([1.5, 5.0]) * DEG, 0.4
    joint = replace(JOINT, hysteresis=own_springs(springs, widths, base))
    state = {"theta": None, "e": np.zeros(2)}

    def torque(theta, P1, P2):
        before = theta if state["theta"] is None else state["theta"]
        width = widths * (base + (1 - base) * (P1 + P2) / (5 * BAR))
        state["theta"], state["e"] = theta, np.clip(state["e"] + theta - before, -width, width)
        return float(sum(torque_at(theta, P1, P2)) - springs @ state["e"])

    P1, P2 = ramps(60)
    theta = joint.equilibrium(P1[1:], P2[1:], history=(P1[:1], P2[:1]))
    np.testing.assert_allclose(theta[59::60], crept(torque, 1 / 60, 5), rtol=0, atol=0.1 * DEG)
    assert np.abs(theta[59::60] - JOINT.equilibrium(*TURNS[1:].T)).max() > 1 * DEG


def own_springs(springs, widths, base):
    """The operator with springs [N·m/rad] and half widths [rad] of its own."""
    kappa = springs / 5.0
    return PrandtlIshlinskii((1 + kappa.sum(), *-kappa), tuple(widths), base=base, stiffness=5.0).inverse


OWN = own_springs(np.array([4.0, 1.5]), np.array([1.5, 5.0]) * DEG, 0.4)


@pytest.mark.parametrize("known", [{"friction": 0.1}, {"hysteresis": OPERATOR}, {"hysteresis": OWN}])
def test_a_history_may_be_told_at_once_or_piece_by_piece(known):
    joint, (P1, P2) = replace(JOINT, **known), ramps(10)
    every = joint.equilibrium(P1, P2, history=((), ()))
    assert every.shape == P1.shape
    last = joint.equilibrium(P1[-1], P2[-1], history=(P1[:-1], P2[:-1]))
    assert last.shape == ()
    assert last == pytest.approx(every[-1], abs=1e-9)
    np.testing.assert_allclose(joint.equilibrium(P1[20:], P2[20:], history=(P1[:20], P2[:20])), every[20:], atol=1e-9)


def test_without_friction_the_history_does_not_count():
    P1, P2 = ramps(5)
    np.testing.assert_allclose(
        JOINT.equilibrium(P1, P2, 0.5, history=((), ())), JOINT.equilibrium(P1, P2, 0.5), rtol=0, atol=1e-9
    )


def test_a_load_is_held_from_either_side_with_the_torque_of_friction_between():
    joint = replace(JOINT, friction=0.1)
    up = joint.equilibrium(3 * BAR, 2.4 * BAR, history=(2.2 * BAR, 3.2 * BAR))
    down = joint.equilibrium(3 * BAR, 2.4 * BAR, history=(3.8 * BAR, 1.6 * BAR))
    assert up < down
    for theta, way in ((up, 1), (down, -1)):  # both far beyond presliding: |z| = 1
        held = JOINT.torque(theta, 3 * BAR, 2.4 * BAR) - joint.friction_torque(theta, 3 * BAR, 2.4 * BAR, way)
        assert held == pytest.approx(0.0, abs=1e-6)


def test_what_is_no_history_is_refused_in_a_sentence():
    with pytest.raises(InvalidInput, match=r"history = 1 has to be two pressures"):
        JOINT.equilibrium(BAR, BAR, history=1)
    with pytest.raises(InvalidInput, match=r"numbers or rows"):
        JOINT.equilibrium(np.full((2, 2), BAR), BAR, history=(BAR, BAR))
    with pytest.raises(InvalidInput, match="rests at no angle"):
        JOINT.equilibrium(BAR, BAR, history=(0.1 * BAR, 5 * BAR))
