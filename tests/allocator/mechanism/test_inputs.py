"""Wrong input ends in one sentence that names the argument, its value and what was expected."""

import casadi
import numpy as np
import pytest

from allocator import InvalidInput, Limits, Method, MissingBackend, Status, Stiffness, allocate, report_joint
from allocator.allocation import allocate_at_least
from allocator.joint.gas import HELD
from allocator.mechanism import (
    Endpoint,
    Link,
    Mechanism,
    Pulleys,
    Sites,
    Tables,
    from_function,
    machines,
)
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N, TONDU_DMSP_20_400N
from allocator.units import BAR

ARM = machines.arm26()
GOOD = {"theta": [0.4, -0.3], "K": [[10.0, 4.0], [4.0, 9.0]], "T": [9.0, 4.0]}
PATH = [(-1, (0.1, 0.1)), (0, (0.2, 0.1))]


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"theta": [23.0, -17.0]}, r"theta\[0\] = 23 rad is over a turn; if degrees were meant, pass 0.4014 rad"),
        ({"theta": [0.1, 0.2, 0.3]}, r"theta has the shape \(3,\); expected \(…, 2\).* n = 2 joints and m = 6 muscles"),
        ({"theta": [np.nan, 0.2]}, r"theta\[0\] = nan is not finite \[rad\]"),
        ({"K": [[10.0, 4.0], [3.0, 9.0]]}, "K is not symmetric.* differ by 1 N·m/rad"),
        ({"K": [[10.0, 40.0], [40.0, 9.0]]}, "K has the eigenvalue -30.* positive definite"),
        ({"K": [10.0, -9.0]}, r"K\[1\] = -9 N·m/rad has to be positive"),
        ({"K": np.ones((3, 3))}, r"K has the shape \(3, 3\); expected matrices \(…, 2, 2\).* n = 2 .* m = 6"),
        ({"theta": np.zeros((2, 2)), "K": np.eye(2)}, "one matrix or the diagonals of 2 targets"),
        ({"T": [1.0, 2.0, 3.0]}, r"T has the shape \(3,\); expected \(…, 2\)"),
        ({"T": [np.inf, 2.0]}, r"T\[0\] = inf is not finite"),
        ({"theta": np.zeros((4, 2)), "T": np.zeros((3, 2))}, r"do not broadcast: \(4,\), \(3,\).* n = 2 .* m = 6"),
        ({"limits": Limits(previous=[3, 2, 2.5, 3.5, 4, 1.5])}, "previous.* if bar was meant"),
        ({"limits": Limits(previous=np.full(5, 2e5))}, r"previous has the shape \(5,\); expected \(…, 6\)"),
        ({"limits": Limits(max_step=1e4)}, "max_step .* give previous"),
        ({"limits": Limits(previous=np.full(6, 2e5), max_step=1.0)}, "max_step.* bar"),
        ({"limits": Limits(min_force=[1.0, 2.0])}, "min_force = .* m = 6"),
        ({"limits": Limits(min_force=-1.0)}, "min_force = -1.0 .* not negative"),
        ({"limits": Limits(min_force=100.0, max_force=50.0)}, "max_force = 50 N of shoulder flexor has to exceed"),
        ({"priority": "speed"}, "priority = 'speed' is unknown; choose one of torque, stiffness, weighted"),
        ({"priority": "weighted"}, r"needs weights = \(w_T, w_K\)"),
        ({"weights": 3.0}, r"weights = 3.0 have to be two"),
        ({"weights": (1.0, [1.0, 2.0])}, r"w_K \(2, 2\) for n = 2"),
        ({"weights": (1.0, [[1.0, 2.0], [0.0, 1.0]])}, "has to be symmetric"),
        ({"weights": (-1.0, 1.0)}, "must not be negative"),
        ({"method": Method(solver="daqp")}, "solver = 'daqp' belongs to the method 'qp'"),
        ({"method": Method(risk=0.7)}, "risk = 0.7 has to be a probability"),
        ({"method": Method("qp"), "along": 0, "theta": [[0.1, 0.2]]}, "along is for the method 'exact', not 'qp'"),
        ({"direction": 1.0}, "direction = 1.0 is for an AntagonistJoint with friction"),
        ({"stiffness": Stiffness(HELD)}, "are of 2 muscles, not 6"),
        (
            {"priority": "weighted", "weights": (1.0, 1.0), "pull": (1e300, np.full(6, 2e5))},
            r"pull\[0\] = 1e\+300 cost/Pa² is over 1e\+100",
        ),
        ({"joint": "arm26"}, "joint = 'arm26' has to be an AntagonistJoint or a Mechanism"),
        (
            {"joint": ARM.with_muscles(TONDU_DMSP_20_400N), "method": "qp"},
            "shoulder flexor, .*not affine.*Tondu2021.*Sarosi2012",
        ),
    ],
)
def test_wrong_arguments_of_the_allocation(changed, sentence):
    with pytest.raises(InvalidInput, match=sentence):
        allocate(**({"joint": ARM} | GOOD | changed))


