"""A loop whose readings are older than told rings, which health names within a second; nothing else is called so."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import DEG
from mpc import KalmanObserver, RealPlant, Reference, TrackingMPC, simulate
from mpc.model.friction.dahl import Friction
from mpc.observer import ringing
from mpc.observer.health import FaultKind, Part, Reaction, Suspect
from mpc.tracking.cost import Weights
from mpc.trials.motions.trajectories import jumps, point_to_point, rested_sine, steps
from mpc.trials.robust import robust_weights

DT = 0.01
REAL = RealPlant.standard()
RINGING = Suspect(FaultKind.RINGING, Part.LOOP)
STILL = Reference(np.arange(0, 3, DT), np.full(300, 15 * DEG), np.full(300, 5.5))


class Listener(KalmanObserver):
    """An observer that keeps its health after every estimate."""

    def reset(self):
        super().reset()
        self.said = []

    def estimate(self, y, u):
        answer = super().estimate(y, u)
        self.said.append(self.health)
        return answer


def said(real, told, reference=STILL, weights=None):
    """Health sample by sample in a run, and the run."""
    controller = TrackingMPC(real.nominal, DT, weights=weights or Weights.calm(), compensation=told, compiled=False)
    listener = Listener(real.nominal, DT, compensation=told, compiled=False)
    run = simulate(real, controller, reference, observer=listener)
    return listener.said, run


@pytest.mark.parametrize(  # gas damps the joint
    ("age", "gas", "swing"), [(0.02, False, 3.5), (0.03, True, 2.0), (0.04, True, 3.5), (0.05, True, 3.5)]
)
def test_older_readings_than_told_are_named_within_a_second(age, gas, swing):
    healths, run = said(replace(REAL, reading_age=age, nominal=replace(REAL.nominal, gas=gas)), REAL.known())
    off = np.abs(run.theta - run.theta_ref)
    first = next(k for k, health in enumerate(healths) if health.suspects == (RINGING,))
    begun = int(np.argmax(off > 0.5 * DEG))
    assert (first - begun) * DT < 1.0
    assert np.ptp(off[-100:]) > swing * DEG  # it rings indeed
    health = healths[-1]
    assert health.reaction is Reaction.HOLD
    assert all(word in str(health) for word in ("ringing (loop)", " Hz: ", "30 ms", "reading age of 0 ms"))


def test_older_commands_than_told_are_named_as_well():
    healths, _ = said(replace(REAL, dead_time=0.07), REAL.known())
    assert RINGING in healths[-1].suspects


@pytest.mark.parametrize(
    "reference", [STILL, rested_sine(), point_to_point(), steps()], ids=["rest", "sine", "min-jerk", "steps"]
)
def test_nothing_rings_where_nothing_is_older_than_told(reference):
    told = replace(REAL.known(), reading_age=0.03)
    healths, _ = said(replace(REAL, reading_age=0.03, torque_profile=((4.0, 1.0),)), told, reference)
    assert all(health.well for health in healths)


@pytest.mark.slow
def test_a_load_and_then_a_jump_on_a_joint_without_its_told_friction_is_no_ringing():
    real = replace(REAL, friction=Friction(), torque_profile=((5.0, 1.0),))
    healths, _ = said(real, REAL.known(), jumps(5.5), robust_weights(REAL.nominal, DT, compensation=REAL.known()))
    assert all(health.well for health in healths)


def swings(frequency, growth, share=0.3, amplitude=5 * DEG, samples=300):
    """Whether the diagnosis calls a swing of this amplitude ringing, sample by sample."""
    diagnosis, inertia, found = ringing.RingingDiagnosis(0.05), 0.05, []
    for k in range(samples):
        phase, size = 2 * np.pi * frequency * k * DT, amplitude * np.exp(growth * k * DT)
        omega = 2 * np.pi * frequency * size * np.sin(phase)
        d = share * inertia * 2 * np.pi * frequency * omega
        ringing.follow(diagnosis.numbers, inertia, k * DT, float(omega), float(d))
        found.append(diagnosis.since is not None)
    return np.array(found), diagnosis


@pytest.mark.parametrize("frequency", [2.0, 3.8, 8.0])
def test_a_swing_that_stands_is_found_after_two_periods_with_its_frequency(frequency):
    found, diagnosis = swings(frequency, 0.0)
    assert int(found.argmax()) * DT < 2.2 / frequency
    assert diagnosis.frequency == pytest.approx(frequency, rel=0.05)


@pytest.mark.parametrize(
    "other",
    [
        {"frequency": 3.0, "growth": -4.0, "amplitude": 20 * DEG},  # decays
        {"frequency": 3.0, "growth": 0.0, "amplitude": 1.5 * DEG},  # small
        {"frequency": 1.0, "growth": 0.0},  # as slow as a reference may be
        {"frequency": 3.0, "growth": 0.0, "share": 0.03},  # the model explains it
    ],
    ids=["decays", "small", "slow", "explained"],
)
def test_other_swings_are_none(other):
    assert not swings(**other)[0].any()


def test_a_loop_that_has_stopped_ringing_is_well_again():
    numbers = swings(3.0, 0.0)[1].numbers
    for k in range(300, 300 + round((ringing.HOLD + 1) / DT)):
        ringing.follow(numbers, 0.05, k * DT, 0.0, 0.0)
    assert numbers[ringing.SINCE] != numbers[ringing.SINCE]
