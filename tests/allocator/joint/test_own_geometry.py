"""Geometries of a user: arms that contradict the contraction, and dead points."""

from dataclasses import dataclass

import pytest

from allocator import AntagonistJoint, Geometry, InvalidInput, Lever, Pulley, allocate, named_muscle
from allocator.calculus import Value, cos, derivative, sin
from allocator.joint.geometry import Routing

MUSCLE = named_muscle("sarosi-dmsp-20-400n")
R = 0.03  # m


@dataclass(frozen=True)
class Eccentric(Geometry):
    """Eccentric disc, ε = 0.1 + R/l0 sin θ, with arm and slope by `derivative` of `derivative`."""

    def contraction(self, theta: Value) -> Value:
        return 0.1 + R / self.rest_length * sin(theta)

    def arm(self, theta: Value) -> Value:
        return self.rest_length * derivative(self.contraction, theta)

    def agonist(self, theta: Value) -> Routing:
        return Routing(self.contraction(theta), self.arm(theta), derivative(self.arm, theta))


@dataclass(frozen=True)
class Told(Eccentric):
    """The same with an arm and a slope that are `times` and `bent` times the right ones."""

    times: float = 1.0
    bent: float = 1.0

    def agonist(self, theta: Value) -> Routing:
        return Routing(self.contraction(theta), self.times * R * cos(theta), -self.bent * R * sin(theta))


def test_stiffness_of_arms_by_derivatives() -> None:
    joint, told = (AntagonistJoint(g, MUSCLE, MUSCLE, angle_limits=(-1.0, 1.0)) for g in (Eccentric(0.3), Told(0.3)))
    h, P = 1e-5, (3e5, 1e5)
    K = -(joint.torque(0.6 + h, *P) - joint.torque(0.6 - h, *P)) / (2 * h)
    assert joint.stiffness(0.6, *P) == pytest.approx(K, rel=1e-7)
    assert joint.stiffness(0.6, *P) == pytest.approx(told.stiffness(0.6, *P), rel=1e-9)
    assert allocate(0.6, K, joint.torque(0.6, *P), joint=joint).P == pytest.approx(P, rel=1e-5)


@pytest.mark.parametrize(
    ("geometry", "what"),
    [(Told(0.3, 10.0), "arm = "), (Told(0.3, 1.0, 0.0), "arm_slope = "), (Told(0.3, 1.0, 1e3), "arm_slope = ")],
)
def test_arms_that_contradict_the_contraction_are_refused(geometry: Geometry, what: str) -> None:
    with pytest.raises(InvalidInput, match=f"Told: the agonist has {what}"):
        AntagonistJoint(geometry, MUSCLE, MUSCLE, angle_limits=(-1.0, 1.0))


def test_a_dead_point_is_refused() -> None:
    with pytest.raises(InvalidInput, match=r"Eccentric: the agonist has the moment arm -.* dead point"):
        AntagonistJoint(Eccentric(0.3), MUSCLE, MUSCLE, angle_limits=(-2.0, 2.0))


@pytest.mark.parametrize("geometry", [Pulley(0.4, 0.02, 0.1), Lever(0.4, 0.38, 0.05, offset=-0.02)])
def test_those_of_the_library_pass(geometry: Geometry) -> None:
    AntagonistJoint(geometry, MUSCLE, MUSCLE)