@pytest.mark.parametrize("name", ["method", "solver"])
def test_unknown_methods_list_the_known_ones(name):
    with pytest.raises(MissingBackend, match=r"available: .*(exact|daqp)"):
        allocate(joint=ARM, **GOOD, method="magic" if name == "method" else Method("qp", solver="magic"))


GRID = np.linspace(-0.2, 0.2, 5)
TABLE = Tables(0.4, [GRID], 0.35 - np.stack([0.02 * GRID, -0.02 * GRID], axis=1))


def test_a_posture_beyond_a_table_is_answered_at_its_end():
    """As that of a joint with a `Table`; beyond the grid the lengths are those of no measurement."""
    free = Mechanism(TABLE, SAROSI_DMSP_20_400N)
    assert free.angle_limits == ((-0.2, 0.2),)
    assert Mechanism(TABLE, SAROSI_DMSP_20_400N, angle_limits=((-0.1, 1.0),)).angle_limits == ((-0.1, 0.2),)
    answer = allocate([0.5], 5.0, joint=free)
    assert answer.q == 0.2
    assert answer.status == Status.OUTSIDE_JOINT_RANGE
    assert "joint 1 range" in answer.active


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: Pulleys(0.4, [(0.02, 0.0), (np.nan, 0.02)], 0.1), r"arms\[1, 0\] = nan is not finite \[m\]"),
        (lambda: Pulleys(0.4, [(0.02, 0.0), (0.0, 0.0)], 0.1), "muscle 2 has no arm at any joint"),
        (lambda: Pulleys(0.4, [(20.0, 0.0)], 0.1), "arms.* 20 m is no pulley; if millimetres, divide by 1000"),
        (lambda: Pulleys(0.4, [0.02, 0.02], 0.1), r"arms have the shape \(2,\); expected \(m, n\)"),
        (lambda: Pulleys(400, [(0.02,)], 0.1), r"rest_length\[0\] = 400 has to be a muscle's length in metres"),
        (lambda: Pulleys([0.4, 0.3], [(0.02,)], 0.1), r"rest_length has the shape \(2,\).* m = 1"),
        (lambda: Pulleys(0.4, [(0.02,)], 13.75), "initial_contraction.* if percent was meant"),
        (lambda: Sites(0.4, [Link()], [[(0, (0.1, 0.1)), (0, (0.2, 0.1))]]), "muscle 1 has no arm at any joint"),
        (lambda: Sites(0.4, [Link()], [PATH, [(0, (0.1, 0.1))]]), "path 1 has 1 sites; .* two or more"),
        (
            lambda: Sites(0.4, [Link()], [[(-1, (0.1, 0.1)), (1, (0.2, 0.1))]]),
            "link 1; expected a whole number from -1",
        ),
        (lambda: Sites(0.4, [Link()], [[(-0.3, (0.1, 0.1)), (0, (0.2, 0.1))]]), "link -0.3; expected a whole number"),
        (
            lambda: Sites(0.4, [Link()], [[(-1, (-300, 40)), (0, (40, 40))]]),
            r"length\[0\] = 326.5.* m.* if millimetres",
        ),
        (lambda: Sites(0.4, [Link(), Link(2)], [PATH]), "link 1 has the parent 2"),
        (lambda: Link(parent=0.0), "Link: parent = 0.0 has to be a whole number, -1 or more"),
        (lambda: Sites(0.4, [], []), "n = 0 links and m = 0 paths"),
        (lambda: Link(axis=(0.0, 0.0, 0.0)), "axis = 0 is no direction"),
        (lambda: Link(origin=(0.1,)), "origin = .* two or three coordinates"),
        (lambda: Link(orientation=np.ones((3, 3))), "orientation has to be a rotation matrix"),
        (lambda: Link(kind="ball"), "kind = 'ball' is unknown; choose one of hinge, slide"),
        (lambda: Tables(0.4, [[0.0, 0.1, 0.2]], np.ones((3, 1))), r"grid\[0\] .* 4 or more increasing"),
        (lambda: Tables(0.4, [np.arange(5) / 5], np.ones((4, 1))), r"lengths have the shape \(4, 1\).* \(5, m\)"),
        (lambda: Tables(0.4, [GRID], 350 - 20 * GRID[:, None]), r"length\[0, 0\] = 354 m.* if millimetres"),
        (
            lambda: Mechanism(TABLE, SAROSI_DMSP_20_400N, angle_limits=((1.0, 2.0),)),
            "angle_limits lie outside the angles of the routes' table",
        ),
        (lambda: Tables(0.4, [np.arange(5) / 5], np.ones((5, 1))), "muscle 1 has no arm"),
        (lambda: from_function(0.4, 2, lambda q: [0.3 - 0.02 * q[0], casadi.SX(0.3)]), "muscle 2 has no arm"),
        (lambda: from_function(0.4, 2, lambda q: "far"), "'far', no CasADi expression"),
        (lambda: Mechanism(Pulleys(0.4, [(0.02,)], 0.1), (SAROSI_DMSP_20_400N,) * 2), "2 given; .* m = 1 .* n = 1"),
        (lambda: Mechanism(Pulleys(0.4, [(0.02,)], 0.1), SAROSI_DMSP_20_400N, (0, 5)), "if bar was meant"),
        (
            lambda: Mechanism(Pulleys(0.4, [(0.02,)], 0.1), SAROSI_DMSP_20_400N, min_contraction=2.5),
            "min_contraction = 2.5 is no contraction ratio; if percent was meant, divide by 100",
        ),
        (
            lambda: Mechanism(Pulleys(0.4, [(0.02,)], 0.1), SAROSI_DMSP_20_400N, angle_limits=((1.0, -1.0),)),
            "angle_limits have to be .* n = 1 joints, increasing",
        ),
        (
            lambda: Mechanism(Pulleys(0.4, [(0.02,)] * 2, 0.1), SAROSI_DMSP_20_400N, muscle_names=("a", "a")),
            "muscle_names = .* 2 different names",
        ),
        (lambda: ARM.torque([0.4, -0.3], np.full(5, 2e5)), r"P has the shape \(5,\); expected \(…, 6\)"),
        (lambda: ARM.torque([0.4, -0.3], [3, 2, 2.5, 3.5, 4, 1.5]), "if bar was meant"),
        (lambda: ARM.torque(np.zeros((2, 2)), np.full((3, 6), 2e5)), "do not broadcast"),
        (lambda: ARM.with_muscles(TONDU_DMSP_20_400N).targets_map([0.1, 0.1]), "not affine in the pressure"),
    ],
)
def test_wrong_parts_of_a_mechanism(make, sentence):
    with pytest.raises(InvalidInput, match=sentence):
        make()


