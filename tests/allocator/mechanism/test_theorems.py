"""What is claimed of separable maps, shown by examples: uniqueness, tightness of the hull, the arm in closed form."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq, minimize_scalar

from allocator import Method, allocate
from allocator.allocation.box.arguments import problem_from
from allocator.allocation.relaxation.curves import relax
from allocator.allocation.relaxation.model import Model
from allocator.mechanism import Mechanism, Pulleys, machines
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N, TONDU_DMSP_20_400N
from benchmarks.mechanisms.nonaffine import ARM

UNIT = st.floats(0.0, 1.0)
R, S, L, START = 0.02, 0.015, 0.4, 0.1375


def gains_of(mechanism, q, P):
    """The derivatives c_j' (…, d, m) of y by each muscle's own pressure, at pressures (…, m)."""
    columns = [
        mechanism.stacked(side.torque_gain(P[..., j]), side.stiffness_gain(P[..., j]))
        for j, side in enumerate(mechanism.at(q))
    ]
    return np.stack(columns, axis=-1)


# --- uniqueness -----------------------------------------------------------------------------------------------------


@given(
    arms=st.lists(st.floats(0.012, 0.03), min_size=7, max_size=7),
    q=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
    ends=st.tuples(*[st.tuples(UNIT, UNIT)] * 5),
)
def test_a_determinant_of_one_sign_makes_pressures_unique(arms, q, ends):
    """n = 2, d = m = 5: the difference of two y is a matrix of mean gains times that of the pressures.

    By the theorem its determinant lies between the least and the greatest one on the box, so that it is not 0 where
    these have one sign. Gains of the box's own corners suffice for its range up to what a muscle bends in between.
    """
    a, b, c, d, e, f, g = arms
    routes = Pulleys(L, [(a, 0.0), (-b, 0.0), (0.0, c), (0.0, -d), (e, f if g > 0.02 else -f)], START)
    mechanism, q = Mechanism(routes, TONDU_DMSP_20_400N), np.array(q)
    lo, hi = mechanism.pressure_box(q)
    P, Q = lo + np.transpose(ends) * (hi - lo)
    assume(np.abs(P - Q).min() > 1e3)
    y = [mechanism.stacked(mechanism.torque(q, x), mechanism.stiffness(q, x)) for x in (P, Q)]
    means = np.stack(
        [
            np.trapezoid(gains_of(mechanism, q, Q + np.linspace(0, 1, 101)[:, None] * (P - Q))[..., j], axis=0) / 100
            for j in range(5)
        ],
        axis=-1,
    )
    size = np.abs(means).max()
    assert means @ (P - Q) == pytest.approx(y[0] - y[1], abs=1e-4 * size * 1e5)
    grid = np.stack(np.meshgrid(*[[0.0, 0.5, 1.0]] * 5, indexing="ij"), axis=-1).reshape(-1, 5)
    every = np.linalg.det(gains_of(mechanism, q, np.minimum(P, Q) + grid * np.abs(P - Q)) / size)
    mean, width = np.linalg.det(means / size), 0.05 * np.ptp(every) + 1e-12
    assert every.min() - width <= mean <= every.max() + width
    if every.min() * every.max() > 0:
        assert np.abs(y[0] - y[1]).max() > 0


@pytest.mark.slow
@given(q=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)), share=st.tuples(*[st.floats(0.02, 0.98)] * 5))
@settings(max_examples=15)
def test_where_it_has_one_sign_the_allocation_finds_the_only_pressures(q, share):
    routes = Pulleys(L, [(R, 0.0), (-R, 0.0), (0.0, R), (0.0, -R), (R, S)], START)
    mechanism, q = Mechanism(routes, TONDU_DMSP_20_400N), np.array(q)
    lo, hi = mechanism.pressure_box(q)
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, 5)] * 5, indexing="ij"), axis=-1).reshape(-1, 5)
    gains = gains_of(mechanism, q, lo + grid * (hi - lo))
    every = np.linalg.det(gains / np.abs(gains).max())
    assert every.min() * every.max() > 0
    P = lo + np.array(share) * (hi - lo)
    a = allocate(q, mechanism.stiffness(q, P), mechanism.torque(q, P), joint=mechanism)
    assert a.P == pytest.approx(P, rel=1e-6)


# --- tightness ------------------------------------------------------------------------------------------------------


def relaxed_to_hulls(q, K, T):
    """The relaxed problem with the curves' hulls themselves, as near as some 30 tangents come; plain least squares."""
    problem, _ = problem_from(ARM, q, K, T, priority="weighted", weights=(1.0, 1.0))
    model = Model(problem)
    polygons = [np.concatenate(list(curve.parts(8))) for curve in model.curves[0]]
    level = model.level(0, 0, np.empty(0))
    return model, level, relax(polygons, level)


@pytest.mark.slow
def test_the_hull_is_tight_where_no_muscle_is_asked_for_more_than_it_reaches():
    """r_jᵀ E r_j > 0 for every muscle inside its interval: the relaxed point is on the curves and the optimum.

    Muscles for which it is not are the only ones that leave their curves. Both kinds are among the targets.
    """
    tight, loose = 0, 0
    for seed in range(16):
        rng = np.random.default_rng(seed)
        q = rng.uniform(-0.5, 0.5, 2)
        P = rng.uniform(*ARM.pressure_box(q))
        K, T = ARM.stiffness(q, P) * rng.uniform(0.4, 1.6), ARM.torque(q, P) * rng.uniform(1.0, 2.0)
        found, pull, inside, above = hull_case(q, K, T)
        assert above.min() > -5e-4  # the hull's lower border is the curve
        weak = inside & (pull <= 1e-3)
        if not weak.any() and found.bound > 1e-3:
            assert np.abs(above[inside]).max(initial=0.0) < 5e-4
            best = allocate(q, K, T, joint=ARM, priority="weighted", weights=(1.0, 1.0), method=Method(gap=1e-6))
            assert best.costs[0] == pytest.approx(found.bound, abs=2e-3 * (1 + found.bound))
            tight += 1
        assert (pull[inside & (above > 1e-3)] <= 1e-3).all()
        loose += bool((above[inside] > 1e-3).any())
    assert tight >= 3
    assert loose >= 2


