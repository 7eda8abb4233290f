"""An afternoon without hardware: sweep, fit, track, on a joint whose parameters only the device knows."""

from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from allocator import DEG, Pulley
from allocator.identification import fit_joint
from allocator.identification.joint.planning.plan import plan_joint_experiment
from allocator.identification.joint.reading import read_joint_log
from allocator.identification.motion.fit import fit_motion
from allocator.identification.motion.samples import read_motion_log
from mpc import Compensation, IdentifiedPlant, KalmanObserver, Plant, TrackingMPC, Weights
from mpc.bench.cycle import Cycle, Settings
from mpc.bench.device import SimulatedClock
from mpc.bench.devices.modbus import ModbusDevice, RegisterMap
from mpc.bench.devices.simulated import SimulatedDevice, simulated
from mpc.bench.loop import RealTimeLoop, Tracking, replay
from mpc.bench.safety import SoftStart
from mpc.bench.sweep import Sweep, random_steps, visits_of, within
from mpc.trials.files import load_recording
from mpc.trials.metrics import metrics
from mpc.trials.motions.trajectories import point_to_point, shrunk, usual_stiffness

from ...rigs.afternoon import GEOMETRY, HIDDEN, ROUGH, antagonist
from .valve_terminal import HOST, ValveTerminal

DT, SWEPT = 0.01, 0.02  # [s] half as many samples of a sweep are fitted in half of the time


@pytest.mark.slow
def test_from_sweep_to_a_tracked_trajectory_on_the_command_line(tmp_path):
    hidden, log = tmp_path / "hidden.toml", tmp_path / "run"
    HIDDEN.save(hidden)
    where = "--device", f"sim:{hidden}", "--fast", "--quiet"
    antagonist("sweep", *where, "--muscle", "sarosi-dmsp-20-400n", "--out", tmp_path, "--motion", 30)
    joint, plant = tmp_path / "joint.toml", tmp_path / "plant.toml"
    antagonist("fit-joint", tmp_path / "joint_log.csv", *GEOMETRY, "--out", joint)
    antagonist("fit-motion", tmp_path / "motion_log.csv", "--machine", joint, "--out", plant)
    found = Plant.load(plant)
    assert found.lag == pytest.approx(HIDDEN.lag, rel=0.3)
    antagonist("run", "min-jerk", *where, "--machine", plant, "--out", f"{log}.csv", "--out", f"{log}.npz")
    figures = metrics(load_recording(f"{log}.npz"))
    assert figures.after_rest.theta_rms < 1.0  # [°]
    assert figures.limits_kept, figures.violations


@contextmanager
def over_modbus(clock):
    """Registers round: the angle to 0.01°, the pressures to 1 mbar."""
    joint = SimulatedDevice(simulated(HIDDEN, Compensation()), clock)
    with ValveTerminal(joint) as terminal:
        patient = replace(RegisterMap.generic(), timeout=9.0)
        yield ModbusDevice.tcp(HOST, terminal.port, patient, clock), joint.hang


@pytest.mark.slow
def test_the_same_over_modbus_and_the_log_replays(tmp_path):
    clock = SimulatedClock()
    with over_modbus(clock) as (device, hang):
        fitted = identified(device, hang, clock, tmp_path)
        plant, known = Plant.load(fitted), Compensation.load(fitted)
        reference = shrunk(point_to_point, usual_stiffness(plant.joint), plant.joint)
        parts = [
            (
                TrackingMPC(plant, DT, 20, Weights.calm(), compensation=known),
                KalmanObserver(plant, DT, compensation=known),
            )
            for _ in range(2)
        ]
        limp = SoftStart(
            angle_margin=20 * DEG
        )  # without pressure the joint lies at its stop, which the fit cannot know
        record = RealTimeLoop(device, *parts[0], reference, start=limp, clock=clock).run()
    assert str(record.ending) == "finished"
    assert record.theta_rms < 1 * DEG
    assert metrics(record.run()).limits_kept
    again = replay(record.columns, Tracking(plant, *parts[1], reference, 1.0))
    np.testing.assert_allclose(again[:-1], record.run().u, rtol=1e-9)


def identified(device, hang, clock, directory):
    """Sweep and fit; the file of the plant that was found."""
    plan = plan_joint_experiment(within(ROUGH.joint), setpoints=10)
    sweep = Sweep(visits_of(plan, ROUGH.joint), random_steps(ROUGH.joint, 30), SWEPT, hang, directory)
    assert str(Cycle(device, sweep, ROUGH, Settings(), clock=clock).run()) == "finished"
    rest, motion = read_joint_log(directory / "joint_log.csv"), read_motion_log(directory / "motion_log.csv")
    loads = {"torque": rest.torque, "direction": rest.direction, "geometry": Pulley(0.40, 0.02, 0.1375)}
    loads["choices"] = False
    joint = fit_joint(rest.theta, rest.P1, rest.P2, **loads).joint
    found = fit_motion(motion.t, motion.theta, motion.P1, motion.P2, joint=joint)
    IdentifiedPlant.of(found).save(directory / "plant.toml")
    return directory / "plant.toml"