def test_muscles_that_are_not_affine_still_have_torque_and_stiffness():
    report = ARM.with_muscles(TONDU_DMSP_20_400N)
    assert not report.affine
    assert report.torque([0.4, -0.3], np.full(6, 3 * BAR)).shape == (2,)


def test_answers_are_frozen():
    a = allocate(joint=ARM, **GOOD)
    for array in (a.P, a.T, a.K):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0
    many = allocate(np.zeros((3, 4, 2)), 9.0, 1.0, joint=ARM)
    assert many.P.shape == (3, 4, 6)
    assert many.status.shape == many.active.shape == (3, 4)
    assert "12 targets" in repr(many)


@pytest.mark.parametrize(
    "options", [{}, {"method": "qp"}, {"stiffness": Stiffness(endpoint=Endpoint.planar([0.3, 0.25]))}], ids=str
)
def test_no_targets_have_no_answers(options):
    a = allocate(np.zeros((0, 2)), 10.0, joint=ARM, **options)
    assert (a.P.shape, a.K.shape, a.costs.shape, a.lower_bounds.shape) == ((0, 6), (0, 2, 2), (0, 2), (0, 2))
    assert (a.status.shape, a.forces.shape) == ((0,), (0, 6))


def test_free_valves_are_of_an_antagonistic_joint():
    pair = Mechanism.from_joint(report_joint(SAROSI_DMSP_20_400N))
    with pytest.raises(InvalidInput, match="valves = 'free' are for an AntagonistJoint"):
        allocate([0.2], 5.0, joint=pair, stiffness=Stiffness("free"))


@pytest.mark.parametrize("stiffness", ["shut", None])
def test_at_least_a_stiffness_needs_a_stiffness_too(stiffness):
    with pytest.raises(InvalidInput, match=r"stiffness = .* has to be a Stiffness"):
        allocate_at_least(ARM, [0.1, 0.2], 6.0, stiffness=stiffness)


def test_at_least_a_stiffness_is_asked_for_one_posture():
    with pytest.raises(InvalidInput, match=r"one posture and one target at a time, not for \(2,\)"):
        allocate_at_least(ARM, [[0.1, 0.2], [0.3, 0.4]], 6.0)


def test_an_axis_of_time_may_be_a_number_of_numpy_s():
    q = np.linspace(0.1, 0.4, 6).reshape(3, 2)
    counted, numpy_s = (allocate(q, 8.0, joint=ARM, along=axis) for axis in (0, np.int64(-1)))
    assert np.array_equal(counted.P, numpy_s.P)


def test_no_targets_have_a_proof_of_the_shape_of_none():
    none = allocate(np.zeros((0, 2)), 8.0, joint=ARM)
    assert none.separation.direction.shape == (0, 5)
