"""Arm of one joint: a plant as an arm with n = 1 and m = 2."""

from allocator.mechanism import Mechanism
from allocator.mechanism.bodies import EARTH, Bodies
from mpc.model.arm.model import Arm
from mpc.model.plant import Plant

_CENTRE = 0.15  # [m] of the link's mass from the hinge, at most


def arm_of(plant: Plant) -> Arm:
    """Return the arm of one link with the plant's equation of motion, without friction and hysteresis.

    A plant knows the link's inertia J about the hinge and its gravity torque m g a; many links share these two numbers.
    This one has its centre of mass in its middle, at most 15 cm from the hinge, and the mass

        m = |m g a|/(g a),    I = J - m a² ≥ J/2
    """
    J, G = plant.inertia, abs(plant.gravity_torque)
    a = min(_CENTRE, EARTH * J / (2 * G)) if G else _CENTRE
    m = G / (EARTH * a) if G else J / (2 * a**2)
    gravity = (EARTH if plant.gravity_torque > 0 else -EARTH, 0.0) if G else (0.0, 0.0)  # at θ = 0 the link hangs
    link = Bodies((2 * a,), (m,), (a,), (J - m * a**2,), (plant.damping,), gravity)
    return Arm(Mechanism.from_joint(plant.joint), link, plant.lags, plant.slew, gas=plant.gas)
