"""Force laws of a user: derivatives of derivatives, laws without a number, forces that fall with the pressure."""

import re
from dataclasses import dataclass

import numpy as np
import pytest

from allocator import AntagonistJoint, InvalidInput, Limits, Pulley, Status, Stiffness, allocate, stiffness_interval
from allocator.calculus import Value, derivative, exp, log, sin, sqrt
from allocator.mechanism import Mechanism, Pulleys
from allocator.muscles import Cabled, FunctionMuscle, Muscle, TableMuscle, TonduLopez1995, monotonicity_failure
from allocator.units import BAR, DEG

P_C, P_T, AREA, WALL = 0.25 * BAR, 0.5 * BAR, 3.2e-3, 700.0


@dataclass(frozen=True)
class Softplus(Muscle):
    """Soft threshold, F = A (1 - ε/0.32) P_c ln(1 + e^((P - P_t)/P_c)) - 700 N ε, with the gain by `derivative`."""

    citation = "own"
    P_c: float = P_C  # [Pa]

    def law(self, P: Value, eps: Value) -> Value:
        return AREA * (1 - eps / 0.32) * self.P_c * log(1 + exp((P - P_T) / self.P_c)) - WALL * eps

    def gain(self, P: Value, eps: Value) -> Value:
        return derivative(lambda p: self.law(p, eps), P)


@dataclass(frozen=True)
class Hump(Muscle):
    """A muscle that pulls less above 3.3 bar."""

    citation = "own"

    def law(self, P: Value, eps: Value) -> Value:
        return 4e-3 * (1 - eps / 0.3) * (P - 1.5e-6 * P * P) - 200 * eps

    def gain(self, P: Value, eps: Value) -> Value:
        return 4e-3 * (1 - eps / 0.3) * (1 - 3e-6 * P)


ENDING = FunctionMuscle(lambda eps: 5e-3 * sqrt(0.2 - eps))  # no number beyond 20 %


def joint_of(muscle: Muscle, contraction: float = 0.1) -> AntagonistJoint:
    return AntagonistJoint(Pulley(0.3, 0.02, contraction), muscle, muscle)


def test_a_derivative_of_a_derivative_is_no_zero() -> None:
    x, y = 0.7, 0.3
    mixed = derivative(lambda a: derivative(lambda b: sin(a * b), y), x)
    assert mixed == pytest.approx(np.cos(x * y) - x * y * np.sin(x * y), rel=1e-9)
    assert derivative(lambda a: derivative(sin, a), x) == pytest.approx(-np.sin(x), rel=1e-9)


def test_a_gain_by_derivative_has_a_slope() -> None:
    muscle, P, eps = Softplus(), np.array([0.1, 1.0, 3.0]) * BAR, np.array([0.02, 0.1, 0.2])
    rising = 1 / (1 + np.exp(-(P - P_T) / P_C))
    np.testing.assert_allclose(muscle.gain(P, eps), AREA * (1 - eps / 0.32) * rising, rtol=1e-12)
    np.testing.assert_allclose(muscle.gain_slope(P, eps), -AREA / 0.32 * rising, rtol=1e-7)
    assert monotonicity_failure(muscle, 5 * BAR, (0.0, 0.3)) == ""


def test_a_joint_of_it_has_a_jacobian() -> None:
    joint, h = joint_of(Softplus()), 1e-4
    found = allocate(0.2, 5.0, 1.0, joint=joint).jacobian()
    assert found[:, 1] == pytest.approx(
        (allocate(0.2, 5.0 + h, 1.0, joint=joint).P - allocate(0.2, 5.0 - h, 1.0, joint=joint).P) / (2 * h), rel=1e-5
    )


def test_its_gas_is_followed_by_several_polynomials() -> None:
    joint = joint_of(Softplus(0.1 * BAR, rest_volume=8e-5))
    P = 2 * BAR, 1.5 * BAR
    asked = joint.stiffness(0.2, *P, valves="shut"), joint.torque(0.2, *P)
    a = allocate(0.2, *map(float, asked), joint=joint, stiffness=Stiffness("shut"))
    assert a.status == Status.EXACT
    np.testing.assert_allclose(a.P, P, rtol=1e-6)


