"""Felt stiffness against loops that are simulated step by step, and by its laws."""

from dataclasses import replace
from math import inf, pi

import numpy as np
import pytest

from allocator import BAR, DEG, InvalidInput, PrandtlIshlinskii, Stiffness, allocate, stiffness_interval
from allocator.feasibility import feasibility_map, torque_intervals
from allocator.joint.antagonist import report_joint
from allocator.joint.felt import Loop
from allocator.joint.hysteresis import Slip
from allocator.muscles import Cabled
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N, TONDU_DMSP_20_400N
from mpc.model.friction.contact import Loads, first_push
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.model.plant import Plant

OPERATOR = PrandtlIshlinskii((0.6, 0.15, 0.15, 0.1), (1 * DEG, 2.5 * DEG, 5 * DEG), base=0.2)
JOINT = replace(report_joint(SAROSI_DMSP_20_400N), hysteresis=OPERATOR)
PLANT = Plant(JOINT)
X = np.array([0.1, 0.0, 2.8 * BAR, 2.2 * BAR])
MODELS = {
    "Maxwell slip": MaxwellSlip((10.0, 4.0, 3.0), (0.5 * DEG, 2 * DEG, 6 * DEG), 0.3),
    "elastic operator": MaxwellSlip.of(OPERATOR),
    "elastic operator with a gain": MaxwellSlip.of(PrandtlIshlinskii((0.5, 0.2, 0.1), (1 * DEG, 4 * DEG), base=0.5)),
    "Dahl": Friction(0.1, 0.05, 0.7 * DEG),
}
AMPLITUDES = 0.3 * DEG, 1 * DEG, 3 * DEG, 12 * DEG


def steady_loop(friction, amplitude):
    """Angles and torques T_f of a cycle between ±amplitude, stepped finely, after many cycles."""
    contact, n = Loads.of(PLANT, X), 4000
    memory = friction.moved(friction.begun(0.0), -amplitude, contact)
    for _ in range(40):
        for motion in (2 * amplitude, -2 * amplitude):
            memory = friction.moved(memory, motion, contact)
    turn = amplitude * np.concatenate([np.linspace(-1, 1, n), np.linspace(1, -1, n)[1:]])
    return turn, np.array([friction.torque(m, contact) for m in friction.along(memory, turn, contact)])


@pytest.mark.parametrize("amplitude", AMPLITUDES)
@pytest.mark.parametrize("name", MODELS)
def test_secant_and_work_are_those_of_the_simulated_loop(name, amplitude):
    friction, contact = MODELS[name], Loads.of(PLANT, X)
    secant = friction.loop.secant(amplitude)
    state = contact.stiffness, contact.pulled, contact.filled
    angle, T = steady_loop(friction, amplitude)
    top = angle.size // 2
    assert (T[top] - T[0]) / (2 * amplitude) == pytest.approx(secant.added(*state), rel=1e-9)
    assert abs(np.trapezoid(T, angle) - secant.work(*state)) <= 1e-5 * 4 * amplitude * abs(T).max()


@pytest.mark.parametrize("name", MODELS)
def test_a_loop_that_loses_softens_the_joint(name):
    """-dK_h/d ln A ≥ π/4 h, h = W/(π A²), of Dahl's friction from 0.6 δ on: refusals of rubber rest on it."""
    contact, e = Loads.of(PLANT, X), 1e-5
    least = 0.6 * MODELS[name].presliding if name == "Dahl" else 0.1 * DEG
    state = contact.stiffness, contact.pulled, contact.filled
    for A in np.geomspace(least, 60 * DEG, 40):
        more, less = (MODELS[name].loop.secant(A * (1 + s)).added(*state) for s in (e, -e))
        h = MODELS[name].loop.secant(A).work(*state) / (pi * A**2)
        assert (less - more) / (2 * e) >= pi / 4 * h - 1e-6 * less


