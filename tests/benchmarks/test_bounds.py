"""Least errors after a load: no controller is better, and the bound behaves as its limits demand."""

import numpy as np
import pytest

from allocator.units import DEG
from benchmarks.strangers.bounds import DT, LOAD, THETA, K, achieved, least, responses_of
from benchmarks.strangers.runs import rms
from mpc import Compensation, Plant
from mpc.trials.loops import Settings

pytestmark = pytest.mark.slow
SETTINGS = Settings(Plant(inertia=0.04, gravity_torque=0.0), DT, compensation=Compensation(dead_time=0.02)).calm


@pytest.fixture(scope="module")
def plant():
    return responses_of(SETTINGS)


@pytest.mark.parametrize("controller", ["mpc", "lqr", "predictive-pid", "pid"])
def test_no_linear_controller_is_better_than_the_least_with_its_robustness_and_noise(controller, plant):
    peak, noise, error, greatest = achieved(controller, SETTINGS)
    bound = least(plant, peak, noise)
    assert 0.1 * error < bound < 1.02 * error  # the model is nonlinear, and the filter ends after 1 s
    assert greatest > error


def test_without_feedback_the_load_acts_as_on_the_plant_alone(plant):
    assert least(plant, 2.0, 1e-6) == pytest.approx(rms(plant.loaded_angle / DEG), rel=0.02)


def test_more_noise_robustness_or_slew_cost_no_accuracy(plant):
    tight = least(plant, 1.5, 1.0, 4.0)
    assert least(plant, 1.5, 4.0, 4.0) < tight
    assert least(plant, 2.0, 1.0, 4.0) < tight
    assert least(plant, 1.5, 1.0, 40.0) < tight


def test_responses_are_those_of_the_model(plant):
    """Within its dead time a command turns nothing, and a load at rest turns the joint by T/K."""
    assert np.abs(plant.angle[:2]).max() == 0.0
    theta, _, *P = SETTINGS.plant.at_rest(THETA, K)
    assert plant.loaded_angle[-1] == pytest.approx(LOAD / SETTINGS.plant.joint.stiffness(theta, *P), rel=0.01)
