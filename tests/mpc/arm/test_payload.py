"""A payload adds inertia and weight where it is, and keeps momentum where it arrives."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mpc.arm.experiments import arriving, carry, mass_matrix
from mpc.arm.mujoco_plant import MujocoPlant
from mpc.model.arm.model import Arm

ARM = Arm.machine("arm26")
TIP = (ARM.bodies.length[-1], 0.0, 0.0)


@pytest.mark.parametrize("at", [TIP, (0.2, 0.05, 0.0), (0.1, 0.02, 0.04)])
def test_a_carried_mass_adds_what_a_point_adds_to_the_mass_matrix(at):
    plant, q = MujocoPlant.of(ARM), np.array([0.3, -0.5])
    plant.reset(q, 2e5)
    before, J = mass_matrix(plant), np.zeros((3, 2))
    last = plant.model.nbody - 1
    point = plant.data.xpos[last] + plant.data.xmat[last].reshape(3, 3) @ at
    mujoco.mj_jac(plant.model, plant.data, J, None, point, last)
    carry(plant, 0.7, at)
    plant.reset(q, 2e5)
    assert mass_matrix(plant) == pytest.approx(before + 0.7 * J.T @ J, rel=1e-9)


def test_it_weighs_as_the_bodies_say():
    """Against the formulas of the same chain with the payload in its last link."""
    vertical = replace(ARM, bodies=replace(ARM.bodies, gravity=(0.0, -9.81)))
    plant, q = MujocoPlant.of(vertical), np.array([0.3, -0.5])
    carry(plant, 0.7, TIP)
    plant.reset(q, 2e5)
    b = vertical.bodies
    mass, length, centre = b.mass[1], b.length[1], b.centre[1]
    heavy = replace(
        b, mass=(b.mass[0], mass + 0.7), centre=(b.centre[0], (mass * centre + 0.7 * length) / (mass + 0.7))
    )
    assert plant.data.qfrc_bias == pytest.approx(np.ravel(heavy.gravity_torque(q)), rel=1e-9)


def test_a_mass_that_arrives_at_rest_keeps_the_momentum_and_takes_energy():
    plant, q, omega = MujocoPlant.of(ARM), np.array([0.3, -0.5]), np.array([1.0, -2.0])
    plant.reset(q, 2e5, omega=omega)
    before, momentum = plant.energy, mass_matrix(plant) @ omega
    watch = arriving(plant, 0.0, 0.7, TIP, np.zeros(3))
    watch()
    caught = plant.data.qvel.copy()
    watch()  # once
    assert plant.data.qvel == pytest.approx(caught)
    plant.reset(q, 2e5, omega=caught)
    assert mass_matrix(plant) @ caught == pytest.approx(momentum, rel=1e-9)
    assert plant.energy[1] < before[1]