def test_a_joint_has_the_loop_of_its_operator_or_friction():
    at = 0.1, 2.8 * BAR, 2.2 * BAR
    contact = Loads.of(PLANT, X)
    for joint, friction in (
        (JOINT, MODELS["elastic operator"]),
        (replace(JOINT, hysteresis=None, friction=0.1), Friction(0.1)),
    ):
        secant = friction.loop.secant(2 * DEG)
        K_h = secant.added(contact.stiffness, contact.pulled, contact.filled)
        assert joint.stiffness(*at, amplitude=2 * DEG) == pytest.approx(joint.stiffness(*at) + K_h, rel=1e-12)
        K, W = joint.stiffness(*at, amplitude=2 * DEG), joint.loop_work(*at, 2 * DEG)
        assert joint.loss_factor(*at, 2 * DEG) == pytest.approx(W / (pi * K * (2 * DEG) ** 2), rel=1e-12)
        dynamic = joint.dynamic_stiffness(*at, 0.5, 0.1, amplitude=2 * DEG, damping=0.2)
        assert dynamic - joint.dynamic_stiffness(*at, 0.5, 0.1) == pytest.approx(
            K_h + 1j * (W / (pi * (2 * DEG) ** 2) + 2 * pi * 0.5 * 0.2), rel=1e-12
        )
    bare = replace(JOINT, hysteresis=None)
    assert bare.loop.absent
    assert bare.stiffness(*at, amplitude=2 * DEG) == bare.stiffness(*at)


def test_felt_stiffness_falls_with_the_amplitude_to_the_backbone_of_wide_motions():
    K = [JOINT.stiffness(0.1, 3 * BAR, 2 * BAR, amplitude=A) for A in (*np.geomspace(0.1, 45, 30) * DEG, 90 * DEG)]
    assert (np.diff(K) <= 1e-12).all()
    assert K[0] == pytest.approx(JOINT.stiffness(0.1, 3 * BAR, 2 * BAR) / 0.6, rel=1e-12)  # stuck: 1/w_0
    backbone = JOINT.stiffness(0.1, 3 * BAR, 2 * BAR)
    assert K[-1] - backbone == pytest.approx((K[-2] - backbone) / 2, rel=1e-9)  # all slip: as 1/A
    assert K[-1] == pytest.approx(backbone, rel=0.1)


def test_the_secant_is_affine_between_its_kinks():
    loops = (
        JOINT.loop,
        MODELS["Maxwell slip"].loop,
        Loop(Slip((0.2, 0.1), (0.02, inf), 0.4)),
        Loop(mu=0.1, coulomb=0.2),
    )
    for loop in loops:
        secant = loop.secant(2 * DEG)
        for S in np.linspace(0.0, 10.0, 23) * BAR:
            r = next(r for r in secant.regions if r.low <= S <= r.high)
            found = 7.0 * (r.share + r.share_slope * S) + r.own + r.own_slope * S + secant.drag * 3.0
            assert found == pytest.approx(secant.added(7.0, 3.0, S), rel=1e-12)


def test_a_felt_target_is_met_and_said():
    a = allocate(0.1, 8.0, 1.0, joint=JOINT, stiffness=Stiffness(amplitude=2 * DEG))
    assert a.success
    assert JOINT.stiffness(0.1, a.P1, a.P2, amplitude=2 * DEG) == pytest.approx(8.0, rel=1e-12)
    assert JOINT.torque(0.1, a.P1, a.P2) == pytest.approx(1.0, rel=1e-12)
    assert a.K == pytest.approx(a.felt_stiffness(2 * DEG), rel=1e-12)
    assert a.isobaric_stiffness == pytest.approx(JOINT.stiffness(0.1, a.P1, a.P2), rel=1e-12)
    assert "isobaric stiffness felt by ±2°" in repr(a)
    assert a.gap == 0
    assert a.kkt_residual <= 1e-12
    assert a.pairs == 1
    K_min, K_max = stiffness_interval(0.1, 1.0, joint=JOINT, stiffness=Stiffness(amplitude=2 * DEG))
    assert a.stiffness_interval == pytest.approx((K_min, K_max), rel=1e-9)
    low, high = torque_intervals(0.1, 8.0, joint=JOINT, stiffness=Stiffness(amplitude=2 * DEG))
    assert low[0] < 1.0 < high[0]
    for T in (low[0], high[0]):
        assert allocate(0.1, 8.0, T, joint=JOINT, stiffness=Stiffness(amplitude=2 * DEG)).K == pytest.approx(8.0, 1e-8)


