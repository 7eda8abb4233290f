"""No call takes another road because of the type of a number, and none waits for a compiler before it pays."""

from unittest.mock import Mock

import numpy as np
import pytest

from allocator import AntagonistJoint, InvalidInput, Lever, Limits, Stiffness, allocate, report_joint, warm_up
from allocator.allocation.two_muscles import exact
from allocator.allocation.two_muscles.kernels import calls
from allocator.joint.limits import TAUT
from allocator.muscles.catalogue import SAROSI_DMSP_20_200N, SAROSI_DMSP_20_400N

LEVER = AntagonistJoint(
    Lever(0.40, 0.30, 0.03, 0.0435), SAROSI_DMSP_20_400N, SAROSI_DMSP_20_200N, angle_limits=(-1.4, 1.4)
)
JOINTS = {"tondu": report_joint(), "affine": LEVER}
SLEW = {"limits": Limits(previous=(2e5, 3e5), max_step=50_000)}
ONE = {  # the same in every type that is tried
    "target": ({"theta": 1, "K": 8, "T": 2}, ("theta", "K", "T")),
    "forces": (
        {"theta": 0.5, "K": 7.5, "T": 1.0, "limits": Limits(min_force=64, max_force=512)},
        ("min_force", "max_force"),
    ),
    "least force alone": ({"theta": 0.5, "K": 7.5, "T": 1.0, "limits": Limits(min_force=64)}, ("min_force",)),
    "slew": ({"theta": 0.5, "K": 7.5, "T": 1.0, **SLEW}, ("previous", "max_step")),
    "what is not asked": (
        {"theta": 0.5, "K": 7.5, "T": 1.0, "direction": 0, "stiffness": Stiffness(tolerance=0)},
        ("direction",),
    ),
}
REAL = (int, float, np.int32, np.uint64, np.float32, np.float64, np.longdouble, np.array)
TYPES = {kind.__name__: kind for kind in REAL} | {"0-d single": lambda x: np.array(x, np.float32)}
MANY = {
    "list": np.ndarray.tolist,
    "tuple": lambda x: tuple(x.tolist()),
    "list of NumPy's": list,
    "single": lambda x: x.astype(np.float32),
    "half": lambda x: x.astype(np.float16),
    "long": lambda x: x.astype(np.longdouble),
    "whole": lambda x: x.astype(np.int32),
    "unsigned": lambda x: x.astype(np.uint64),
    "big-endian": lambda x: x.astype(">f8"),
    "nested": lambda x: [[float(one)] for one in x],
}


@pytest.fixture
def no_readable(monkeypatch):
    """Fails where the readable implementation would answer."""
    unwanted = Mock(side_effect=AssertionError("the readable implementation was asked"))
    for module in (exact, calls):
        monkeypatch.setattr(module, "solve", unwanted)


@pytest.fixture
def compiler(monkeypatch):
    """The compiler, as if nothing had been compiled yet; `call_count` says how often it was asked."""
    asked = Mock(side_effect=calls.kernel)
    monkeypatch.setattr(calls, "kernel", asked)
    for compiled in ("_scalars", "_batches"):
        monkeypatch.setattr(calls, compiled, {})
    return asked


def changed(arguments, names, into):
    """The same arguments, those of these names of another type; a pair's both numbers."""
    limits = arguments.get("limits", TAUT)

    def of(value):
        return tuple(into(x) for x in value) if isinstance(value, tuple) else into(value)

    limits = limits._replace(**{name: of(getattr(limits, name)) for name in names if name in Limits._fields})
    return arguments | {name: of(arguments[name]) for name in names if name in arguments} | {"limits": limits}


def fields(a):
    return [getattr(a, name) for name in ("theta", "K_target", "T_target", "P1", "P2", "T", "K", "status", "limits")]


@pytest.mark.parametrize("into", TYPES.values(), ids=TYPES.keys())
@pytest.mark.parametrize(("arguments", "names"), ONE.values(), ids=ONE.keys())
@pytest.mark.parametrize("joint", JOINTS.values(), ids=JOINTS.keys())
def test_a_single_target_of_any_type_takes_the_scalar_road(joint, arguments, names, into, no_readable, monkeypatch):
    expected = allocate(**changed(arguments, names, float), joint=joint)
    monkeypatch.setattr(calls, "run", Mock(side_effect=AssertionError("taken for an array")))
    found = allocate(**changed(arguments, names, into), joint=joint)
    assert fields(found) == fields(expected)
    assert [type(x) for x in fields(found)] == [type(x) for x in fields(expected)]
    assert found.stiffness_interval == expected.stiffness_interval


@pytest.mark.parametrize("pair", [list, np.array], ids=["list", "array"])
def test_the_pressures_now_come_in_any_pair(pair, no_readable):
    for theta in (0.5, np.linspace(-1, 1, 21)):
        expected = allocate(theta, 7.5, 1.0, **SLEW)
        found = allocate(theta, 7.5, 1.0, limits=Limits(previous=pair(SLEW["limits"].previous), max_step=50_000))
        assert np.array_equal(found.P1, expected.P1)
        assert np.array_equal(found.P2, expected.P2)


def test_the_pressures_now_of_many_targets_come_in_one_array(no_readable):
    theta, now = np.linspace(-1, 1, 21), np.linspace([2e5, 3e5], [3e5, 2e5], 21).T
    expected = allocate(theta, 7.5, limits=Limits(previous=(now[0], now[1]), max_step=5e4))
    for same in (now, now.tolist(), list(now)):
        assert np.array_equal(allocate(theta, 7.5, limits=Limits(previous=same, max_step=5e4)).P1, expected.P1)


