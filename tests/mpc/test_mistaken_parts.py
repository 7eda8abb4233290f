"""Parts that a newcomer gives to the wrong constructor: one sentence each."""

from functools import cache

import numpy as np
import pytest

from allocator.errors import InvalidInput
from allocator.mechanism.machines import arm26
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc import Arm, KalmanObserver, Plant, RealPlant, Reference, TrackingMPC, sine
from mpc.bench import CallableDevice, RealTimeLoop, SimulatedDevice
from mpc.bench.safety import SoftStart


@pytest.mark.parametrize(
    ("made", "sentence"),
    [
        (lambda: Plant("joint.toml"), r"joint = 'joint.toml' has to be an AntagonistJoint; Plant.load reads a file"),
        (lambda: Plant(SAROSI_DMSP_20_400N), "has to be an AntagonistJoint"),
        (lambda: Plant(arm26()), "an Arm has several joints"),
        (lambda: RealPlant(Plant().joint), "nominal = .* has to be a Plant"),
        (lambda: KalmanObserver(RealPlant(), 0.01), "has to be a Plant or an Arm; the model of a RealPlant is its nom"),
        (lambda: KalmanObserver(Plant().joint, 0.01), "has to be a Plant or an Arm"),
        (lambda: sine(Plant()), r"amplitude = .* \[rad\]"),
        (lambda: sine(K=None), r"K = None .*\[N·m/rad\]"),
        (lambda: sine(duration="12"), r"duration = '12' .*\[s\]"),
        (lambda: sine(40.0), "if degrees were meant"),
    ],
)
def test_a_mistaken_part_is_named(made, sentence):
    with pytest.raises(InvalidInput, match=sentence) as refused:
        made()
    assert "\n" not in str(refused.value)


@cache
def parts_of_an_arm():
    arm, t = Arm.machine("arm26"), np.linspace(0, 1, 50)
    K = np.full((50, 1, 1), 9.0) * np.eye(2)
    return arm, TrackingMPC(arm, N=3, compiled=False), Reference(t, np.zeros((50, 2)), K), K


@pytest.mark.parametrize(
    ("mistaken", "sentence"),
    [
        ({"device": "sim"}, "device = 'sim' has to be a device, such as a SimulatedDevice"),
        ({"device": None}, "device = None has to be a device"),
        ({"controller": None}, "plant = None: NoneType has none"),
        ({"observer": None}, "observer = None has to be an observer"),
        ({"observer": 0.02}, "dt = 0.02 s of the observer is not the dt = 0.01 s of the controller"),
        ({"reference": "circle"}, "reference = 'circle' has to be a Reference"),
        ({"reference": sine()}, r"theta has the shape \(\d+,\); this plant takes \(M, 2\)"),
        ({"K": np.linspace(1, -1, 50)}, "K of the reference is not positive definite"),
        ({"start": 1.0}, "start = 1.0 has to be a SoftStart"),
        ({"start": SoftStart(settle=1e9)}, "samples of settling = 100000000000 is over 1000000"),
        ({"stop": "vent"}, "stop = 'vent' has to be a SafeStop"),
        ({"watchdog": 0.2}, "watchdog = 0.2 has to be a Watchdog"),
        ({"overrun": "skip"}, "overrun = 'skip' has to be an Overrun"),
    ],
)
def test_a_mistaken_part_of_a_loop_is_refused_before_it_runs(mistaken, sentence):
    arm, controller, reference, K = parts_of_an_arm()
    if "K" in mistaken:
        factor = mistaken["K"][:, None, None]
        mistaken = {"reference": Reference(reference.t, reference.theta, factor * K)}
    dt = mistaken.get("observer", controller.dt)
    observer = None if dt is None else KalmanObserver(arm, dt, compiled=False)
    parts = {"device": SimulatedDevice(arm), "controller": controller, "reference": reference, **mistaken}
    with pytest.raises(InvalidInput, match=sentence):
        RealTimeLoop(**parts | {"observer": observer})


@pytest.mark.parametrize(
    ("made", "sentence"),
    [
        (lambda: CallableDevice(0.1, print), "read = 0.1 has to be a function"),
        (lambda: CallableDevice(lambda: 0.1, None), "write = None has to be a function"),
        (lambda: SimulatedDevice(seed=-1), "seed = -1 has to be a whole number"),
        (lambda: SimulatedDevice().write(1e5), "write: 1 pressures for the 2 of the simulated device"),
        (lambda: SimulatedDevice().hang([1.0, 2.0]), "torque = .* has to be one number or a row of 1"),
    ],
)
def test_a_mistaken_part_of_a_device_is_named(made, sentence):
    with pytest.raises(InvalidInput, match=sentence):
        made()