@pytest.mark.parametrize("valves", ["open", "shut", "free"])
def test_the_jacobian_of_a_felt_answer_is_its_slope(valves):
    filled = replace(JOINT.agonist, rest_volume=1.2e-4)
    joint = replace(JOINT, agonist=filled, antagonist=filled)
    meant, h = Stiffness(valves, amplitude=2 * DEG), 1e-6

    def at(theta, K, T):
        return allocate(theta, K, T, joint=joint, stiffness=meant)

    a = at(0.2, 10.0, 0.5)
    assert a.success
    steps = np.eye(3) * h
    slopes = [(at(0.2 + d, 10.0 + e, 0.5 + f).P - at(0.2 - d, 10.0 - e, 0.5 - f).P) / (2 * h) for d, e, f in steps]
    assert a.jacobian() == pytest.approx(np.stack(slopes, axis=1), rel=1e-5)


def test_a_map_of_felt_stiffness_agrees_with_allocate():
    theta, K, meant = np.linspace(-1, 1, 4), np.linspace(2, 20, 7), Stiffness(amplitude=1 * DEG)
    found = feasibility_map(theta, K, 0.5, joint=JOINT, stiffness=meant)
    a = allocate(theta[:, None], K, 0.5, joint=JOINT, stiffness=meant)
    assert (found.status[..., 0] == a.status).all() if found.status.ndim == 3 else (found.status == a.status).all()
    assert found.edges


HYSTERESES = {
    "friction": {"friction": 0.13},
    "loop of constant width": {"hysteresis": replace(OPERATOR, base=1.0)},
    "springs of its own": {"hysteresis": PrandtlIshlinskii((0.7, 0.2, 0.1), (1 * DEG, 4 * DEG), stiffness=5.0)},
}


@pytest.mark.parametrize("hysteresis", HYSTERESES)
@pytest.mark.parametrize(
    "muscle", [TONDU_DMSP_20_400N, Cabled(SAROSI_DMSP_20_400N, 4e4, 0.4)], ids=["curved", "cabled"]
)
def test_laws_that_are_not_affine_are_searched_where_hysteresis_does_not_couple_the_pressures(muscle, hysteresis):
    joint = replace(report_joint(muscle), **HYSTERESES[hysteresis])
    rng, meant = np.random.default_rng(34), Stiffness(amplitude=2 * DEG)
    theta, K, T = rng.uniform(-0.5, 0.5, 3), rng.uniform(3, 12, 3), rng.uniform(-2, 2, 3)
    P1, P2 = np.meshgrid(*2 * [np.linspace(0, 5 * BAR, 121)])
    for priority in ("torque", "stiffness"):
        a = allocate(theta, K, T, joint=joint, stiffness=meant, priority=priority)
        assert a.gap.max() < 1e-9
        assert a.K == pytest.approx(joint.stiffness(theta, a.P1, a.P2, amplitude=2 * DEG), rel=1e-12)
        for i in range(3):
            taut = np.all([F >= 0 for F in joint.forces(theta[i], P1, P2)], axis=0)
            off = np.abs(joint.torque(theta[i], P1, P2) - T[i])
            wrong = np.abs(joint.stiffness(theta[i], P1, P2, amplitude=2 * DEG) - K[i])
            mine = [abs(a.T_error[i]), abs(a.K_error[i])]
            first, second, mine = (off, wrong, mine) if priority == "torque" else (wrong, off, mine[::-1])
            assert mine[0] <= first[taut].min() + 1e-9
            as_good = taut & (first <= mine[0] + 1e-12)
            assert mine[1] <= second[as_good].min(initial=np.inf) + 1e-9
    low, high = stiffness_interval(0.1, 1.0, joint=joint, stiffness=meant)
    a = allocate(0.1, (low + high) / 2, 1.0, joint=joint, stiffness=meant)
    assert a.success
    assert a.kkt_residual < 1e-9


