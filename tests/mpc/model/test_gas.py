"""The gas of a plant: the polytropic law behind shut valves, work that is none, (G4), files and bad input."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from allocator import BAR, DEG, InvalidInput
from allocator.joint.antagonist import report_joint
from allocator.joint.gas import Gas
from allocator.joint.geometry import Lever
from allocator.machine_file import save_machine
from allocator.muscles import Sarosi2012
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc import Plant, RealPlant
from mpc.model.faults import StuckValve

PULLEY = report_joint(SAROSI_DMSP_20_400N)
LEVER = replace(PULLEY, geometry=Lever(0.25, anchor=0.1655, lever=0.05094, offset=0.051), angle_limits=None)
JOINTS = pytest.mark.parametrize("joint", [PULLEY, report_joint(), LEVER], ids=["pulley", "V of P too", "lever"])
REST = np.array([0.0, 0.0, 3 * BAR, 3 * BAR])
PUSHING = Sarosi2012(c1=0.0, c2=-0.01, c3=-0.003, c4=0.0, c5=-100.0, c6=0.0)


def swept(rates, amplitude=20 * DEG, P=(3 * BAR, 2 * BAR)):
    """Pressures, work and work exchanged after the cycle θ = amplitude (sin t + sin 2t / 2) of a joint driven along it.

    `rates` (x) ↦ (torque, pressure rates). The valves are shut.
    """

    def slope(t, y):
        theta = amplitude * (np.sin(t) + np.sin(2 * t) / 2)
        omega = amplitude * (np.cos(t) + np.cos(2 * t))
        T, falls = rates(np.array([theta, omega, y[0], y[1]]))
        return [*falls, T * omega, abs(T * omega)]

    options = {"method": "DOP853", "rtol": 1e-13, "atol": [1e-7, 1e-7, 1e-14, 1e-14], "max_step": 0.2}
    return solve_ivp(slope, (0, 2 * np.pi), [*P, 0.0, 0.0], **options)


def of(plant):
    return lambda x: (plant.torque(x), plant.rate(x, x[2:])[2:])


@JOINTS
def test_behind_shut_valves_the_gas_keeps_to_the_polytropic_law(joint):
    plant = Plant(joint, gas=Gas(kappa=1.37))
    path = swept(of(plant))
    t = path.t
    theta = 20 * DEG * (np.sin(t) + np.sin(2 * t) / 2)
    for side, P in zip(plant.joint.sides(theta), path.y, strict=False):
        kept = (P + plant.gas.atmosphere) * side.volume(P) ** 1.37
        np.testing.assert_allclose(kept, kept[0], rtol=1e-9)
        assert np.ptp(P) > 0.2 * BAR


@JOINTS
def test_a_closed_cycle_of_a_shut_joint_makes_no_work(joint):
    work, exchanged = swept(of(Plant(joint, gas=True))).y[2:, -1]
    assert abs(work) <= 1e-9 * exchanged
    assert exchanged > 0.1


@JOINTS
@pytest.mark.parametrize("gains", [(1.3, 0.7), (0.0, 1.0)], ids=["stronger and weaker", "a broken cable"])
def test_nor_does_one_of_muscles_that_pull_otherwise_than_their_law(joint, gains):
    real = RealPlant(Plant(joint, gas=True), gains, shut=(True, True))
    x, u = ca.SX.sym("x", 4), ca.SX.sym("u", 2)
    rate = ca.Function("rate", [x, u], [ca.vertcat(real.torque(x), *real.rate(x, u, 0.0, 0.0)[2:])])

    def rates(x):
        T, *falls = rate(x, [0.0, 5e5]).full().ravel().tolist()  # whatever is commanded
        return T, falls

    *P, work, exchanged = swept(rates).y[:, -1]
    assert abs(work) <= 1e-9 * exchanged
    if not gains[0]:
        assert P[0] == 3 * BAR  # nothing moves its gas


def test_a_shut_joint_without_friction_swings_for_ever():
    """Its kinetic energy is the integral of the torque over the angle, with pressures by the polytropic law."""
    plant = Plant(PULLEY, damping=0.0, gas=True)
    x0 = np.array([25 * DEG, 0.0, 3 * BAR, 3 * BAR])
    options = {"method": "DOP853", "rtol": 1e-13, "atol": [1e-13, 1e-13, 1e-7, 1e-7], "max_step": 0.005}
    path = solve_ivp(lambda t, x: plant.rate(x, x[2:]), (0, 2.0), x0, **options)

    def torque(theta):
        one, two = plant.joint.sides(theta)
        start = zip(plant.joint.sides(x0[0]), x0[2:], strict=True)
        V0, absolute = zip(*((side.volume(P), P + plant.gas.atmosphere) for side, P in start), strict=True)
        P = [
            p * (V / side.volume(0.0)) ** plant.gas.kappa - plant.gas.atmosphere
            for p, V, side in zip(absolute, V0, (one, two), strict=True)
        ]
        return one.torque(P[0]) + two.torque(P[1])

    given = [quad(torque, x0[0], theta, epsabs=1e-14, epsrel=1e-13)[0] for theta in path.y[0, ::25]]
    kinetic = plant.inertia * path.y[1, ::25] ** 2 / 2
    assert np.count_nonzero(np.diff(np.sign(path.y[1]))) >= 8
    np.testing.assert_allclose(kinetic, given, atol=1e-9 * kinetic.max())


@JOINTS
def test_small_motions_at_a_fixed_command_meet_the_dynamic_stiffness(joint):
    """(G4) against the plant's own linearisation: T/θ of its pressures, driven by θ and s θ."""
    plant = Plant(joint, lag=(0.1, 0.05), gas=True)
    x = ca.SX.sym("x", 4)
    torque = ca.SX(plant.torque(x))
    pressures = ca.vertcat(*plant.rate(x, REST[2:])[2:])
    slopes = ca.Function("slopes", [x], [ca.jacobian(torque, x), ca.jacobian(pressures, x)])
    by_x, A = (np.array(value) for value in slopes(REST))
    for frequency in (0.05, 0.5, 2.0, 20.0):
        s = 2j * np.pi * frequency
        P = np.linalg.solve(s * np.eye(2) - A[:, 2:], A[:, 0] + s * A[:, 1])
        K = -(by_x[0, 0] + by_x[0, 2:] @ P)
        expected = plant.joint.dynamic_stiffness(0.0, *REST[2:], frequency, plant.lags)
        assert complex(K) == pytest.approx(complex(expected), rel=1e-9)
        assert RealPlant(plant).dynamic_stiffness(REST, frequency) == pytest.approx(complex(expected), rel=1e-12)


