"""Wrong input gets one clear sentence that names the argument, its value and what was expected."""

import re
from dataclasses import replace

import numpy as np
import pytest

from allocator import AntagonistError, InvalidInput, Limits, Method, MissingBackend, Stiffness, allocate, inverse
from allocator.joint.antagonist import report_joint
from allocator.joint.gas import StiffnessKind
from allocator.joint.geometry import Lever, Pulley
from allocator.muscles import Hogan1984, Tondu2021, TonduLopez1995
from mpc import Plant


class Quantity:
    """A number with a unit, as pint and astropy have it: it turns into a plain array without a word."""

    def __init__(self, value, units):
        self.value, self._units = value, units

    def __repr__(self):
        return f"{self.value} {self._units}"

    def __array__(self, dtype=None, copy=None):
        return np.asarray(self.value, dtype)

    @property
    def units(self):
        return self._units


class Column:
    """What a table gives for a column, as pandas and xarray have it."""

    def __init__(self, values):
        self.values = values

    def __array__(self, dtype=None, copy=None):
        return np.array(self.values, dtype)


WRONG = {
    "a force without a hand": ({"stiffness": Stiffness(force=3.0)}, "force are of a Mechanism; a joint has no hand"),
    "valves of six muscles": (
        {"stiffness": Stiffness(StiffnessKind("shut", (1.0,) * 6))},
        "are of 6 muscles, not 2",
    ),
    "a gap of nothing": ({"method": Method(gap=np.nan)}, "gap = nan is not finite"),
    "a risk of more than a half": ({"method": Method(risk=0.7)}, "risk = 0.7 has to be a probability"),
    "a warm start that is no truth value": ({"method": Method(warm_start=3)}, "warm_start = 3 has to be True or False"),
    "pressures of two joints in rows": (
        {"theta": [0.1, 0.2], "limits": Limits(previous=np.full((2, 2), 2e5), max_step=1e4)},
        "previous of the shape (2, 2) is two arrays or two targets' rows of pressures; write (P1, P2) [Pa]",
    ),
    "theta NaN": ({"theta": np.nan}, "theta = nan is not finite [rad]"),
    "theta infinite": ({"theta": np.inf}, "theta = inf is not finite [rad]"),
    "theta a string": ({"theta": "thirty"}, "theta = 'thirty' is not a number"),
    "theta None": ({"theta": None}, "theta = None is not a number"),
    "theta complex": ({"theta": 1j}, "theta = 1j is not a number or an array of real numbers [rad]"),
    "theta complex numbers": ({"theta": np.zeros(99, complex)}, "theta = ndarray(99,) of complex128 is not a number"),
    "theta true": ({"theta": True}, "theta = True is not a number"),
    "theta an array of bools": ({"theta": np.ones(99, bool)}, "theta = ndarray(99,) of bool is not a number"),
    "theta an array of strings": ({"theta": np.array(["0.1", "x"])}, "is not a number"),
    "theta an array of objects": ({"theta": np.array(["0.1", None])}, "is not a number"),
    "theta masked": (
        {"theta": np.ma.array([0.1, 0.2], mask=[0, 1])},
        "theta has 1 masked of 2 elements; leave them out or fill them",
    ),
    "theta nothing but a mask": ({"theta": np.ma.masked}, "theta has 1 masked of 1 elements"),
    "T a list with a masked row": ({"T": [np.ma.array([1.0], mask=True), [2.0]]}, "T has 1 masked of 1 elements"),
    "T masked where the joint moves": ({"T": np.ma.array([1.0], mask=True), "direction": [1]}, "T has 1 masked"),
    "T a string where the joint moves": ({"T": "1", "direction": [1]}, "T = '1' is not a number"),
    "direction of another shape": ({"T": [1, 2], "direction": [1, 1, 1]}, "do not broadcast: T (2,), direction (3,)"),
    "K with a unit": ({"K": Quantity(7.5, "N*m/deg")}, "K = 7.5 N*m/deg carries a unit of its own; pass plain numbers"),
    "K a list with units": ({"K": [Quantity(7.5, "N*m/rad")]}, "pass plain numbers in N·m/rad"),
    "previous masked": (
        {"limits": Limits(previous=(2e5, np.ma.array([2e5, 3e5], mask=[0, 1])), max_step=1e4)},
        "previous has 1 masked of 2 elements",
    ),
    "theta in degrees": ({"theta": 90}, "theta = 90 rad is over a turn; if degrees were meant, pass 1.571 rad"),
    "one angle of an array in degrees": ({"theta": [0.1, 30.0]}, "theta[1] = 30 rad is over a turn"),
    "K zero": ({"K": 0.0}, "K = 0 N·m/rad has to be positive"),
    "K negative in an array": ({"K": [7.0, -2.0]}, "K[1] = -2 N·m/rad has to be positive"),
    "K a string": ({"K": "7.5"}, "K = '7.5' is not a number"),
    "K ragged": ({"K": [[1, 2], [3]]}, "is not a number"),
    "T NaN in a matrix": ({"T": [[0, 1], [np.nan, 2]]}, "T[1, 0] = nan is not finite [N·m]"),
    "shapes": ({"theta": np.zeros(3), "T": np.zeros(4)}, "shapes do not broadcast: theta (3,), K (), T (4,)"),
    "unknown method": ({"method": "magic"}, "unknown method 'magic'; available: analytic, convex, exact, nlp, qp"),
    "unknown priority": ({"priority": "speed"}, "choose one of torque, stiffness, weighted"),
    "weights without weighted": ({"weights": (1, 1)}, "go together"),
    "weighted without weights": ({"priority": "weighted"}, "go together"),
    "weights not positive": ({"priority": "weighted", "weights": (1, 0)}, "two positive numbers"),
    "three weights": ({"priority": "weighted", "weights": (1, 2, 3)}, "two positive numbers"),
    "previous in bar": (
        {"limits": Limits(previous=(2, 3), max_step=1e4)},
        "previous[0] = 2 Pa is next to nothing; if bar was meant",
    ),
    "max_step in bar": ({"limits": Limits(previous=(2e5, 3e5), max_step=0.5)}, "max_step = 0.5 Pa is next to nothing"),
    "max_step negative": (
        {"limits": Limits(previous=(2e5, 3e5), max_step=-1e4)},
        "max_step = -10000 Pa has to be positive",
    ),
    "max_step alone": ({"limits": Limits(max_step=1e4)}, "previous and max_step go together"),
    "previous not a pair": ({"limits": Limits(previous=2e5, max_step=1e4)}, "has to be two pressures (P1, P2)"),
    "min_force negative": (
        {"limits": Limits(min_force=-1.0)},
        "min_force = -1.0 has to be one number that is not negative [N]",
    ),
}