@pytest.mark.filterwarnings("ignore:invalid value encountered in sqrt:RuntimeWarning")
@pytest.mark.parametrize("theta", [0.9, np.array([0.0, 0.9]), np.linspace(0.0, 1.0, 300)])
@pytest.mark.parametrize("limits", [Limits(), Limits(min_force=None)])
def test_no_answer_where_the_law_gives_no_number(theta: Value, limits: Limits) -> None:
    joint = joint_of(ENDING, 0.15)
    assert allocate(0.5, 4.0, joint=joint).success
    with pytest.raises(InvalidInput, match=r"force law of agonist \(FunctionMuscle\) gives no number .* 0\.2"):
        allocate(theta, 4.0, joint=joint, limits=limits)


@pytest.mark.filterwarnings("ignore:invalid value encountered in sqrt:RuntimeWarning")
def test_monotonicity_names_the_contractions_without_a_number() -> None:
    failure = monotonicity_failure(ENDING, 5 * BAR, (0.0, 0.3))
    assert re.fullmatch(r"the law gives no number at contractions within ε = 0\.20\d–0\.300", failure)


@pytest.mark.filterwarnings("ignore:invalid value encountered in sqrt:RuntimeWarning")
def test_nor_of_a_mechanism() -> None:
    arm = Mechanism(Pulleys(0.3, [(0.02,), (-0.02,)], 0.15), (ENDING,) * 2)
    with pytest.raises(InvalidInput, match="force law of muscle 1"):
        allocate([0.9], [4.0], joint=arm)


@pytest.mark.parametrize("limits", [Limits(), Limits(min_force=None, max_force=100.0)])
def test_a_force_that_falls_again_is_refused(limits: Limits) -> None:
    with pytest.raises(InvalidInput, match=r"force of agonist \(Hump\) falls between 0 and 5 bar"):
        allocate(0.0, 4.0, joint=joint_of(Hump()), limits=limits)


SPRING = FunctionMuscle(lambda eps: 3e-3 * (1 - eps / 0.25), lambda eps: 60 - 200 * eps)
RUBBER = FunctionMuscle(lambda eps: 3e-3 * (1 - eps / 0.25), lambda eps: -300 * eps)


@pytest.mark.parametrize("muscle", [SPRING, RUBBER, TonduLopez1995(0.01, 25 * DEG)])
@pytest.mark.parametrize("T", [-2.0, 0.0, 2.0])
def test_a_muscle_beyond_its_greatest_contraction_is_not_filled(muscle: Muscle, T: float) -> None:
    # there A(ε) < 0: more pressure would push
    joint = joint_of(muscle, muscle.max_contraction - 0.03 if isinstance(muscle, TonduLopez1995) else 0.17)
    a = allocate(1.5, 3.0, T, joint=joint)
    assert a.P1 == 0.0
    assert "agonist model validity" in a.active
    assert (a.status == Status.SLACK) == (a.forces[0] < 0)
    assert not a.success
    batch = allocate(np.array([1.5]), 3.0, T, joint=joint)
    np.testing.assert_array_equal(batch.P[0], a.P)
    assert np.isnan(stiffness_interval(1.5, 10.0, joint=joint)).all()


def test_answers_beyond_the_knots_of_a_table_are_reported() -> None:
    knots = np.linspace(0.0, 0.2, 5)
    table = TableMuscle(tuple(knots), tuple(3e-3 * (1 - knots / 0.3)), tuple(-50 * knots))
    for muscle in (table, Cabled(table, cable_stiffness=1e6, rest_length=0.3)):
        joint = joint_of(muscle)
        assert allocate(1.0, 3.0, joint=joint).assumed == ""
        joint = joint_of(muscle, 0.15)
        assert allocate(0.9, 3.0, joint=joint).assumed == (
            "the force is extrapolated beyond what was measured: agonist (measured at contractions of 0 to 0.2)"
        )
        assert "in 1 of 2 points" in allocate(np.array([0.0, 0.9]), 3.0, joint=joint).message