@pytest.mark.parametrize("compiled", [False, True], ids=["plain", "compiled"])
@pytest.mark.parametrize("into", MANY.values(), ids=MANY.keys())
@pytest.mark.parametrize("joint", JOINTS.values(), ids=JOINTS.keys())
def test_arrays_of_any_type_take_the_array_road(joint, into, compiled, no_readable, compiler):
    if compiled:
        assert warm_up(joint=joint)
    theta, K, T = np.array([0.0, 1.0, 0.0]), np.array([7.0, 8.0, 12.0]), np.array([2.0, 0.0, 1.0])
    expected = allocate(theta, K, T, joint=joint)
    found = allocate(into(theta), into(K), into(T), joint=joint)
    assert [x.dtype for x in fields(found)] == [x.dtype for x in fields(expected)]
    assert all(np.array_equal(np.ravel(a), b) for a, b in zip(fields(found), fields(expected), strict=True))


def test_an_answer_stays_when_the_numbers_it_was_asked_with_change():
    theta, force, now = np.array(0.5), np.array(64.0), np.array([2e5, 3e5])
    first, second = (
        allocate(theta, 7.5, 1.0, limits=Limits(min_force=force, previous=now, max_step=5e4)) for _ in range(2)
    )
    expected = first.stiffness_interval
    theta *= 0.5
    force *= 4
    now *= 0.5
    assert (second.stiffness_interval, second.theta) == (expected, 0.5)


@pytest.mark.parametrize(
    "wrong", [True, np.True_, 0j, np.complex64(0), "0", None, np.nan, np.float32(np.nan)], ids=repr
)
@pytest.mark.parametrize("name", ["theta", "K", "T", "direction", "pull", "tolerance"])
def test_what_is_no_real_number_is_refused_for_what_it_is(name, wrong):
    values = {"pull": {"pull": (wrong, (2e5, 2e5))}, "tolerance": {"stiffness": Stiffness(tolerance=wrong)}}
    with pytest.raises(InvalidInput, match=rf"^{name}(\[0\])? = .* is not (a number|finite)"):
        allocate(**{"theta": 0.3, "K": 7.5, "T": 1.0} | values.get(name, {name: wrong}))


@pytest.mark.parametrize(
    "wrong", [[True], [0.1, "x"], [np.ma.masked, 1.0], [0.1, np.nan], [1j], [10**400], [None]], ids=repr
)
def test_a_list_with_what_is_no_real_number_is_refused(wrong):
    with pytest.raises(InvalidInput, match=r"^theta"):
        allocate(wrong, 7.5, 1.0)


def test_ten_thousand_short_calls_compile_nothing(compiler, no_readable):
    theta = np.linspace(-1, 1, 21)
    for _ in range(10_000):
        allocate(theta[:2], 7.5, 1.0)
    for n in (1, 21, calls._FEW):
        allocate(np.resize(theta, n), 7.5, 1.0)
    assert not compiler.called


def test_an_array_compiles_where_that_pays_and_not_before(compiler, monkeypatch):
    monkeypatch.setattr(calls, "_PAYS", 1000)
    theta = np.linspace(-1, 1, 1000)
    for _ in range(3):
        allocate(theta[1:], 7.5, 1.0)
    assert not compiler.called
    allocate(theta, 7.5, 1.0)
    compiler.assert_called_once_with("tondu_batch")
    monkeypatch.setattr(exact, "solve", Mock(side_effect=AssertionError("compiled code is there")))
    assert allocate(theta[1:], 7.5, 1.0).success.any()
    assert compiler.call_count == 1


@pytest.mark.parametrize("priority", ["torque", "stiffness"])
@pytest.mark.parametrize(
    "options", [{}, SLEW, {"limits": Limits(min_force=None)}, {"limits": Limits(max_force=500.0)}], ids=repr
)
@pytest.mark.parametrize("joint", JOINTS.values(), ids=JOINTS.keys())
def test_short_arrays_are_answered_one_by_one(joint, options, priority, compiler, no_readable):
    rng = np.random.default_rng(6)
    theta, K, T = rng.uniform(-1.6, 1.6, 100), rng.uniform(5.0, 12.0, 100), rng.uniform(-8.0, 8.0, 100)
    many = allocate(theta, K, T, joint=joint, priority=priority, **options)
    for i, target in enumerate(zip(theta.tolist(), K.tolist(), T.tolist(), strict=True)):
        one = allocate(*target, joint=joint, priority=priority, **options)
        assert fields(one)[:3] == list(target)
        assert fields(one)[3:] == pytest.approx([x[i] for x in fields(many)[3:]], rel=1e-12)
    assert not compiler.called


@pytest.mark.parametrize("joint", JOINTS.values(), ids=JOINTS.keys())
def test_arrays_below_what_pays_are_answered_by_the_kernels_without_a_compiler(joint, no_readable, compiler):
    theta = np.linspace(-1.3, 1.3, calls._FEW + 1)
    a = allocate(theta, 8.0, np.linspace(-3, 3, theta.size), joint=joint)
    assert compiler.call_count == 0
    one_by_one = [allocate(t, 8.0, T, joint=joint) for t, T in zip(theta.tolist(), a.T_target.tolist(), strict=True)]
    for name in ("P1", "P2", "T", "K", "status", "limits"):
        assert getattr(a, name) == pytest.approx([getattr(one, name) for one in one_by_one], rel=1e-12, abs=1e-12)
