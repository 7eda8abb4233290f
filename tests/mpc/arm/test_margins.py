"""Margins of an arm's loop, against a joint's, a disturbance that is injected, and a delay that breaks it."""

import numpy as np
import pytest

from mpc.model.arm.model import Arm
from mpc.model.compensation import Compensation
from mpc.model.plant import Plant
from mpc.observer.filter import CALM_NOISE
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.cost import CALM
from mpc.trials.margins import Margins, margins, usual_postures

from ...rigs.one_joint import arm_of

DT, TOLD = 0.01, Compensation(dead_time=0.02)
ARM = Arm.machine("arm26")


def loop(plant, compiled=True, blocks=None):
    controller = TrackingMPC(plant, DT, weights=CALM, compensation=TOLD, blocks=blocks, compiled=compiled)
    return controller, KalmanObserver(plant, DT, CALM_NOISE, TOLD, compiled=compiled)


def test_a_known_transfer_matrix_has_its_singular_values_and_margins():
    """S = Q diag(s1, s2) Qᵀ of two loops of one state each, z = pole, whose margins are known from each alone."""
    k, samples = np.arange(900), []
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    for gain in (0.05, 0.4):  # L = gain/(z - 1), S = (z - 1)/(z - 1 + gain)
        samples.append(np.where(k == 0, 1.0, -gain * (1 - gain) ** (k - 1.0)))
    response = np.einsum("ij,kj,lj->kil", turn, np.transpose(samples), turn)
    both = Margins.of(np.zeros(2), np.eye(2), response, DT)
    alone = [Margins.of(0.0, 1.0, one, DT) for one in samples]
    assert both.sensitivity_peak == pytest.approx(max(m.sensitivity_peak for m in alone), rel=1e-6)
    assert both.sensitivity_peak == pytest.approx(2 / (2 - 0.4), rel=1e-3)  # at the Nyquist frequency
    assert both.gain_margin == pytest.approx(2 / 0.4, rel=1e-3)
    assert both.delay_margin == pytest.approx(min(m.delay_margin for m in alone), rel=1e-3)


@pytest.mark.slow
def test_an_arm_of_one_joint_has_the_margins_of_the_joint():
    joint = Plant(gas=False, lag=0.12)
    (of_joint,) = margins(*loop(joint, False), [(0.2, 7.0)], listen=2.0)
    arm = arm_of(joint)
    (of_arm,) = margins(*loop(arm, False, 20 * (1,)), [(np.array([0.2]), np.array([[7.0]]))], listen=2.0)
    assert of_arm.sensitivity_peak == pytest.approx(of_joint.sensitivity_peak, rel=0.02)
    assert of_arm.delay_margin == pytest.approx(of_joint.delay_margin, rel=0.05)


@pytest.mark.compiles
@pytest.mark.slow
def test_no_direction_of_an_injected_sine_is_amplified_more_and_one_is_as_much():
    controller, observer = loop(ARM)
    q, K = usual_postures(ARM)[1]
    (found,) = margins(controller, observer, [(q, K)])
    assert found.stable
    at = int(np.argmax(found.magnitude))
    _, _, directions = np.linalg.svd(found.S[at])
    for direction, expected in ((directions[0].conj(), found.sensitivity_peak), (np.array([1.0, 0.0]), None)):
        met = injected(controller, observer, q, K, found.peak_frequency, direction)
        assert met <= 1.05 * found.sensitivity_peak
        assert expected is None or met == pytest.approx(expected, rel=0.05)


def injected(controller, observer, q, K, frequency, direction, seconds=10.0, delta=1e-5):
    """|S v| of readings disturbed by a sine along `direction`, over |v|."""
    controller.rest = False
    controller.reset()
    observer.reset()
    x0 = ARM.at_rest(q, K)
    trial, u, waiting = ARM.begin(DT, x0, 0), x0[4:], [x0[4:]] * 2
    t, read = DT * np.arange(round(seconds / DT)), []
    for now in t:
        y = trial.measure()
        y[:2] += delta * (direction * np.exp(2j * np.pi * frequency * now)).real
        read.append(y[:2].copy())
        x, d = observer.estimate(y, u)
        u = controller.step(x, q, K, d).u[0]
        waiting.append(u)
        trial.advance(waiting.pop(0))
    late = t >= seconds / 2
    wave = np.exp(-2j * np.pi * frequency * t[late])
    whole = int(np.floor(frequency * seconds / 2) / frequency / DT)
    found = 2 * np.mean(((np.array(read) - q)[late] * wave[:, None])[:whole], axis=0)
    return np.linalg.norm(found) / delta
