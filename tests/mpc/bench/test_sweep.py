"""The sweep: what it visits, what it writes, and that a person is waited for."""

import sys
from dataclasses import replace
from io import StringIO
from itertools import pairwise

import numpy as np
import pytest

from allocator import BAR, DEG
from allocator.errors import InvalidInput
from allocator.identification.joint.planning.plan import plan_joint_experiment
from allocator.identification.joint.reading import read_joint_log
from allocator.identification.motion.samples import read_motion_log
from allocator.joint.antagonist import report_joint
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc import Plant
from mpc.bench.cycle import Cycle, Phase, Settings
from mpc.bench.device import SimulatedClock
from mpc.bench.devices.simulated import SimulatedDevice
from mpc.bench.safety import Reason, SoftStart, Stopped
from mpc.bench.sweep import Asking, Pace, Sweep, Visit, random_steps, visits_of, within
from mpc.model.real import RealPlant

DT = 0.02
JOINT = report_joint(SAROSI_DMSP_20_400N)
PLANT = Plant(JOINT, gas=False)  # the pressures are at rest when a visit is read
VISITS = [
    Visit(0.0, (3 * BAR, 2 * BAR), (3.5 * BAR, 2 * BAR), -1),
    Visit(0.0, (3 * BAR, 2 * BAR), (2.5 * BAR, 2 * BAR), 1),
    Visit(1.0, (3 * BAR, 3 * BAR), (3.5 * BAR, 3 * BAR), -1),
]


def swept(directory, visits, steps, hang=None, device=None, pace=None):
    clock = SimulatedClock()
    device = SimulatedDevice(RealPlant(PLANT), clock) if device is None else device
    device.clock = clock
    source = Sweep(visits, steps, DT, device.hang if hang is None else hang, directory, pace)
    start = Settings(start=SoftStart(5 * BAR, settle=0.0))
    cycle = Cycle(device, source, PLANT, start, clock=clock)
    return cycle.run(), source, cycle


def test_equilibria_are_those_of_the_joint(tmp_path):
    ending, source, _ = swept(tmp_path, VISITS, [])
    assert ending.reason is Reason.FINISHED
    read = read_joint_log(tmp_path / "joint_log.csv")
    np.testing.assert_allclose(read.theta, JOINT.equilibrium(read.P1, read.P2, read.torque), atol=0.3 * DEG)
    np.testing.assert_array_equal(read.direction, [-1, 1, -1])
    np.testing.assert_array_equal(read.torque, [0, 0, 1])
    np.testing.assert_allclose(read.P1, 3 * BAR, rtol=1e-6)
    assert source.restless == 0


def test_the_log_of_random_steps_has_the_commands_that_were_sent(tmp_path):
    _, _, cycle = swept(tmp_path, [], random_steps(JOINT, 15, seed=1))
    log = read_motion_log(tmp_path / "motion_log.csv")
    sent = cycle.recorder.columns
    here = sent["phase"] == Phase.RUN
    np.testing.assert_allclose(log.P1[:-1], sent["P1_command"][here][:-1], rtol=1e-6)
    np.testing.assert_allclose(np.diff(log.t), DT, atol=1e-6)
    assert np.abs(np.diff(log.P1)).max() <= PLANT.slew * DT * (1 + 1e-6)


def test_random_steps_keep_to_the_middle_of_the_range():
    left, right = within(JOINT).angle_range
    theta = JOINT.equilibrium(*np.array(random_steps(JOINT, 80, seed=2)).T)
    assert JOINT.angle_range[0] < left <= theta.min() < left / 2
    assert right / 2 < theta.max() <= right < JOINT.angle_range[1]


def test_visits_follow_the_plan_from_both_sides():
    plan = plan_joint_experiment(within(JOINT))
    visits = visits_of(plan, JOINT)
    assert len(visits) == 2 * len(plan.setpoints)
    for v in visits:
        before, there = JOINT.equilibrium(*v.come_from, v.torque), JOINT.equilibrium(*v.P, v.torque)
        assert np.sign(there - before) == v.direction
        assert all(0 <= P <= 5 * BAR for P in v.come_from)
    assert {v.torque for v in visits_of(plan, JOINT, weights=False)} <= {0.0}


@pytest.mark.parametrize("friction", [0.05, 0.1])
def test_a_joint_with_friction_slides_into_its_setpoints_from_both_sides(friction):
    joint = replace(JOINT, friction=friction, angle_limits=None)
    plan = plan_joint_experiment(joint)
    assert f"come from a P1 {plan.approach / BAR:.1f} bar higher" in str(plan)
    errors = []
    for s, v in zip(np.repeat(np.arange(len(plan.setpoints)), 2), visits_of(plan, joint), strict=True):
        other = tuple(2 * there - away for there, away in zip(v.P, v.come_from, strict=True))  # the other side
        steps = np.array([(0.0, 0.0), v.P, other, v.come_from, v.P])
        path = np.concatenate([np.linspace(a, b, 40) for a, b in pairwise(steps)])
        theta = joint.equilibrium(*path[-1], v.torque, history=tuple(path[:-1].T))
        expected = plan.setpoints[s].falling if v.direction < 0 else plan.setpoints[s].rising
        errors.append(float(theta) - expected)
    assert np.sqrt(np.mean(np.square(errors))) < 1 * DEG


def test_an_angle_that_never_rests_is_left_out(tmp_path):
    device = SimulatedDevice(RealPlant(PLANT), SimulatedClock())
    read = device.read
    device.read = lambda: (r := read())._replace(theta=r.theta + 1 * DEG * np.sin(20 * r.t))
    _, source, _ = swept(tmp_path, VISITS[:1], [], device=device, pace=Pace(longest=4.0))
    assert source.restless == 1
    assert not (tmp_path / "joint_log.csv").exists()


def test_a_person_is_waited_for_with_the_pressures_held(tmp_path):
    answers = iter([False] * 100)
    ending, _, cycle = swept(tmp_path, VISITS[2:], [], hang=lambda torque: next(answers, True))
    assert ending.reason is Reason.FINISHED
    columns = cycle.recorder.columns
    waiting = (columns["torque"] == 0) & (columns["phase"] == Phase.RUN)
    assert waiting.sum() == 100
    assert np.ptp(columns["P1_command"][waiting]) == 0
    assert (tmp_path / "joint_log.csv").exists()


def test_enter_is_read_without_stopping_the_loop(monkeypatch):
    asked = []
    monkeypatch.setattr(sys, "stdin", StringIO("\n\n"))
    ask = Asking(asked.append)
    for torque in (1.5, -1.5):
        while not ask(torque):
            pass
    assert asked == [1.5, -1.5]


def test_an_input_that_ends_stops_the_sweep(monkeypatch):
    monkeypatch.setattr(sys, "stdin", StringIO(""))
    ask = Asking(lambda torque: None)

    def waited_for():
        while not ask(1.0):
            pass

    with pytest.raises(Stopped, match="standard input is at its end"):
        waited_for()


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Pace(hold=0.5), "hold = 0.5 s"),
        (lambda: Pace(rate=0.0), "rate = 0.0"),
        (lambda: Pace(motion=-1.0), "motion"),
        (lambda: Sweep([], [], DT, bool, None), "nothing to sweep"),
    ],
)
def test_a_sweep_that_makes_no_sense_is_refused(make, said):
    with pytest.raises(InvalidInput, match=said):
        make()
