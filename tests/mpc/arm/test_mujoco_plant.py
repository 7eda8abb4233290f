"""A plant on MuJoCo's bodies has the library's torques, energies, motions and stiffness, and the sensors of a rig."""

import copy
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from allocator import InvalidFile, InvalidInput
from allocator.joint.gas import Gas
from allocator.mechanism import machines
from allocator.mechanism.bodies import arm26_bodies, arm48_bodies
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR
from mpc.arm.mjcf import to_mjcf
from mpc.arm.mujoco_plant import MujocoPlant

MUSCLE = replace(SAROSI_DMSP_20_400N, tube_volume=20e-6)
ARM, BODIES = machines.arm26().with_muscles(MUSCLE), arm26_bodies()
Q, P = np.array([0.4, -0.3]), np.array([3.0, 2.0, 2.5, 3.5, 4.0, 1.5]) * BAR  # mechanisms' published numbers
TORQUE = np.array([9.363994, 4.090842])
GAS = Gas(1.3, 1.013e5)


def plant(mechanism=ARM, bodies=BODIES, **options):
    return MujocoPlant(to_mjcf(mechanism, bodies), mechanism.muscles, **options)


@pytest.mark.parametrize(("mechanism", "bodies"), [(ARM, BODIES), (machines.arm48(), arm48_bodies())])
def test_torques_lengths_and_energies_are_the_library_s(mechanism, bodies):
    rig, rng = plant(mechanism, bodies), np.random.default_rng(0)
    start = rig.reset(np.zeros(bodies.n)) and rig.energy[0]
    for _ in range(100):
        q, omega = rng.uniform(-0.4, 0.4, bodies.n), rng.uniform(-3, 3, bodies.n)
        pressures = rng.uniform(2.2, 5.0, mechanism.m) * BAR
        rig.reset(q, pressures, omega=omega)
        assert rig.tension == pytest.approx(mechanism.forces(q, pressures), rel=1e-12)
        assert rig.torque == pytest.approx(mechanism.torque(q, pressures), rel=1e-11, abs=1e-11)
        assert rig.lengths == pytest.approx(mechanism.lengths(q), rel=1e-13)
        potential, kinetic = rig.energy
        assert kinetic == pytest.approx(0.5 * omega @ bodies.mass_matrix(q) @ omega, rel=1e-11)
        path = np.linspace(0, 1, 41)[:, None] * q
        held = (bodies.gravity_torque(path) * q).sum(axis=1)  # Simpson's rule along a straight line
        work = (held[0] + held[-1] + 4 * held[1::2].sum() + 2 * held[2:-1:2].sum()) / 120
        assert potential - start == pytest.approx(work, abs=1e-7)


def test_the_published_torque():
    rig = plant()
    rig.reset(Q, P)
    assert rig.torque == pytest.approx(TORQUE, abs=1e-6)


def test_a_slack_cable_pulls_nothing():
    rig = plant()
    rig.reset(Q, 0.0)
    assert (ARM.forces(Q, np.zeros(6)) < 0).all()
    assert (rig.tension == 0).all()


@pytest.mark.parametrize("gas", [None, GAS])
def test_motions_are_those_of_an_independent_integrator(gas):
    """SciPy's DOP853 on the library's formulas, muscle by muscle."""
    u, load = P + np.array([0.5, -0.3, 0.4, 0.0, -0.6, 0.6]) * BAR, np.array([0.3, -0.2]) - TORQUE

    def rate(t, x):
        q, omega, pressures = x[:2], x[2:4], x[4:]
        torque = ARM.torque(q, pressures) - BODIES.bias(q, omega) + load
        filling = (u - pressures) / 0.08
        if gas is not None:
            eps = ARM.contractions(q)
            V = np.array([MUSCLE.volume(p, e, 0.4) for p, e in zip(pressures, eps, strict=True)])
            growth = MUSCLE.gain(pressures, eps) * (ARM.arms(q) @ omega)  # V' = F_P r·ω
            filling = filling - gas.kappa * (pressures + gas.atmosphere) * growth / V
        return np.concatenate([omega, np.linalg.solve(BODIES.mass_matrix(q), torque), filling])

    rig = plant(lag=0.08, gas=gas)
    rig.reset(Q, P, omega=(0.5, -0.5))
    for _ in range(20):
        rig.step(u, 0.01, load=load)
    found = solve_ivp(rate, (0, 0.2), [*Q, 0.5, -0.5, *P], method="DOP853", rtol=1e-11, atol=1e-11).y[:, -1]
    assert rig.q == pytest.approx(found[:2], abs=1e-8)
    assert rig.omega == pytest.approx(found[2:4], abs=1e-6)
    assert rig.P == pytest.approx(found[4:], abs=1e-2)
    assert rig.time == pytest.approx(0.2, abs=1e-12)


