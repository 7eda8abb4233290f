"""Trapped gas, held against the polytropic law itself, and the numbers of the theory's own page."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import casadi
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq
from scipy.special import jv

from allocator import (
    BAR,
    DEG,
    AntagonistJoint,
    Gas,
    InvalidInput,
    Lever,
    Pulley,
    Status,
    Stiffness,
    allocate,
    report_joint,
    save_machine,
)
from allocator.identification import fit, load_dataset
from allocator.joint.gas import StiffnessKind, storage_share, thermal_corner
from allocator.machine_file import load_joint
from allocator.muscles import MODELS
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc.model.plant import Plant

KAPPA, ATMOSPHERE = 1.3, 101_325.0
STATES = [(False, False), (True, False), (False, True), (True, True)]
GEOMETRIES = {
    "pulley": (Pulley(0.40, 0.02, 0.1375), (-1.0, 0.0, 0.7)),
    "lever": (Lever(0.25, 0.1655, 0.05094, 0.051), (-0.3, 0.0, 0.25)),
}


@pytest.fixture(scope="module")
def joint():
    """The joint of the page: Sarosi's muscles on the report's pulley, V_0 = 145.7 cm³."""
    return report_joint(replace(SAROSI_DMSP_20_400N, rest_volume=125.7e-6, tube_volume=20e-6))


@cache
def fitted(model):
    measured = load_dataset("dmsp-20-300-map")
    muscle = fit(MODELS[model], measured.contraction, measured.pressure, measured.force, folds=0).muscle
    return replace(muscle, rest_volume=125.7e-6, tube_volume=20e-6)


def trapped_pressure(joint, muscle, routing, P0, eps0, eps):
    """The pressure to which (P + p_a) V^κ = const leads from (P0, ε0) to ε, by bracketed root finding."""
    L, gas = joint.geometry.rest_length, joint.gas
    constant = np.log(P0 + gas.atmosphere) + gas.kappa * np.log(muscle.volume(P0, eps0, L))

    def lacking(P):
        return np.log(P + gas.atmosphere) + gas.kappa * np.log(muscle.volume(P, eps, L)) - constant

    return brentq(lacking, P0 - 0.2 * BAR, P0 + 0.2 * BAR, xtol=1e-9, rtol=1e-15)


def torque_with_shut_valves(joint, theta0, P, shut, theta):
    """T(θ) while the pressures of the shut muscles follow the polytropic law, the others stay."""
    torque = 0.0
    for i, (muscle, sign) in enumerate(((joint.agonist, 1), (joint.antagonist, -1))):
        route = (joint.geometry.agonist, joint.geometry.antagonist)[i]
        eps, arm, _ = route(theta)
        p = trapped_pressure(joint, muscle, route, P[i], route(theta0)[0], eps) if shut[i] else P[i]
        torque += sign * arm * muscle.law(p, eps)
    return torque


@pytest.mark.parametrize("geometry", GEOMETRIES)
@pytest.mark.parametrize("model", MODELS)
def test_the_stiffness_is_that_of_the_polytropic_law(model, geometry):
    mechanism, angles = GEOMETRIES[geometry]
    joint = AntagonistJoint(mechanism, fitted(model), fitted(model))
    h = 1e-4
    for theta in angles:
        for P in ((1.6e5, 2.2e5), (4.1e5, 3.3e5)):
            for shut in STATES:
                T = [torque_with_shut_valves(joint, theta, P, shut, theta + n * h) for n in (-2, -1, 1, 2)]
                difference = -(8 * (T[2] - T[1]) - (T[3] - T[0])) / (12 * h)
                assert joint.stiffness(theta, *P, valves=shut) == pytest.approx(difference, rel=1e-7)


# --- the numbers of the theory's page -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("valves", "expected", "digit"),
    [
        ("open", (2.052, 3.903, 5.754, 7.605, 9.456), 5e-4),
        ((True, False), (3.21, 5.63, 8.06, 10.48, 12.91), 5e-3),
        ((False, True), (3.21, 5.63, 8.06, 10.48, 12.91), 5e-3),
        ("shut", (4.365, 7.364, 10.363, 13.363, 16.362), 6e-4),
    ],
)
def test_the_table_of_open_and_shut_stiffness(joint, valves, expected, digit):
    P = np.arange(1, 6) * BAR
    np.testing.assert_allclose(joint.stiffness(0.0, P, P, valves=valves), expected, rtol=0, atol=digit)


def test_the_volume_at_the_middle(joint):
    np.testing.assert_allclose(joint.volumes(0.0, 3e5, 3e5), 276.3e-6, rtol=2e-4)


@pytest.mark.parametrize(("valves", "bar"), [("open", 4.97), ("shut", 2.68)])
def test_the_pressure_that_a_stiffness_needs(joint, valves, bar):
    found = brentq(lambda P: joint.stiffness(0.0, P, P, valves=valves) - 9.4, 1 * BAR, 5 * BAR)
    assert found / BAR == pytest.approx(bar, abs=5e-3)


def test_the_stiffness_over_frequency(joint):
    f = np.array([0.1, 0.5, 1, 2, 5, 20])
    K = joint.dynamic_stiffness(0.0, 3e5, 3e5, f, 0.1)
    felt = np.abs(K) / joint.stiffness(0.0, 3e5, 3e5)
    np.testing.assert_allclose(felt, [1.004, 1.096, 1.278, 1.540, 1.742, 1.796], rtol=0, atol=1.5e-3)
    np.testing.assert_allclose(felt[[0, 1, 4]], [1.004, 1.096, 1.742], rtol=0, atol=1e-3)


def test_the_damping_of_the_gas(joint):
    slow = 1e-4
    D = joint.dynamic_stiffness(0.0, 3e5, 3e5, slow, 0.1).imag / (2 * np.pi * slow)
    assert pytest.approx(0.46, abs=5e-3) == D


def test_how_far_a_hand_moves_the_joint_inside_a_dead_band(joint):
    h = 1e-5
    muscle, route = joint.agonist, joint.geometry.agonist
    P = [trapped_pressure(joint, muscle, route, 3e5, route(0.0)[0], route(x)[0]) for x in (-h, h)]
    slope = (P[0] - P[1]) / (2 * h)
    assert slope / BAR == pytest.approx(0.66, abs=5e-3)  # [bar/rad]
    assert 0.15 * BAR / slope / DEG == pytest.approx(13, abs=0.5)
    assert joint.stiffness(0.0, 3e5, 3e5, valves="shut") == pytest.approx(10.4, abs=0.05)
    assert joint.stiffness(0.0, 3e5, 3e5) == pytest.approx(5.75, abs=5e-3)


# --- frequency ------------------------------------------------------------------------------------------------------


def test_slow_motions_meet_the_isobaric_and_quick_ones_the_shut_stiffness(joint):
    at = 0.3, 2.5e5, 3.5e5
    assert joint.dynamic_stiffness(*at, 0.0, 0.1) == pytest.approx(joint.stiffness(*at))
    assert joint.dynamic_stiffness(*at, 1e6, 0.1) == pytest.approx(joint.stiffness(*at, valves="shut"), rel=1e-5)


def test_the_real_part_has_the_shares_and_the_gas_only_takes_energy(joint):
    f, lag = np.geomspace(1e-3, 1e3, 61), (0.05, 0.3)
    K = joint.dynamic_stiffness(0.3, 2.5e5, 3.5e5, f, lag)
    sides = joint.sides(0.3)
    shut = [replace(side, share=1.0, gas=joint.gas).trapped(P) for side, P in zip(sides, (2.5e5, 3.5e5), strict=True)]
    expected = joint.stiffness(0.3, 2.5e5, 3.5e5) + sum(
        storage_share(f, tau) * k for tau, k in zip(lag, shut, strict=True)
    )
    np.testing.assert_allclose(K.real, expected, rtol=1e-12)
    assert (K.imag > 0).all()


def test_the_dynamic_stiffness_is_that_of_the_linearised_regulator(joint):
    """(G3) in steady oscillation, integrated by SciPy: small motions, the Fourier component of the torque."""
    tau, f, P0, amplitude = 0.1, 1.0, 3e5, 1e-4
    w, gas, L = 2 * np.pi * f, joint.gas, joint.geometry.rest_length
    route, muscle = joint.geometry.agonist, joint.agonist

    def rate(t, P):
        eps, arm, _ = route(amplitude * np.sin(w * t))
        turn = amplitude * w * np.cos(w * t)
        V_eps = L * muscle.gain(P[0], eps)
        flow = gas.kappa * (P[0] + gas.atmosphere) * V_eps * arm / L * turn / muscle.volume(P[0], eps, L)
        return [(P0 - P[0]) / tau - flow]

    times = np.linspace(3.0, 4.0, 401)  # after 30 lags, one period
    P = solve_ivp(rate, (0.0, 4.0), [P0], t_eval=times, rtol=1e-10, atol=1e-6).y[0]
    eps, arm, _ = route(amplitude * np.sin(w * times))
    torque = (arm * muscle.law(P, eps))[:-1]
    stored, lost = (2 * np.mean(torque * wave(w * times[:-1])) / amplitude for wave in (np.sin, np.cos))
    one = joint.sides(0.0, (1.0, 0.0))[0]
    s = 2j * np.pi * f * tau
    expected = one.isobaric.stiffness(P0) + one.trapped(P0) * s / (1 + s)
    assert -stored == pytest.approx(expected.real, rel=1e-4)
    assert -lost == pytest.approx(expected.imag, rel=1e-4)


# --- energy ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", MODELS)
def test_a_closed_cycle_with_shut_valves_creates_no_work(model):
    """The pressures follow dP/dθ = ∓κ (P + p_a) g/V^eff step by step, as in a plant; what is put in is given back."""
    joint = AntagonistJoint(Pulley(0.40, 0.02, 0.1375), fitted(model), fitted(model))
    start = (3.1e5, 3.4e5)

    def rate(theta, y):
        sides = joint.sides(theta, (1.0, 1.0))
        slopes = [
            -KAPPA * (P + ATMOSPHERE) * side.torque_gain(P) / side.effective_volume(P)
            for side, P in zip(sides, y, strict=False)
        ]
        return [*slopes, sum(side.torque(P) for side, P in zip(sides, y, strict=False))]

    state, exchanged, corners = [*start, 0.0], 0.0, (0.0, 0.4, 0.1, -0.35, 0.0)
    for a, b in pairwise(corners):
        before = state[2]
        state = solve_ivp(rate, (a, b), state, method="DOP853", rtol=1e-13, atol=1e-12).y[:, -1].tolist()
        exchanged += abs(state[2] - before)
    assert abs(state[2]) <= 1e-9 * exchanged
    np.testing.assert_allclose(state[:2], start, rtol=1e-10)


@pytest.mark.parametrize("model", MODELS)
def test_the_energy_of_the_muscle_knows_no_path(model):
    """dE = P dV + F dl is exact with the volume of (G1): round a rectangle in (P, ε) nothing is left of it."""
    muscle, L = fitted(model), 0.4
    P, Q, a, b = 2.8e5, 3.6e5, 0.06, 0.15  # on one side of Wickramatunge's kink

    def gas(P):
        return quad(lambda e: P * L * muscle.gain(P, e), a, b, epsrel=1e-12)[0]  # ∫ P dV

    def pull(P):
        return quad(lambda e: -L * muscle.law(P, e), a, b, epsrel=1e-12)[0]  # ∫ F dl, dl = -L dε

    def filled(eps):
        return quad(lambda p: p * L * muscle.gain_integral_slope(p, eps), P, Q, epsabs=1e-12)[0]  # ∫ P dV at rest

    left = gas(P) + pull(P) + filled(b) - gas(Q) - pull(Q) - filled(a)
    assert abs(left) <= 1e-9 * (gas(P) + gas(Q) + abs(pull(P)) + abs(pull(Q)))


# --- symbols and derivatives ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["Sarosi2012", "Tondu2021", "TonduLopez2000", "Wickramatunge2010", "TableMuscle"])
def test_symbols_have_the_same_stiffness_and_the_gain_is_its_derivative(model):
    joint = AntagonistJoint(GEOMETRIES["lever"][0], fitted(model), fitted(model))
    theta, P1, P2 = casadi.SX.sym("theta"), casadi.SX.sym("P1"), casadi.SX.sym("P2")
    K = joint.stiffness(theta, P1, P2, valves="shut")
    function = casadi.Function("K", [theta, P1, P2], [K, casadi.jacobian(K, casadi.vertcat(P1, P2))])
    at = 0.2, 3.4e5, 2.7e5
    value, slopes = (np.asarray(x).ravel() for x in function(*at))
    assert value[0] == pytest.approx(joint.stiffness(*at, valves="shut"), rel=1e-12)
    gains = [side.stiffness_gain(P) for side, P in zip(joint.sides(at[0], (1.0, 1.0)), at[1:], strict=True)]
    np.testing.assert_allclose(slopes, gains, rtol=1e-9)


# --- wrong input ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (lambda: Gas(0.9), "Gas: kappa = 0.9 has to lie between 1 (isothermal) and 1.67; for air 1.4 is adiabatic"),
        (lambda: Gas(1.7), "Gas: kappa = 1.7 has to lie between 1"),
        (lambda: Gas(float("nan")), "Gas: kappa = nan is not finite"),
        (lambda: Gas(1.3, 1.0), "Gas: atmosphere = 1 Pa is next to nothing; if bar was meant, multiply by 1e5"),
        (lambda: Gas(1.3, -1e5), "Gas: atmosphere = -100000 Pa has to be the absolute pressure"),
        (lambda: StiffnessKind.of("closed"), "valves = 'closed' is unknown; choose 'open', 'shut', 'free' or"),
        (lambda: StiffnessKind.of((1, 0)), "valves = (1, 0) is unknown"),
        (lambda: StiffnessKind.of((True,)), "valves = (True,) is unknown"),
        (lambda: StiffnessKind.of("open", -2.0, 0.1), "frequency = -2 Hz is negative"),
        (lambda: StiffnessKind.of("open", 2.0), "frequency [Hz] and lag [s] go together"),
        (lambda: StiffnessKind.of("open", None, 0.1), "frequency [Hz] and lag [s] go together"),
        (lambda: StiffnessKind.of("shut", 2.0, 0.1), "valves and frequency exclude each other"),
        (lambda: StiffnessKind.of("open", 2.0, -0.1), "lag = -0.1 s is negative"),
        (lambda: StiffnessKind.of("open", 2.0, 150.0), "if milliseconds were meant, divide by 1000"),
        (lambda: StiffnessKind.of("open", 2.0, (0.1, 0.1, 0.1)), "has to be one time constant or a pair of them [s]"),
        (lambda: StiffnessKind.of("open", [1.0, 2.0], 0.1), "frequency = [1.0, 2.0] has to be one number [Hz]"),
        (lambda: StiffnessKind.of("open", 1e300, 0.1), "frequency = 1e+300 Hz is none at which a joint moves"),
        (lambda: replace(report_joint(), gas=1.4), "gas = 1.4 has to be a Gas"),
        (lambda: report_joint().stiffness(0.0, -2e5, 3e5, "shut"), "pressure -200000 Pa of the agonist is below a vac"),
    ],
)
def test_what_cannot_be_is_one_sentence(made, said):
    with pytest.raises(InvalidInput) as refusal:
        made()
    assert said in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_free_valves_are_no_state_of_a_joint(joint):
    with pytest.raises(InvalidInput, match="valves='free' is for `allocate`"):
        joint.stiffness(0.0, 3e5, 3e5, valves="free")


def test_a_law_whose_volume_would_collapse_says_so():
    """The report's law with a constant V_0: at 125° and 5 bar V^eff is negative, and no gas can be so."""
    with pytest.raises(InvalidInput, match="the volume of the agonist would fall with the pressure"):
        report_joint().stiffness(125 * DEG, 5e5, 2e5, valves="shut")
    small = report_joint(replace(report_joint().agonist, rest_volume=2e-5))  # nothing is left at 125°
    assert (
        allocate(np.array([0.0, 125 * DEG]), 15.0, joint=small, stiffness=Stiffness("shut")).status[1] == Status.SLACK
    )
    box = report_joint().box(np.array([0.0, 125 * DEG]), shares=(1.0, 1.0))
    assert box.agonist.hi[0] == 5e5
    side = report_joint().sides(np.array([125 * DEG]), (1.0, 1.0))[0]
    assert side.effective_volume(box.agonist.hi[1:]) == pytest.approx(side.volume(box.agonist.hi[1:]) / 2, rel=1e-9)


