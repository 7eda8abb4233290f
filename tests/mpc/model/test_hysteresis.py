"""Maxwell slip: a sum of Preisach's relays, passive, with a memory of turns that time does not touch."""

from dataclasses import replace
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from allocator import BAR, DEG, InvalidInput
from allocator.joint.antagonist import report_joint
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc import Plant
from mpc.model.friction.contact import Loads
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.model.real import RealPlant

PLANT = Plant(report_joint(SAROSI_DMSP_20_400N), lag=0.12)
SLIP = MaxwellSlip.of_width(PLANT, 5 * DEG)
K = np.array(SLIP.springs)
_e, _motion, _filled = ca.SX.sym("e", SLIP.size), ca.SX.sym("m"), ca.SX.sym("c")
_contact = Loads.of(PLANT, (0.0, 0.0, _filled / 2, _filled / 2))
_after = ca.Function("after", [_e, _motion, _filled], [SLIP.moved(_e, _motion, _contact), SLIP.torque(_e, _contact)])

turns = st.lists(st.floats(-6, 6), min_size=1, max_size=12)  # [°]


def along(theta, e=0.0, filled=5 * BAR):
    """The e (n, elements) at the angles `theta` (n,) [rad], from `e` at 0."""
    states, before = [], 0.0
    for angle, c in zip(theta, np.broadcast_to(filled, np.shape(theta)), strict=True):
        e, before = np.array(_after(e, angle - before, c)[0]).ravel(), angle
        states.append(e)
    return np.array(states)


def dense(corners, steps=50):
    """A way through the `corners` from 0 on in `steps` pieces each."""
    ends = np.concatenate([[0.0], corners])
    return np.concatenate([np.linspace(a, b, steps + 1)[1:] for a, b in pairwise(ends)])


@settings(max_examples=30, deadline=None)
@given(turns)
def test_each_element_is_the_angle_less_a_sum_of_preisach_s_relays(corners):
    """A play of half width r is half the sum of all relays that switch up at s + r and down at s - r."""
    s, r = np.arange(-10, 10, 0.01) + 0.005, np.array(SLIP.widths)[:, None] / DEG
    relays = np.where(s < 0, 1.0, -1.0) * np.ones_like(r)
    for corner in corners:
        relays = np.where(corner >= s + r, 1.0, np.where(corner <= s - r, -1.0, relays))
    play = 0.5 * 0.01 * relays.sum(axis=1)
    np.testing.assert_allclose(along(np.array(corners) * DEG)[-1] / DEG, corners[-1] - play, atol=0.011)


@settings(max_examples=30, deadline=None)
@given(turns)
def test_the_way_matters_and_neither_its_speed_nor_its_sampling(corners):
    corners = np.array(corners) * DEG
    np.testing.assert_allclose(along(dense(corners))[49::50], along(corners), atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(turns, st.floats(1, 6), st.lists(st.floats(-1, 1), min_size=1, max_size=8))
def test_a_greater_turn_wipes_out_what_lesser_ones_left(before, size, inner):
    a = np.array([*before, -size, size])
    between = np.array([*before, -size, *(size * np.array(inner)), size])
    np.testing.assert_allclose(along(between * DEG)[-1], along(a * DEG)[-1], atol=1e-12)


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(turns, turns, st.floats(-3, 3), st.floats(0.1, 5))
def test_loops_between_the_same_turns_are_congruent_whatever_came_before(one, other, low, height):
    loop = [low, low + height, low, low + height, low]  # closed from the second time on

    def shape(history):
        e = along(dense(np.array([*history, *loop]) * DEG)) @ K
        return e[-100:] - e[-101]

    np.testing.assert_allclose(shape(one), shape(other), atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.floats(-6, 6), st.floats(0, 10)), min_size=2, max_size=12))
def test_it_gives_back_no_more_work_than_its_springs_hold_even_while_the_pressures_change(way):
    """What it took less what the springs hold never falls; the torque is integrated by the mid-point rule."""
    theta, filled = dense(np.array([a for a, _ in way]) * DEG), dense([c * BAR for _, c in way])
    e = np.vstack([np.zeros(SLIP.size), along(theta, filled=filled)])
    taken = np.cumsum((e[1:] + e[:-1]) / 2 @ K * np.diff(theta, prepend=0.0))
    lost = taken - (e[1:] ** 2) @ K / 2
    assert np.diff(lost, prepend=0.0).min() >= -1e-12


def test_a_great_loop_costs_its_width_times_its_height_less_the_corners():
    """Each element's loop is a parallelogram: 2 k r (2 A - 2 r) for turns at ±A."""
    A, r = 8 * DEG, np.array(SLIP.widths)
    theta = dense([A, -A, A], 4000)
    torque = along(theta) @ K
    cost = np.trapezoid(torque[4000 - 1 :], theta[4000 - 1 :])
    assert cost == pytest.approx((2 * K * r * (2 * A - 2 * r)).sum(), rel=1e-4)


