"""Features of a joint's controller, observer and runs, for an arm."""

import pickle
from copy import deepcopy

import numpy as np
import pytest

from allocator import InvalidInput
from allocator.units import BAR, DEG
from mpc import Compensation, KalmanObserver, TrackingMPC
from mpc.model.arm.model import Arm
from mpc.model.friction.dahl import Friction
from mpc.observer.gating import Verdict
from mpc.tracking.qp.programme import QP
from mpc.tracking.qp.solvers import DAQP
from mpc.trials.metrics import metrics
from mpc.trials.motions.arm_trajectories import hold
from mpc.trials.simulation import simulate

pytestmark = pytest.mark.compiles

ARM = Arm.machine("arm26")
K_REF = np.array([[12.0, 4.6], [4.6, 9.5]])
POSTURE = np.array([0.1, 0.2])
REST = ARM.at_rest(POSTURE, K_REF)


@pytest.fixture(scope="module")
def controller():
    return TrackingMPC(ARM, N=8)


def test_the_qp_of_a_step_gives_its_commands(controller):
    controller.reset()
    asked = REST, POSTURE + 0.02, K_REF
    qp = controller.qp(*asked)
    assert qp.decisions[:2] == ("ΔP1[0]", "ΔP2[0]")
    assert {"angle 2[8] upper", "muscle 6 taut[1]"} <= set(qp.row_names)
    z, _ = DAQP()(programme(qp))
    np.testing.assert_allclose(qp.commands(z), controller.step(*asked).u, atol=200.0)  # Pa: the proof is of 500


def programme(named):
    arrays = named.H, named.f, named.lower, named.upper, named.rows, named.rows_lower, named.rows_upper
    return QP(*(array.copy() for array in arrays))  # DAQP takes none that is read-only


@pytest.mark.parametrize("copied", [deepcopy, lambda made: pickle.loads(pickle.dumps(made))], ids=["copy", "pickle"])
def test_a_copy_goes_on_where_the_controller_was(controller, copied):
    controller.reset()
    controller.step(REST, POSTURE + 0.02, K_REF)
    other = copied(controller)
    plans = [each.step(REST, POSTURE + 0.02, K_REF) for each in (controller, other)]
    np.testing.assert_allclose(plans[1].u, plans[0].u, atol=1e-6)


def test_the_readable_step_answers_as_the_compiled_one(controller):
    controller.reset()
    readable = TrackingMPC(ARM, N=8, compiled=False)
    assert (controller.implementation, readable.implementation) == ("compiled", "readable")
    plans = [each.step(REST, POSTURE + 0.02, K_REF) for each in (controller, readable)]
    np.testing.assert_allclose(plans[1].u, plans[0].u, atol=200.0)


def test_a_dead_band_is_compensated():
    band = 0.2 * BAR
    mpc = TrackingMPC(ARM, N=8, compiled=False, compensation=Compensation(dead_band=band))
    plain = TrackingMPC(ARM, N=8, compiled=False)
    plans = [each.step(REST, POSTURE + 1e-4, K_REF) for each in (plain, mpc)]
    beyond = np.abs(plans[1].u - plans[0].u)
    assert 0 < beyond.max() <= band / 2 * (1 + 1e-9)


def test_the_friction_of_the_intended_motion_is_in_the_prediction():
    """Against the motion, of every joint by its own model."""
    known = Compensation(frictions=(Friction(coulomb=0.3), Friction()))
    mpc = TrackingMPC(ARM, N=8, compiled=False, compensation=known)
    ahead = POSTURE + 0.02 * np.arange(9)[:, None] * np.array([1, -1])
    T_f = Friction(coulomb=0.3).along(0.0, ahead[:, 0]) * 0.3
    task = mpc._preview.task(REST, ahead, K_REF, np.array([0.5, 0.1]))
    np.testing.assert_allclose(task.d, np.stack([0.5 - T_f, np.full(9, 0.1)], axis=1), atol=1e-12)


def test_an_encoder_that_jumps_is_not_believed():
    observer, y = KalmanObserver(ARM, 0.01), np.where(np.arange(10) // 2 == 1, np.nan, REST)
    rng = np.random.default_rng(2)
    for _ in range(20):
        noise = np.concatenate([rng.normal(0, 1e-4, 4), rng.normal(0, 1e3, 6)])
        observer.estimate(y + noise, REST[4:])
    off = y.copy()
    off[1] += 20 * DEG
    x, d = observer.estimate(off, REST[4:])
    assert observer.verdicts[1] is Verdict.REJECTED
    assert abs(x[1] - REST[1]) < 0.1 * DEG
    assert d.shape == (2,)


def test_a_run_on_its_own_model_has_tables_and_figures(controller):
    run = simulate(ARM, controller, hold(ARM, 0.3), load=lambda t: [0.0, 0.1 * (t > 0.1)])
    assert metrics(run).theta_worst.shape == (2,)
    assert "stiffness error" in repr(run)
    assert run.to_dict()["K12_ref"].shape == run.t.shape
    with pytest.raises(InvalidInput, match="10 finite numbers"):
        simulate(ARM, controller, hold(ARM, 0.3), x0=np.zeros(4))
