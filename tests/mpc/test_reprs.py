"""Values at a Python prompt: each shows what it is in a line."""

import pytest

from allocator.mechanism import Mechanism
from allocator.mechanism.machines import arm26
from allocator.units import BAR
from mpc import KalmanObserver, NonlinearMPC, Plant, RealPlant, Reference, sine
from mpc.arm import MujocoPlant, RealArm
from mpc.model.arm.model import Arm
from mpc.trials import FeedForwardControl

MODEL = "inertia 0.05 kg·m², damping 0.1 N·m·s/rad"


@pytest.mark.parametrize(
    ("made", "shown"),
    [
        (arm26, "Mechanism: 2 joints, 6 muscles Sarosi2012 on Pulleys, 0 … 5 bar"),
        (lambda: Mechanism.from_joint(Plant().joint), "Mechanism: 1 joint, 2 muscles Tondu2021 on Pulleys, 0 … 5 bar"),
        (
            lambda: sine(duration=5.0, ramp=1.0),
            "Reference: 251 samples, angle -40 … 40°, stiffness 7.3 … 7.9 N·m/rad, 5 s",
        ),
        (
            lambda: Reference((0, 1), ((0, 0),) * 2, (((9, -1), (-1, 4)),) * 2),
            "Reference: 2 samples, angle 0 … 0°, entries of K -1 … 9, 1 s",
        ),
        (lambda: RealPlant(Plant()), "RealPlant: without effects; nominal Plant: AntagonistJoint"),
        (lambda: RealPlant(Plant(), dead_band=0.1 * BAR), "RealPlant: differs in dead_band; nominal Plant"),
        (lambda: RealArm(Arm.machine("arm26"), mass=1.2), "RealArm: differs in mass; nominal Arm: 2 joints, 6 muscles"),
        (lambda: NonlinearMPC(Plant()), f"NonlinearMPC: samples of 10 ms; model: {MODEL}"),
        (
            lambda: KalmanObserver(Plant(), 0.02, compiled=False),
            f"KalmanObserver: samples of 20 ms, readable; model: {MODEL}",
        ),
        (lambda: MujocoPlant.of(Arm.machine("arm26")), "MujocoPlant: 2 joints, 6 muscles, steps of "),
        (lambda: FeedForwardControl(Plant(), 0.02), f"FeedForwardControl: samples of 20 ms; model: {MODEL}"),
    ],
)
def test_a_value_says_in_a_line_what_it_is(made, shown):
    text = repr(made())
    assert text.startswith(shown)
    assert "\n" not in text
    assert len(text) < 400
