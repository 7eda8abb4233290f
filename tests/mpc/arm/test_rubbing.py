"""Friction at the joints and in the muscles of a machine, in the plant and in the model."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import InvalidInput
from allocator.units import BAR, DEG
from mpc.arm.mujoco_plant import MujocoPlant
from mpc.model.arm.model import Arm
from mpc.model.compensation import Compensation
from mpc.model.faults import BrokenCable, DriftingSensor, FrozenSensors, Leak, SilentSensors, StuckValve
from mpc.model.friction.contact import Contacts, Loads
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.model.plant import Plant
from mpc.model.real import RealPlant
from mpc.observer.filter import CALM_NOISE
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.cost import CALM
from mpc.trials.loops import Settings, loop
from mpc.trials.metrics import metrics
from mpc.trials.motions.arm_trajectories import reference
from mpc.trials.simulation import in_motion, simulate

from ...rigs.one_joint import arm_of

JOINT = Plant(gas=False)
ONE, TWO = arm_of(JOINT), replace(Arm.machine("arm26"), gas=False)
FRICTIONS = {
    "Dahl": Friction.of_width(JOINT, 5 * DEG),
    "Maxwell slip": MaxwellSlip.of_width(JOINT, 5 * DEG),
}


def test_the_loads_of_an_arm_of_one_joint_are_those_of_the_joint():
    x = np.array([0.3, 0.1, 3.1 * BAR, 2.2 * BAR])
    (one,), joint = Contacts(ONE)(x), Loads.of(JOINT, x)
    assert (one.pulled, one.filled, one.stiffness) == pytest.approx(
        (joint.pulled, joint.filled, joint.stiffness), rel=1e-12
    )


def test_the_loads_at_joints_are_sums_over_the_muscles_that_cross_them():
    x = np.array([0.4, -0.3, 0, 0, *np.array([3.0, 2.0, 2.5, 3.5, 4.0, 1.5]) * BAR])
    r, F, K = np.array([0.02, 0.02, 0, 0, 0.02, 0.02]), TWO.forces(x), TWO.stiffness(x)
    first, second = Contacts(TWO)(x)
    assert first.pulled == pytest.approx(r @ F)
    assert first.filled == pytest.approx(2 * np.mean([3.0, 2.0, 4.0, 1.5]) * BAR)
    assert (first.stiffness, second.stiffness) == pytest.approx(tuple(np.diag(K)))


@pytest.mark.parametrize("name", FRICTIONS)
def test_one_joint_on_mujoco_moves_as_the_joint_with_the_same_friction(name):
    """Two integrators, one of MuJoCo's bodies and one of the joint's formulas."""
    friction, dt, samples = FRICTIONS[name], 0.01, 80
    x0 = np.array([0.0, 0.0, 3 * BAR, 3 * BAR])
    real = RealPlant(JOINT, friction=friction).begin(dt, x0, 0)
    model = MujocoPlant.of(ONE, friction=friction, slew=np.inf)
    model.model.opt.timestep = 1e-3
    arm = model.begin(dt, x0, 0)
    for k in range(samples):
        u = x0[2:] + 0.4 * BAR * np.sin(2 * np.pi * k * dt) * np.array([1, -1])
        real.advance(u)
        arm.advance(u)
        assert arm.x[0] == pytest.approx(real.x[0], abs=0.01 * DEG)
    free = MujocoPlant.of(ONE, slew=np.inf).begin(dt, x0, 0)
    for k in range(samples):
        free.advance(x0[2:] + 0.4 * BAR * np.sin(2 * np.pi * k * dt) * np.array([1, -1]))
    assert abs(free.x[0] - arm.x[0]) > 0.5 * DEG  # the friction is seen


def test_friction_in_muscles_is_that_at_the_joint_by_the_radius():
    """Along a pulley of radius r a friction f(l) of both muscles turns with r f(r θ) each."""
    r = float(np.abs(ONE.mechanism.arms([0.0]))[0, 0])
    at_joint = Friction(coulomb=0.4, presliding=0.02)
    in_muscles = Friction(coulomb=0.2 / r, presliding=0.02 * r)
    x0 = np.array([0.0, 0.0, 3 * BAR, 3 * BAR])
    ends = []
    for given in ({"friction": at_joint}, {"muscle_friction": in_muscles}):
        run = MujocoPlant.of(ONE, **given).begin(0.01, x0, 0)
        for _ in range(30):
            run.advance(x0[2:] + 0.3 * BAR * np.array([1, -1]))
        ends.append(run.x[0])
    assert ends[0] == pytest.approx(ends[1], rel=1e-6)


def test_another_number_of_frictions_than_joints_is_refused():
    with pytest.raises(InvalidInput, match="2 models given for 1"):
        MujocoPlant.of(ONE, friction=[Friction(0.1), Friction(0.1)])
    with pytest.raises(InvalidInput, match="1 frictions for n = 2 joints"):
        KalmanObserver(TWO, 0.01, compensation=Compensation(frictions=(Friction(0.1),)))


@pytest.mark.slow
def test_an_observer_told_of_the_friction_finds_no_torque_where_one_untold_does():
    """A slow sweep of arm26: untold friction is a disturbance torque."""
    friction = tuple(Friction.of_width(TWO, 5 * DEG, joint=i) for i in range(2))
    plant = MujocoPlant.of(TWO, friction=friction, encoder=0.02 * DEG, pressure_noise=0.02 * BAR)
    x0 = TWO.at_rest(TWO.middle, [[12.0, 4.6], [4.6, 9.5]])
    told = KalmanObserver(TWO, 0.01, compensation=Compensation(frictions=friction))
    untold, found = KalmanObserver(TWO, 0.01), []
    run, u = plant.begin(0.01, x0, 0), x0[4:]
    for k in range(250):
        y = run.measure()
        found.append([np.abs(observer.estimate(y, u)[1]) for observer in (told, untold)])
        u = x0[4:] + min(k, 150) / 150 * BAR * np.array([1, -1, 1, -1, 0, 0])
        run.advance(u)
    mean = np.mean(found[50:], axis=0)
    assert (mean[0] < 0.35 * mean[1]).all()


MANY = {"joints": 2, "muscles": 6}


def test_faults_of_two_joints_do_what_they_say():
    x0 = TWO.at_rest(TWO.middle, [[12.0, 4.6], [4.6, 9.5]])
    faults = (
        Leak(0.1, muscle=3, kept=0.5, **MANY), StuckValve(0.1, muscle=4, **MANY),
        FrozenSensors(0.1, sensors=(1,), **MANY), SilentSensors(0.1, sensors=(5,), **MANY),
        DriftingSensor(0.1, sensor=4, rate=BAR, **MANY),
    )  # fmt: skip
    run = MujocoPlant.of(TWO, faults=faults, pressure_offset=[0.0, 0.0, 0.0, 0.0, 0.0, 0.1 * BAR]).begin(0.01, x0, 0)
    said = []
    for _ in range(30):
        said.append(run.measure())
        run.advance(x0[4:] + 0.5 * BAR)
    said, x = np.array(said), run.x
    assert x[4 + 2] < 0.6 * x0[4 + 2]  # the leak
    assert x[4 + 3] == pytest.approx(said[10, 4 + 3])  # the stuck valve
    assert np.ptp(said[10:, 1]) == 0 < np.ptp(said[10:, 0])
    assert np.isnan(said[10:, 5]).all()
    assert np.isfinite(said[:10, 4:]).all()
    assert said[0, 9] == pytest.approx(x0[9] + 0.1 * BAR)
    assert said[-1, 4] - x[4] > 0.1 * BAR
    with pytest.raises(InvalidInput, match="joints=2, muscles=6"):
        MujocoPlant.of(TWO, faults=(Leak(muscle=1),))
    with pytest.raises(InvalidInput, match="one of 1 to 6"):
        BrokenCable(muscle=7, **MANY)


def test_a_broken_cable_pulls_no_more():
    x0 = TWO.at_rest(TWO.middle, [[12.0, 4.6], [4.6, 9.5]])
    run = MujocoPlant.of(TWO, faults=(BrokenCable(muscle=1, **MANY),)).begin(0.01, x0, 0)
    for _ in range(10):
        run.advance(x0[4:])
    assert run.x[0] < TWO.middle[0] - 3 * DEG


@pytest.mark.slow
def test_a_joint_that_sticks_while_another_moves_is_not_frozen():
    """Dry friction of MuJoCo, of which controller and observer know half: the best share on circle and reach."""
    force_gains = 1 + 0.05 * np.random.default_rng(0).choice([-1.0, 1.0], TWO.m)
    sensors = {"encoder": 0.02 * DEG, "pressure_noise": 0.02 * BAR}
    plant = MujocoPlant.of(TWO, force_gains=force_gains, dead_time=0.02, **sensors)
    plant.model.dof_frictionloss[:] = 0.5
    asked, errors, said = reference("reach", TWO), [], set()
    for share in (0.0, 0.5):
        known = Compensation(Friction(coulomb=share * 0.5), dead_time=0.02)
        controller, observer = loop("mpc", Settings(TWO, compensation=known, weights=CALM, noise=CALM_NOISE))
        run = simulate(
            plant, controller, asked, x0=in_motion(TWO, asked), observer=observer,
            watch=lambda observer=observer: said.add(str(observer.health)),
        )  # fmt: skip
        errors.append(metrics(run).theta_rms)
    assert not any("frozen" in what for what in said)
    assert (errors[1] < 0.9 * errors[0]).all()