@JOINTS
def test_symbols_and_numbers_give_the_same_rates(joint):
    plant = Plant(joint, lag=(0.1, 0.2), gravity_torque=1.5, gas=True)
    X, U = np.array([0.3, -1.0, 2.5 * BAR, 3.5 * BAR]), np.array([3.0 * BAR, 2.0 * BAR])
    x, u, d = ca.SX.sym("x", 4), ca.SX.sym("u", 2), ca.SX.sym("d")
    symbolic = ca.Function("f", [x, u, d], [ca.vertcat(*plant.rate(x, u, d))])(X, U, 0.4)
    np.testing.assert_allclose(symbolic.full()[:, 0], plant.rate(X, U, 0.4), rtol=1e-12)


def test_the_stiffness_of_a_plant_is_isobaric_or_the_storage_at_its_frequency():
    isobaric, felt, shut = (Plant(PULLEY, gas=True, frequency=f) for f in (0.0, 2.0, np.inf))
    joint = isobaric.joint
    assert isobaric.stiffness(REST) == joint.stiffness(0.0, *REST[2:])
    storage = complex(joint.dynamic_stiffness(0.0, *REST[2:], 2.0, 0.1)).real
    assert felt.stiffness(REST) == pytest.approx(storage, rel=1e-12)
    assert RealPlant(felt).stiffness(REST) == pytest.approx(storage, rel=1e-12)
    assert shut.stiffness(REST) == pytest.approx(joint.stiffness(0.0, *REST[2:], valves="shut"), rel=1e-12)
    for plant, K in ((isobaric, 6.0), (felt, 9.0), (shut, 11.0)):
        assert plant.stiffness(plant.at_rest(15 * DEG, K)) == pytest.approx(K, rel=1e-9)
    assert felt.kind.text == "dynamic stiffness at 2 Hz"
    assert (isobaric.kind.name, shut.kind.name) == ("isobaric", "shut")


def test_where_a_law_s_volume_is_none_the_rates_stay_finite_and_the_gas_passive():
    """The report's muscle law has V^eff < 0 at 5 bar and 125°: a gas there would push instead of pull."""
    plant = Plant(gas=True)
    for theta in np.linspace(*plant.joint.angle_range, 9):
        for P in (1 * BAR, 5 * BAR):
            one, two = plant.expansion(np.array([theta, 1.0, P, P]))
            assert one > 0 > two
    assert 1 / plant.fastest_rate > 0.01