def test_pushing_measures_the_isobaric_stiffness():
    rig = plant()
    rig.reset(Q, P)
    K = rig.pushed_stiffness(load=-rig.torque)
    assert np.abs(K - ARM.stiffness(Q, P)).max() < 1e-4  # of second order in the push
    assert rig.q == pytest.approx(Q, abs=0)  # and leaves the machine where it was
    assert rig.time == 0


def test_pushing_shut_valves_measures_the_trapped_gas():
    """κ (P + p_a)/V g gᵀ of every muscle beside the isobaric stiffness   (G2), numbers computed independently."""
    rig = plant(gas=GAS)
    rig.reset(Q, P)
    K = rig.pushed_stiffness(0.02, load=-rig.torque, shut=True)
    assert np.abs(K - [[18.346671, 7.110218], [7.110218, 15.677877]]).max() < 1e-4


def test_muscles_as_strong_as_they_are_told():
    gains = np.array([1.05, 0.95, 1.0, 1.0, 0.0, 1.0])
    rig = plant(force_gains=gains)
    rig.reset(Q, P)
    assert rig.tension == pytest.approx(gains * ARM.forces(Q, P), rel=1e-12)


# --- regulators and sensors -------------------------------------------------------------------------------------------


def test_pressures_lag_behind_commands_that_are_slewed_late():
    """A ramp of 2 bar/s that begins after 15 ms, behind a lag of 0.1 s."""
    rig = plant(lag=0.1, slew=2 * BAR, dead_time=0.015, gas=False)
    rig.reset(Q, P)
    u = P.copy()
    expected, command, waiting = P[0], P[0], [P[0], P[0]]
    for _ in range(12):
        u[0] = P[0] + 1.0 * BAR
        rig.step(u, 0.01)
        command = min(command + 2 * BAR * 0.01, u[0])
        waiting.append(command)
        for value in waiting[:2]:  # 15 ms are a sample and a half: half of each acts with the older command
            expected = value + (expected - value) * np.exp(-0.005 / 0.1)
        waiting.pop(0)
        assert rig.P[0] == pytest.approx(expected, rel=1e-9)


def test_regulators_stay_within_the_supply():
    rig = plant(lag=0.01, gas=False)
    rig.reset(Q, P)
    for _ in range(20):
        rig.step([-1 * BAR, 9 * BAR, 0, 0, 0, 0], 0.01)
    assert rig.P[:2] == pytest.approx([0.0, 5 * BAR], abs=1.0)


def test_sensors_round_and_err_as_told_and_repeat_by_their_seed():
    rig = plant(encoder=1e-3, pressure_noise=0.02 * BAR)
    first = rig.reset(Q + 2.4e-4, P, seed=3)
    assert first.q == pytest.approx(Q, abs=1e-15)
    errors = np.array([rig.measure().P - P for _ in range(500)])
    assert errors.std() == pytest.approx(0.02 * BAR, rel=0.05)
    assert (rig.reset(Q, P, seed=3).P == first.P).all()
    assert (rig.reset(Q, P, seed=4).P != first.P).all()


def test_a_copy_goes_its_own_way():
    rig = plant(gas=True)
    rig.reset(Q, P)
    twin = copy.deepcopy(rig)
    twin.step(P, 0.01)
    assert rig.time == 0
    rig.step(P, 0.01)
    assert (rig.q == twin.q).all()


# --- other models -----------------------------------------------------------------------------------------------------

WRAPPED = """
<mujoco><option timestep="0.001" gravity="0 0 -9.81"/><worldbody>
  <site name="s" pos="-0.3 0 0.025"/><site name="side" pos="0 0 0.1"/>
  <body><joint name="turn" axis="0 -1 0" damping="0.2"/>
    <geom name="drum" type="cylinder" size="0.02 0.02" euler="90 0 0" contype="0" conaffinity="0"/>
    <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.01" mass="0.5" contype="0" conaffinity="0"/>
    <site name="e" pos="0.05 0 -0.01"/></body>
  <body pos="1 0 0.5"><freejoint/><geom size="0.05" mass="0.2"/></body>
</worldbody><tendon><spatial name="pull"><site site="s"/><geom geom="drum" sidesite="side"/><site site="e"/></spatial>
</tendon></mujoco>"""