@pytest.mark.parametrize(("changes", "said"), WRONG.values(), ids=WRONG.keys())
def test_a_wrong_argument_is_named(changes, said):
    arguments = {"theta": 0.3, "K": 7.5, "T": 1.0} | changes
    with pytest.raises(AntagonistError, match=re.escape(said)) as caught:
        allocate(**arguments)
    assert isinstance(caught.value, ValueError)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "same",
    [list, tuple, Column, np.ma.array, lambda theta: theta.astype(np.float32), lambda theta: theta.reshape(1, -1)[0]],
)
def test_whatever_numpy_takes_for_numbers_is_answered_alike(same):
    theta = np.array([-0.25, 0.5])  # exact in single precision
    answer = allocate(same(theta), 7.5, 1.0)
    assert type(answer.P1) is np.ndarray
    np.testing.assert_allclose(answer.P1, allocate(theta, 7.5, 1.0).P1, rtol=1e-12)


def test_an_unknown_method_is_a_missing_backend():
    with pytest.raises(MissingBackend):
        allocate(0.0, 7.5, method="")


def test_the_inverse_checks_too():
    with pytest.raises(InvalidInput, match="K = -1"):
        inverse(0.0, -1.0)


@pytest.mark.parametrize(
    ("build", "said"),
    [
        (lambda: Hogan1984(np.nan, 0.3, 5e5), "Hogan1984: F_max = nan is not a finite number"),
        (lambda: Hogan1984("strong", 0.3, 5e5), "F_max = 'strong' is not a finite number"),
        (lambda: TonduLopez1995(0.01, 25.5), "alpha0 = 25.5 rad is not between 0 and π/2; degrees?"),
        (lambda: TonduLopez1995(10.0, 0.4), "r0 = 10 m is not a muscle's radius"),
        (lambda: Tondu2021(0.01, 0.4, 0.0, 1e6, -7e12), "needs d < 0"),
    ],
)
def test_a_muscle_that_cannot_be_is_refused(build, said):
    with pytest.raises(InvalidInput, match=re.escape(said)):
        build()


NOT_ONE_NUMBER = {
    "text": "0.1",
    "bytes": b"0.1",
    "truth": True,
    "complex": 0.1 + 0j,
    "nothing": None,
    "a unit of its own": Quantity(0.1, "kg"),
    "masked": np.ma.masked,
    "several": [0.1, 0.2],
    "nan": np.nan,
    "400 digits": 10**400,
}
ONE_NUMBER = {
    "muscle": lambda value: Hogan1984(value, 0.3, 5e5),
    "pulley": lambda value: Pulley(0.4, value, 0.1),
    "contraction": lambda value: Pulley(0.4, 0.02, value),
    "lever": lambda value: Lever(0.4, 0.3, 0.03, value),
    "threshold": lambda value: replace(report_joint(), min_contraction=value),
    "friction": lambda value: replace(report_joint(), friction=value),
    "inertia": lambda value: Plant(inertia=value),
    "lag": lambda value: Plant(lag=(0.1, value)),
    "rest": lambda value: Plant().at_rest(value, 7.6),
    "pressure limits": lambda value: replace(report_joint(), pressure_limits=(value,)),
    "angle limits": lambda value: replace(report_joint(), angle_limits=(-1.0, value, 1.0)),
}


@pytest.mark.parametrize("value", NOT_ONE_NUMBER.values(), ids=NOT_ONE_NUMBER.keys())
@pytest.mark.parametrize("build", ONE_NUMBER.values(), ids=ONE_NUMBER.keys())
def test_what_is_not_one_number_is_refused_by_everything_that_is_made_of_numbers(build, value):
    with pytest.raises(InvalidInput) as refusal:
        build(value)
    assert "\n" not in str(refusal.value)
    assert len(str(refusal.value)) < 200


@pytest.mark.parametrize("same", [np.float32(0.125), np.array(0.125), np.longdouble(0.125)], ids=repr)
def test_one_number_of_any_kind_is_the_same_number(same):
    assert Plant(inertia=same) == Plant(inertia=0.125)
    assert Hogan1984(1500, same, 5e5) == Hogan1984(1500, 0.125, 5e5)