def test_widths_grow_with_co_contraction_and_not_with_the_pull():
    for c, share in ((0.0, SLIP.base), (5 * BAR, 1.0), (10 * BAR, 2 - SLIP.base)):
        np.testing.assert_allclose(along([20 * DEG], filled=c)[-1], share * np.array(SLIP.widths), rtol=1e-12)
        assert SLIP.most(Loads.of(PLANT, (0.0, 0.0, c / 2, c / 2))) == pytest.approx(share * (K * SLIP.widths).sum())


@pytest.mark.slow
def test_the_simulated_joint_moves_as_the_differential_inclusion_says():
    """Against SciPy, with the slipping elements followed by small steps of Euler's method in θ."""
    real = RealPlant(PLANT, friction=SLIP, torque_profile=((0.0, 1.0), (0.3, -0.5), (0.6, 0.3)))
    x0 = np.array([0.1, 0.0, 3 * BAR, 2 * BAR])
    u, dt = np.array([3.4, 1.7]) * BAR, 0.01
    experiment = real.begin(dt, x0, 0)
    found = [experiment.x]
    for _ in range(90):
        experiment.advance(u)
        found.append(experiment.x)

    x, e, h, theta = x0.copy(), np.zeros(SLIP.size), 1e-4, [x0[0]]
    for k in range(9000):
        d = 1.0 if k < 3000 else -0.5 if k < 6000 else 0.3
        width = SLIP.scale(x[2] + x[3]) * np.array(SLIP.widths)
        step = solve_ivp(lambda t, x, d=d, e=e: PLANT.rate(x, u, d - K @ e), (0, h), x, method="RK23").y[:, -1]
        e = np.clip(e + step[0] - x[0], -width, width)
        x = step
        theta.append(x[0])
    np.testing.assert_allclose(np.array(found)[:, 0], theta[::100], atol=0.01 * DEG)


@pytest.mark.parametrize("friction", [SLIP, Friction.of_width(PLANT, 5 * DEG)], ids=["Maxwell slip", "Dahl"])
def test_a_joint_that_is_let_go_loses_energy_only(friction):
    """At steady pressures and without damping: ½ J ω² + ∫ -T dθ + ½ Σ k e² never rises."""
    still = replace(PLANT, damping=0.0, gas=False)
    x0 = np.array([15 * DEG, 0.0, 2.5 * BAR, 2.5 * BAR])
    experiment = RealPlant(still, friction=friction).begin(0.002, x0, 0)
    states = [experiment.memory[: 4 + friction.size]]
    for _ in range(1000):
        experiment.advance(x0[2:])
        states.append(experiment.memory[: 4 + friction.size])
    theta, omega, memory = (v := np.array(states))[:, 0], v[:, 1], v[:, 4:]
    grid = np.linspace(-20, 20, 4001) * DEG
    torque = still.torque((grid, 0 * grid, *x0[2:, None]))
    potential = -np.concatenate([[0.0], np.cumsum((torque[1:] + torque[:-1]) / 2 * np.diff(grid))])
    held = (memory**2) @ K / 2 if friction is SLIP else 0.0
    energy = still.inertia * omega**2 / 2 + np.interp(theta, grid, potential) + held
    energy -= potential.min()
    if friction is SLIP:  # Dahl's model does not tell what it holds, and is passive only over a cycle
        assert np.diff(energy).max() < 1e-4 * energy[0]
    assert energy[-1] < 0.01 * energy[0]


def test_what_is_told_of_it_is_a_share_of_dahl_s_friction_with_a_loop_as_wide():
    told = RealPlant(PLANT, friction=SLIP).known(0.75).friction
    dahl = Friction.of_width(PLANT, 5 * DEG)
    assert told.mu == pytest.approx(0.75 * dahl.mu, rel=1e-12)
    assert RealPlant(PLANT, friction=dahl).known(0.75).friction == told


@pytest.mark.parametrize(
    ("argument", "named"),
    [
        ({"springs": (1.0, -1.0)}, "springs"),
        ({"widths": (0.1, np.nan)}, "widths"),
        ({"springs": (), "widths": ()}, "springs"),
        ({"springs": (np.inf, 1.0)}, "springs"),
        ({"widths": (np.inf, 1.0)}, "widths"),
        ({"springs": (-0.5, 1.0), "elastic": True}, "springs"),
        ({"springs": (1.0,)}, "1 springs and 2 widths"),
        ({"base": 0.0}, "base"),
        ({"base": np.nan}, "base"),
    ],
)
def test_impossible_elements_are_refused_by_their_names(argument, named):
    with pytest.raises(InvalidInput, match=named):
        MaxwellSlip(**({"springs": (1.0, 2.0), "widths": (0.1, 0.2)} | argument))