def test_any_tendon_of_mujoco_s_may_be_a_muscle():
    """One that runs round a drum; beside it falls a free body, which no muscle moves."""
    rig = MujocoPlant(WRAPPED, SAROSI_DMSP_20_400N, 0.4, cable=0.0)
    assert (rig.n, rig.m, rig.joint_names, rig.muscle_names) == (1, 1, ("turn",), ("pull",))
    rig.reset([0.3], [3 * BAR])
    lengths = []
    for step in (1e-6, -1e-6):
        rig.reset([0.3 + step], [3 * BAR])
        lengths.append(rig.lengths[0])
    rig.reset([0.3], [3 * BAR])
    assert rig.arms[0, 0] == pytest.approx(0.02, rel=1e-6)  # it is the drum's radius while the tendon touches it
    assert rig.arms[0, 0] == pytest.approx((lengths[1] - lengths[0]) / 2e-6, rel=1e-6)
    assert rig.torque[0] == pytest.approx(rig.arms[0, 0] * SAROSI_DMSP_20_400N.force(3 * BAR, 1 - rig.lengths[0] / 0.4))
    for _ in range(10):
        rig.step([3 * BAR], 0.01)
    fallen = rig.data.qpos[3]
    assert fallen == pytest.approx(0.5 - 9.81 * 0.1**2 / 2, abs=1e-9)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"lag": 0.0}, "lag"),
        ({"lag": 200.0}, "milliseconds"),
        ({"slew": 5.0}, "bar/s"),
        ({"pressure_limits": (0.0, 5.0)}, "bar"),
        ({"dead_time": -1.0}, "dead_time"),
        ({"dead_time": 20.0}, "milliseconds"),
        ({"force_gains": (1.0, 1.0)}, "force_gains"),
        ({"rest_length": 400.0}, "metres"),
        ({"cable": 0.1}, "without rest_length"),
        ({"gas": "air"}, "gas"),
    ],
)
def test_wrong_numbers_are_named(options, sentence):
    with pytest.raises(InvalidInput, match=sentence):
        plant(**options)


def test_wrong_models_and_commands_are_named(tmp_path):
    with pytest.raises(InvalidFile, match="no tendons"):
        MujocoPlant("<mujoco><worldbody/></mujoco>", MUSCLE)
    with pytest.raises(InvalidFile, match="does not exist"):
        MujocoPlant(tmp_path / "none.xml", MUSCLE)
    with pytest.raises(InvalidInput, match="neither a file"):
        MujocoPlant(3, MUSCLE)
    with pytest.raises(InvalidInput, match="2 given for m = 6"):
        MujocoPlant(to_mjcf(ARM, BODIES), [MUSCLE, MUSCLE])
    rig = plant(gas=False)
    for commands, sentence in (([3.0] * 6, "bar"), (P[:5], r"expected \(6,\)"), (P * np.nan, "not finite")):
        with pytest.raises(InvalidInput, match=sentence):
            rig.step(commands, 0.01)
    with pytest.raises(InvalidInput, match="dt"):
        rig.step(P, 0.0)
    with pytest.raises(InvalidInput, match="say gas=True"):
        rig.pushed_stiffness(shut=True)


@pytest.mark.slow
def test_what_falls_finds_no_rest():
    rig = MujocoPlant(WRAPPED, SAROSI_DMSP_20_400N, 0.4, cable=0.0)
    with pytest.raises(InvalidInput, match="does not come to rest"):
        rig.settle()  # the free body falls


TUMBLING = """
<mujoco><option timestep="0.002" integrator="RK4"/><worldbody>
  <geom type="plane" size="2 2 0.1"/>
  <site name="s" pos="-0.3 0 0.5"/>
  <body pos="0 0 0.5"><joint name="turn" axis="0 1 0" damping="0.1" range="-1 1" limited="true"/>
    <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.01" mass="0.5"/><site name="e" pos="0.05 0 0.03"/>
    <body pos="0.3 0 0"><joint type="ball"/><geom type="box" size="0.03 0.05 0.08" pos="0.05 0 0"/></body></body>
  <body pos="0.6 0 0.15" euler="20 30 0"><freejoint/><geom type="box" size="0.05 0.08 0.03" mass="0.2"/></body>
</worldbody><tendon><spatial name="pull"><site site="s"/><site site="e"/></spatial></tendon></mujoco>"""


def test_without_force_it_is_mujoco_s_own_motion():
    """Its Runge–Kutta, with a ball joint, a box that falls on the floor and a joint that meets its stop."""
    model = mujoco.MjModel.from_xml_string(TUMBLING)
    data = mujoco.MjData(model)
    rig = MujocoPlant(TUMBLING, SAROSI_DMSP_20_400N, 0.4, force_gains=0.0)
    rig.reset([0.0], [0.0], omega=[2.0])
    data.qvel[0] = 2.0
    for k in range(100):
        rig.step([0.0], 0.01)
        for _ in range(5):
            mujoco.mj_step(model, data)
        if k == 8:
            assert data.ncon == 0
            assert rig.data.qpos == pytest.approx(data.qpos, abs=1e-12)
    assert data.ncon > 0
    assert rig.data.qpos == pytest.approx(data.qpos, abs=1e-4)  # contacts multiply differences of their solver's
    assert rig.time == pytest.approx(data.time)