def hull_case(q, K, T):
    """The relaxed answer, r_jᵀ E r_j, which muscles are inside their intervals, and how far k is above the curves."""
    model, _, found = relaxed_to_hulls(q, K, T)
    F, k, arms = found.v[::2], found.v[1::2], ARM.arms(q)
    E = 2 * (np.tensordot(k, arms[:, :, None] * arms[:, None, :], 1) - K)
    pull = np.einsum("ji,ik,jk->j", arms, E, arms) / 4e-4
    ends = np.array([curve.at(np.array([curve.lo, curve.hi])) for curve in model.curves[0]])  # (m, 2, 2)
    width = ends[:, 1] - ends[:, 0]
    inside = (ends[:, 0, 0] + 1e-3 * width[:, 0] < F) & (ends[:, 1, 0] - 1e-3 * width[:, 0] > F)
    fine = [curve.at(np.linspace(curve.lo, curve.hi, 20_001)) for curve in model.curves[0]]
    above = np.array([k[j] - np.interp(F[j], *fine[j].T) for j in range(ARM.m)]) / width[:, 1]
    return found, pull, inside, above


# --- the arm with four single-joint and two biarticular muscles, in closed form --------------------------------------


def arm_in_closed_form(mechanism, q, K, T, P5):
    """All pressures (6,) from the biarticular flexor's, by K12 and two antagonistic joints; None where there are none.

    At a joint the force of one muscle is the unknown: torque gives the other's, and the stiffness grows with both.
    """
    sides, (lo, hi) = mechanism.at(q), mechanism.pressure_box(q)
    k6 = K[0, 1] / (R * S) - sides[4].own_stiffness(P5)
    P6 = root(lambda x: sides[5].own_stiffness(x) - k6, lo[5] - 0.1, hi[5] + 0.1)  # 0.1 Pa for what lies at an end
    if P6 is None:
        return None
    two = [(4, P5), (5, P6)]
    T = T - sum(sides[j].torque(x) for j, x in two)
    K = K - sum(sides[j].stiffness(x) for j, x in two)
    P = np.array([0.0, 0.0, 0.0, 0.0, P5, P6])
    for joint, (one, other) in enumerate(((0, 1), (2, 3))):

        def pressures(F, joint=joint, pair=(sides[one], sides[other])):
            forces = zip(pair, (F + T[joint] / R, F), strict=True)
            return [float(side.muscle.pressure(force, side.contraction)) for side, force in forces]

        def error(F, joint=joint, pair=(sides[one], sides[other]), pressures=pressures):
            stiff = [side.own_stiffness(p) for side, p in zip(pair, pressures(F), strict=True)]
            return R**2 * sum(stiff) - K[joint, joint]

        least = max(0.0, -T[joint] / R)
        most = min(float(sides[one].force(hi[one])) - T[joint] / R, float(sides[other].force(hi[other])))
        F = root(error, max(least - 1e-6, -T[joint] / R), most + 1e-6) if least < most else None
        if F is None:
            return None
        P[[one, other]] = pressures(F)
    return P


def root(f, lo, hi):
    below, above = f(lo), f(hi)
    return brentq(f, lo, hi, xtol=1e-9, rtol=1e-15) if below * above <= 0 else None


@pytest.mark.slow
@pytest.mark.parametrize("muscle", [SAROSI_DMSP_20_400N, TONDU_DMSP_20_400N], ids=["affine", "not affine"])
@given(q=st.tuples(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4)), share=st.tuples(*[st.floats(0.2, 0.8)] * 6))
@settings(max_examples=10)
def test_the_arm_in_closed_form_has_the_same_least_pressures(muscle, q, share):
    mechanism, q = machines.arm26().with_muscles(muscle), np.array(q)
    lo, hi = mechanism.pressure_box(q)
    P = lo + np.array(share) * (hi - lo)
    K, T = mechanism.stiffness(q, P), mechanism.torque(q, P)
    assert arm_in_closed_form(mechanism, q, K, T, P[4]) == pytest.approx(P, abs=1e-3)
    a = allocate(q, K, T, joint=mechanism)
    assert a.success

    def total(P5):
        found = arm_in_closed_form(mechanism, q, K, T, P5)
        return 1e3 if found is None else float((found**2).sum()) / 25e10

    coarse = np.linspace(lo[4], hi[4], 13)
    # of muscles that are not affine the answer is the least of its neighbourhood only
    start = coarse[np.argmin([total(x) for x in coarse])] if mechanism.affine else float(a.P[4])
    step = coarse[1] - coarse[0]
    beside = np.clip([start - step, start + step], lo[4], hi[4])
    best = minimize_scalar(total, bounds=beside, method="bounded", options={"xatol": 1.0})
    least = min(best.fun, total(float(a.P[4])))
    assert (a.P**2).sum() / 25e10 == pytest.approx(least, rel=1e-6)
    assert arm_in_closed_form(mechanism, q, K, T, float(a.P[4])) == pytest.approx(a.P, abs=1.0)