def test_a_volume_in_litres_is_pointed_out():
    small = replace(SAROSI_DMSP_20_400N, rest_volume=0.12e-6)  # 0.12 litres, given as cubic centimetres
    for asked in (
        lambda: report_joint(small).stiffness(0.0, 3e5, 3e5, valves="shut"),
        lambda: allocate(0.0, 8.0, joint=report_joint(small), stiffness=Stiffness("shut")),
    ):
        with pytest.raises(InvalidInput, match=r"with 1.2e-07 m³ at rest length .* in litres, pass 0.00012"):
            asked()


# --- heat -------------------------------------------------------------------------------------------------------------


def test_a_corner_leads_from_isothermal_to_adiabatic():
    gas = Gas(1.4, corner=0.05)
    assert gas.exponent(0.0) == 1.0
    assert gas.exponent(0.05) == pytest.approx(1.2 + 0.2j, rel=1e-12)  # where most is lost
    assert gas.exponent(1e6) == pytest.approx(1.4, rel=1e-6)
    assert Gas(1.4).exponent(0.01) == 1.4


def test_the_exponent_is_that_of_a_simulated_heat_balance():
    t, f, pa, V0 = 1 / (2 * np.pi * 0.05), 0.03, 4e5, 1e-4  # m c_v = p V/(T (γ - 1))
    w, swing = 2 * np.pi * f, 1e-4

    def rate(time, T):
        V, dV = V0 * (1 + swing * np.sin(w * time)), V0 * swing * w * np.cos(w * time)
        return -0.4 * T * dV / V - (T - 300.0) / t

    times = np.linspace(20 / f, 22 / f, 4001)
    T = solve_ivp(rate, (0, times[-1]), [300.0], t_eval=times, rtol=1e-11, atol=1e-11).y[0]
    V = V0 * (1 + swing * np.sin(w * times))
    p = pa * T / 300 * V0 / V - pa
    phasor = [2j * np.trapezoid(x * np.exp(-1j * w * times), times) / (2 / f) for x in (p / pa, V / V0 - 1)]
    assert -phasor[0] / phasor[1] == pytest.approx(Gas(1.4, corner=0.05).exponent(f), abs=2e-4)