@pytest.mark.slow
def test_within_its_dead_band_a_regulator_is_a_shut_valve():
    """Pushed slowly by a load, as far as ±δ/2 of pressure: the joint gives way by T/K_shut, else by T/K."""
    plant = Plant(PULLEY, damping=1.0, gas=True)
    turned = {}
    for band in (0.0, 0.3 * BAR):
        experiment = RealPlant(plant, dead_band=band).begin(0.01, REST, seed=0)
        for _ in range(300):
            experiment.advance(REST[2:], 0.5)
        turned[band] = experiment.x[0]
    K, K_shut = plant.stiffness(REST), plant.joint.stiffness(0.0, *REST[2:], valves="shut")
    assert 0.5 / turned[0.0] == pytest.approx(K, rel=1e-2)
    assert 0.5 / turned[0.3 * BAR] == pytest.approx(K_shut, rel=1e-2)


@pytest.mark.slow
def test_a_valve_that_sticks_traps_the_gas_and_a_flow_limit_is_the_regulator_s():
    plant = Plant(PULLEY, gas=True)
    real = RealPlant(plant, faults=(StuckValve(muscle=1),), flow=0.5 * BAR)
    experiment = real.begin(0.01, REST, seed=0)
    for _ in range(400):
        experiment.advance(REST[2:] + BAR, 1.0)
    theta, _, P1, P2 = experiment.x
    one = plant.joint.sides(theta)[0]
    kept = (3 * BAR + plant.gas.atmosphere) * plant.joint.sides(0.0)[0].volume(3 * BAR) ** plant.gas.kappa
    assert (P1 + plant.gas.atmosphere) * one.volume(P1) ** plant.gas.kappa == pytest.approx(kept, rel=1e-8)
    assert P2 == pytest.approx(4 * BAR, rel=1e-3)
    assert abs(P1 - 3 * BAR) > 1e3


def test_a_plant_s_file_keeps_its_gas(tmp_path):
    plant = Plant(PULLEY, gas=Gas(kappa=1.4), frequency=2.0)
    plant.save(tmp_path / "plant.toml")
    assert Plant.load(tmp_path / "plant.toml") == plant
    usual = Plant(PULLEY)
    usual.save(tmp_path / "usual.toml")
    assert Plant.load(tmp_path / "usual.toml") == usual
    Plant(PULLEY, gas=False).save(tmp_path / "bare.toml")
    assert Plant.load(tmp_path / "bare.toml").gas is None


def test_a_plant_has_gas_unless_it_is_told_not_to(tmp_path):
    assert Plant().gas == Plant(gas=True).gas == RealPlant.standard().nominal.gas == Gas()
    assert Plant(gas=False).gas is Plant(gas=None).gas is None
    save_machine(PULLEY, tmp_path / "joint.toml")  # without a word on gas
    assert Plant.load(tmp_path / "joint.toml") == Plant(PULLEY)


def test_muscles_of_unknown_volume_hold_as_much_as_braids_that_pull_like_them(tmp_path):
    length, bare = PULLEY.geometry.rest_length, replace(SAROSI_DMSP_20_400N, inner_radius=None)
    plant = Plant(report_joint(bare))
    known, assumed = (plant.joint.agonist.volume(2.5 * BAR, 0.1, length) for plant in (Plant(PULLEY), plant))
    assert assumed == pytest.approx(known, rel=0.25)
    assert f"{plant.joint.agonist.rest_volume * 1e6:.3g} cm³" in plant.summary
    plant.save(tmp_path / "plant.toml")
    assert Plant.load(tmp_path / "plant.toml") == plant
    assert Plant(report_joint(bare), gas=False).joint.agonist == bare


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"gas": "air"}, "gas = 'air' has to be a Gas"),
        ({"gas": False, "frequency": 2.0}, "frequency = 2 Hz: the stiffness has none"),
        ({"gas": True, "frequency": -1.0}, "frequency = -1 Hz has to be 0 or more"),
        ({"joint": report_joint(PUSHING)}, "Sarosi2012 gains no force by pressure .* gas=False"),
        ({"joint": report_joint(replace(SAROSI_DMSP_20_400N, rest_volume=1e-7))}, "would grow .* gas=False"),
    ],
)
def test_a_gas_that_makes_no_sense_is_refused(wrong, said):
    with pytest.raises(InvalidInput, match=said):
        Plant(**wrong)