def test_intervals_of_curved_laws_contain_the_stiffness_of_constant_springs():
    joint, meant = replace(report_joint(), **HYSTERESES["springs of its own"]), Stiffness(amplitude=2 * DEG)
    more = joint.stiffness(0.1, 2 * BAR, 2 * BAR, amplitude=2 * DEG) - joint.stiffness(0.1, 2 * BAR, 2 * BAR)
    assert more > 0.5
    bare = replace(joint, hysteresis=None)
    assert stiffness_interval(0.1, 1.0, joint=joint, stiffness=meant) == pytest.approx(
        np.array(stiffness_interval(0.1, 1.0, joint=bare)) + more, rel=1e-9
    )
    for felt, alone in zip(
        torque_intervals(0.1, 6.0, joint=joint, stiffness=meant), torque_intervals(0.1, 6.0 - more, joint=bare),
        strict=True,
    ):  # fmt: skip
        assert felt == pytest.approx(alone, rel=1e-9)
    theta, K = np.linspace(-0.5, 0.5, 4), np.linspace(3.0, 10.0, 6)
    one = feasibility_map(theta, K, 0.5, joint=joint, stiffness=meant)
    two = feasibility_map(theta, K - more, 0.5, joint=bare)
    assert (one.status == two.status).all()
    a = allocate(0.1, 6.0, 1.0, joint=joint, stiffness=meant)
    b = allocate(0.1, 6.0 - more, 1.0, joint=bare)
    assert a.P == pytest.approx(b.P, rel=1e-9)
    assert a.pairs == b.pairs
    assert a.jacobian() == pytest.approx(b.jacobian(), rel=1e-6)


def test_free_valves_and_a_push_go_together_with_curved_laws():
    muscle = replace(TONDU_DMSP_20_400N, rest_volume=1.2e-4)
    joint = replace(report_joint(muscle), friction=0.13)
    a = allocate(0.1, 14.0, 1.0, joint=joint, stiffness=Stiffness("free", amplitude=2 * DEG))
    assert a.success
    assert joint.stiffness(0.1, a.P1, a.P2, a.valves, amplitude=2 * DEG) == pytest.approx(14.0, rel=1e-9)


def test_what_has_no_felt_answer_is_refused():
    meant = Stiffness(amplitude=2 * DEG)
    with pytest.raises(InvalidInput, match="not affine"):
        allocate(0.1, 8.0, joint=replace(report_joint(), hysteresis=OPERATOR), stiffness=meant)
    with pytest.raises(InvalidInput, match="method='exact'"):
        allocate(0.1, 8.0, joint=JOINT, stiffness=meant, method="qp")
    with pytest.raises(InvalidInput, match="for degrees"):
        allocate(0.1, 8.0, joint=JOINT, stiffness=Stiffness(amplitude=5.0))
    with pytest.raises(InvalidInput, match="amplitude of a push"):
        allocate(0.1, 8.0, joint=JOINT, stiffness=Stiffness(loop=Loop()))


def test_the_first_push_on_meets_the_backbone_and_one_back_meets_more():
    friction, contact = MODELS["Maxwell slip"], Loads.of(PLANT, X)
    memory = friction.moved(friction.begun(0.0), 40 * DEG, contact)
    K, A, s = contact.stiffness, 1 * DEG, friction.scale(contact.filled)
    assert first_push(friction, memory, A, contact) == pytest.approx(K, rel=1e-12)
    more = sum(k * min(1.0, 2 * r * s / A) for k, r in zip(friction.springs, friction.widths, strict=True))
    assert first_push(friction, memory, -A, contact) == pytest.approx(K + more, rel=1e-12)
    with pytest.raises(InvalidInput, match="no push"):
        first_push(friction, memory, 0.0, contact)