def test_the_corner_of_a_tube_is_near_to_that_of_all_modes_of_diffusion():
    radius, P = 0.013, 3 * BAR
    corner = thermal_corner(radius, P)
    assert 0.02 < thermal_corner(radius, 5 * BAR) < corner < thermal_corner(radius, 2 * BAR) < 0.06
    f = np.logspace(-4, 1, 60)
    z = radius * np.sqrt(-2j * np.pi * f * (P + ATMOSPHERE) / (2.1e-5 * BAR))
    exact = 1.4 / (1 + 0.4 * 2 * jv(1, z) / (z * jv(0, z)))
    assert np.abs(Gas(1.4, corner=corner).exponent(f) - exact).max() < 0.12
    assert f[np.argmax(exact.imag)] == pytest.approx(corner, rel=0.15)


def test_slow_motions_meet_an_isothermal_gas_and_allocation_says_the_same(joint):
    at, lag = (0.1, 3 * BAR, 2.5 * BAR), 50.0
    warm, cold = replace(joint, gas=Gas(1.4, corner=0.05)), replace(joint, gas=Gas(1.0))
    slow = warm.dynamic_stiffness(*at, 1e-4, lag)
    assert slow == pytest.approx(cold.dynamic_stiffness(*at, 1e-4, lag), rel=1e-3)
    fast = replace(joint, gas=Gas(1.4)).dynamic_stiffness(*at, 50.0, lag)
    assert warm.dynamic_stiffness(*at, 50.0, lag) == pytest.approx(fast, rel=1e-3)
    for f in (0.01, 0.05, 0.3):
        meant = Stiffness(frequency=f, lag=(3.0, 1.0))
        a = allocate(0.1, 7.0, 1.0, joint=warm, stiffness=meant)
        assert a.success
        assert warm.dynamic_stiffness(0.1, a.P1, a.P2, f, (3.0, 1.0)).real == pytest.approx(7.0, rel=1e-9)


def test_a_corner_is_refused_where_it_would_be_ignored(joint):
    bent = replace(joint, agonist=fitted("Wickramatunge2010"), gas=Gas(1.4, corner=0.05))
    with pytest.raises(InvalidInput, match="the corner of the gas is known"):
        allocate(0.1, 6.0, joint=bent, stiffness=Stiffness(frequency=0.1, lag=0.1))
    with pytest.raises(InvalidInput, match="corner = 0 Hz has to be positive"):
        Gas(corner=0.0)


def test_a_file_keeps_the_corner(joint, tmp_path):
    warm = replace(joint, gas=Gas(1.4, corner=0.05))
    save_machine(warm, tmp_path / "joint.toml")
    assert load_joint(tmp_path / "joint.toml") == warm


def test_a_plant_knows_its_dynamic_stiffness(joint):
    plant = Plant(joint, damping=0.2, lag=(0.1, 0.05))
    x = np.array([0.1, 0.0, 3 * BAR, 2.5 * BAR])
    known = joint.dynamic_stiffness(0.1, 3 * BAR, 2.5 * BAR, 2.0, (0.1, 0.05), damping=0.2)
    assert plant.dynamic_stiffness(x, 2.0) == known
    u, h = x[2:], 1e-6  # against a linearisation of the plant's own equations
    A = np.array([(np.array(plant.rate(x + h * s * e, u)) - np.array(plant.rate(x - h * s * e, u))) / (2 * h * s)
                  for e, s in zip(np.eye(4), (1, 1, BAR, BAR), strict=True)]).T  # fmt: skip
    w = 4j * np.pi
    pressures = np.linalg.solve(w * np.eye(2) - A[2:, 2:], A[2:, 0] + w * A[2:, 1])
    J = plant.inertia
    assert -J * (A[1, 0] + w * A[1, 1] + A[1, 2:] @ pressures) == pytest.approx(known, rel=1e-6)
    assert replace(plant, gas=False).dynamic_stiffness(x, 2.0) == pytest.approx(plant.isobaric(x) + w * 0.2)
