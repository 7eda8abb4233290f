"""The kernels give the reference's answers, over the whole box and at its edges; whatever they cannot do, it does."""

import pickle
import subprocess
import sys

import numpy as np
import pytest
from scipy.optimize import brentq

import allocator
from allocator import AntagonistJoint, InvalidInput, Lever, Pulley, Status, Table, allocate, report_joint, warm_up
from allocator.allocation.arguments import problem_from
from allocator.allocation.two_muscles import exact
from allocator.allocation.two_muscles.certificate import assess
from allocator.allocation.two_muscles.kernels import calls, kernel
from allocator.allocation.two_muscles.kernels import source as kernels
from allocator.allocation.two_muscles.kernels.choice import AffineNumbers, TonduNumbers, coefficients
from allocator.joint.limits import TAUT, Limits
from allocator.muscles import Hogan1984, Tondu2021
from allocator.muscles.catalogue import SAROSI_DMSP_20_200N, SAROSI_DMSP_20_400N, TONDU_DMSP_20_400N, TONDU_MCKIBBEN
from allocator.units import BAR, DEG

PULLEY = Pulley(rest_length=0.40, radius=0.02, initial_contraction=0.1375)
STOPS = (-80 * DEG, 80 * DEG)
CS = (-20, -5, 5, 20)  # [bar]


def tondu(c_bar):
    muscle = Tondu2021.identify(0.0109, 25.5 * DEG, low=(3 * BAR, 0.225), high=(5 * BAR, 0.275), c=c_bar * BAR)
    return AntagonistJoint(PULLEY, muscle, muscle, angle_limits=(-125 * DEG, 125 * DEG))


def sine_table():
    angles = np.linspace(-1.5, 1.5, 31)
    return Table(0.40, angles, 0.13 + 0.04 * np.sin(angles), 0.13 - 0.045 * np.sin(angles))


TONDU = {"report": report_joint(), **{f"c = {c} bar": tondu(c) for c in CS}}
AFFINE = {
    "mckibben": AntagonistJoint(Pulley(0.40, 0.02, 0.185), TONDU_MCKIBBEN, TONDU_MCKIBBEN, angle_limits=STOPS),
    "hogan, unequal": AntagonistJoint(
        PULLEY, Hogan1984(1500.0, 0.30, 5 * BAR), Hogan1984(1200.0, 0.28, 5 * BAR), angle_limits=STOPS
    ),
    "sarosi, unequal, lever": AntagonistJoint(
        Lever(0.40, 0.30, 0.03, 0.0435), SAROSI_DMSP_20_400N, SAROSI_DMSP_20_200N, angle_limits=STOPS
    ),
    "sarosi, table": AntagonistJoint(sine_table(), SAROSI_DMSP_20_400N, SAROSI_DMSP_20_400N, angle_limits=STOPS),
}
JOINTS = TONDU | AFFINE
LIMITS = {
    "taut": {},
    "slack allowed": {"limits": Limits(min_force=None)},
    "force band": {"limits": Limits(min_force=80.0, max_force=500.0)},
    "more force than there is": {"limits": Limits(min_force=2000.0)},
    "slew": {"limits": Limits(previous=(2 * BAR, 2.5 * BAR), max_step=0.4 * BAR)},
    "slew from outside": {"limits": Limits(previous=(7 * BAR, 0.0), max_step=1.5 * BAR)},
}


def mixed_targets(joint, n, seed):
    """Feasible, infeasible, and beyond the joint range."""
    rng = np.random.default_rng(seed)
    left, right = joint.angle_range
    theta = rng.uniform(left - 0.2, right + 0.2, n)
    at = np.clip(theta, left, right)
    P1, P2 = rng.uniform(-0.5 * BAR, 6.5 * BAR, (2, n))
    return theta, np.maximum(joint.stiffness(at, P1, P2), 0.1), joint.torque(at, P1, P2)


def question(joint, theta, K, T, priority="torque", limits=TAUT):
    return joint, theta, K, T, priority, limits


def reference(asked):
    joint, theta, K, T, priority, limits = asked
    problem, angles = problem_from(joint, theta, K, T, priority=priority, limits=limits)
    P1, P2, gap = exact.solve(problem)
    found = assess(problem, P1, P2, joint.outside_range(np.ravel(angles)))
    return P1, P2, *found, gap


def assert_same(answer, expected, joint):
    P1, P2, T, K, status, limits, gap = expected
    near = 1e-12 * joint.pressure_span
    assert np.ravel(answer.P1) == pytest.approx(P1, rel=1e-9, abs=near)
    assert np.ravel(answer.P2) == pytest.approx(P2, rel=1e-9, abs=near)
    assert np.ravel(answer.T) == pytest.approx(T, rel=1e-9, abs=1e-12)
    assert np.ravel(answer.K) == pytest.approx(K, rel=1e-9)
    assert np.ravel(answer.status).tolist() == status.tolist()
    assert np.ravel(answer.limits).tolist() == limits.tolist()
    assert max(np.max(answer.gap), gap.max()) <= 1e-12


@pytest.fixture
def at_once(monkeypatch):
    """Compiled code for the first array already."""
    monkeypatch.setattr(calls, "_PAYS", 1)


@pytest.mark.parametrize("limits", LIMITS.values(), ids=LIMITS.keys())
@pytest.mark.parametrize("priority", ["torque", "stiffness"])
@pytest.mark.parametrize("joint", JOINTS.values(), ids=JOINTS.keys())
def test_a_single_answer_is_the_reference_s(joint, priority, limits):
    theta, K, T = mixed_targets(joint, 120, seed=1)
    expected = reference(question(joint, theta, K, T, priority, **limits))
    seen = 0
    for i, one in enumerate(zip(theta.tolist(), K.tolist(), T.tolist(), strict=True)):
        found = calls.answer(*question(joint, *one, priority, **limits))
        if found is not None:
            seen += 1
            assert_same(found, [np.atleast_1d(x[i]) for x in expected], joint)
    assert seen == len(theta) or limits is LIMITS["slew from outside"]


@pytest.mark.slow
@pytest.mark.parametrize("joint", [JOINTS["report"], JOINTS["sarosi, unequal, lever"]], ids=["tondu", "affine"])
@pytest.mark.parametrize("limits", [LIMITS["taut"], LIMITS["slew"]], ids=["taut", "slew"])
@pytest.mark.parametrize("priority", ["torque", "stiffness"])
def test_an_array_s_answers_are_the_reference_s(joint, priority, limits, at_once):
    asked = question(joint, *mixed_targets(joint, 5000, seed=2), priority, **limits)
    found = calls.answer(*asked)
    expected = reference(asked)
    assert_same(found, expected, joint)
    assert {Status.EXACT, Status.BOTH_LIMITED, Status.OUTSIDE_JOINT_RANGE} < set(expected[4].tolist())


@pytest.mark.parametrize("joint", TONDU.values(), ids=TONDU.keys())
def test_the_inverse_is_accurate_over_the_whole_box_and_at_its_edges(joint):
    """1e-9 of the pressure: the direct model, written elsewhere, then back; the edges of the box included."""
    p = tuple(TonduNumbers.of(joint))
    for theta in np.linspace(*joint.angle_range, 9).tolist():
        box = joint.pressure_box(theta)
        for a in np.linspace(float(box.agonist.lo), float(box.agonist.hi), 12):
            for b in np.linspace(float(box.antagonist.lo), float(box.antagonist.hi), 12):
                T, K = joint.torque(theta, a, b), joint.stiffness(theta, a, b)
                for first in (None, True):
                    P1, P2, *_, status, _, sure = kernels.tondu_exact(
                        theta, float(K), float(T), p, stiffness_first=first
                    )
                    assert (P1, P2) == pytest.approx((a, b), rel=1e-9, abs=1e-4)
                    assert (status, sure) == (Status.EXACT, True)


@pytest.mark.parametrize("kappa", [0.0, 0.1, 0.5, 0.79999])
@pytest.mark.parametrize("sign", [-1, 1])
def test_the_fixed_number_of_steps_finds_the_root_that_brentq_finds(kappa, sign):
    """In units in which q = -g = 1, and with a box that does not clip."""
    s = -2 * np.sqrt(kappa / 0.25) if kappa else -1e-9
    box, law = (-1e300, 1e300, -1e300, 1e300, s / 2, s / 2, s / 2, s / 2), (0.25, 0.25, 1.0, 0.0, 0.0, -1.0)
    for z in np.linspace(0.0, 0.5, 26):
        t = sign * z * (1 / (1 - z**2) - kappa)
        root = brentq(lambda x, t=t: ((kappa * x + t) * x + 1 - kappa) * x - t, -0.6, 0.6, xtol=1e-15, rtol=1e-15)
        P1, P2 = kernels.tondu_inverse(-4 * t / s, s, box, law)
        assert (P1 * s / 2, P2 * s / 2) == pytest.approx((1 / (1 + root), 1 / (1 - root)), rel=1e-13)


def test_targets_for_which_a_kernel_is_not_proved_are_left_to_the_reference(at_once):
    joint, slew = report_joint(), LIMITS["slew from outside"]
    asked = question(joint, *mixed_targets(joint, 500, seed=5), **slew)
    assert calls.answer(*question(joint, 0.3, 7.5, 1.0, **slew)) is None  # 5.5 bar at least: beyond the supply
    assert_same(calls.answer(*asked), reference(asked), joint)


def test_joints_outside_the_proved_region_have_no_kernel():
    pulley = Pulley(0.40, 0.02, 0.25)  # κ = 0.9 at the supply pressure
    joint = AntagonistJoint(pulley, TONDU_DMSP_20_400N, TONDU_DMSP_20_400N)
    assert joint.tondu_pulley is not None
    assert TonduNumbers.of(joint) is None
    T, K = joint.torque(0.2, 4.5 * BAR, 4 * BAR), joint.stiffness(0.2, 4.5 * BAR, 4 * BAR)
    a = allocate(0.2, K, T, joint=joint)
    assert (a.P1, a.P2) == pytest.approx((4.5 * BAR, 4 * BAR), rel=1e-9)


@pytest.mark.parametrize("name", ["tondu", "affine"])
def test_compiled_and_plain_python_give_the_same_digits(name):
    joint = report_joint() if name == "tondu" else AFFINE["sarosi, unequal, lever"]
    numbers = TonduNumbers if name == "tondu" else AffineNumbers
    p, compiled, plain = tuple(numbers.of(joint)), kernel(f"{name}_exact"), getattr(kernels, f"{name}_exact")
    options = (0.0, None, None, None, None, None)
    for theta, K, T in zip(*(x.tolist() for x in mixed_targets(joint, 300, seed=3)), strict=True):
        given = ()
        if name == "affine":
            at = np.clip(theta, *joint.angle_range)
            given = tuple(tuple(map(float, c)) for c in coefficients(joint, at))
        assert compiled(theta, K, T, *given, p, *options) == plain(theta, K, T, *given, p, *options)


def test_threads_change_nothing(at_once, monkeypatch):
    import numba

    from allocator.allocation.two_muscles.kernels import calls

    joint = report_joint()
    targets = mixed_targets(joint, 20_000, seed=4)
    monkeypatch.setattr(calls, "_PIECE", 3000)
    monkeypatch.setattr(calls, "_PARALLEL", 1)
    answers = []
    for n in (1, 3):
        monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", n)
        a = allocate(*targets, joint=joint)
        answers.append([a.P1, a.P2, a.T, a.K, a.status, a.limits, a.gap])
    assert all(np.array_equal(one, many) for one, many in zip(*answers, strict=True))


FORMS = {
    "read-only": lambda x: np.broadcast_to(x, x.shape),
    "every other": lambda x: np.repeat(x, 2)[::2],
    "a list": lambda x: x.tolist(),
    "single precision": lambda x: x.astype(np.float32),
    "column": lambda x: x[:, None],
}


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS.keys())
def test_arrays_come_in_every_form(form, at_once):
    theta = np.linspace(-1, 1, 7)
    expected = [
        allocate(float(np.float32(x)) if form is FORMS["single precision"] else float(x), 7.5).P1 for x in theta
    ]
    assert np.ravel(allocate(form(theta), 7.5).P1) == pytest.approx(expected, rel=1e-9)


def test_targets_of_different_shapes_broadcast(at_once):
    theta, K = np.linspace(-1, 1, 5)[:, None], np.array([6.8, 7.5, 8.0])
    a = allocate(theta, K, 1)
    assert a.P1.shape == a.status.shape == a.theta.shape == a.jacobian().shape[:2] == (5, 3)
    assert a.P1[3, 2] == allocate(0.5, 8.0, 1.0).P1
    assert not a.P1.flags.writeable
    assert theta.flags.writeable


@pytest.mark.parametrize("method", ["exact", "exact at once", "analytic", "qp"])
def test_an_answer_stays_when_the_arrays_it_was_asked_with_change(method, monkeypatch):
    if method == "exact at once":
        monkeypatch.setattr(calls, "_PAYS", 1)
    theta, K, T = np.linspace(-1, 1, 4), np.full(4, 12.0), np.ones(4)
    now, step = (np.full(4, 2e5), np.full(4, 3e5)), np.full(4, 4e5)
    limits = TAUT if method == "analytic" else Limits(previous=now, max_step=step)
    first, second = (allocate(theta, K, T, method=method.split()[0], limits=limits) for _ in range(2))
    expected = first.jacobian(), first.stiffness_interval, np.array(first.theta), np.array(first.K_error)
    for array in (theta, K, T, *now, step):
        array *= 0.5
    for a, b in zip(
        (second.jacobian(), second.stiffness_interval, second.theta, second.K_error), expected, strict=True
    ):
        np.testing.assert_array_equal(a, b)


def test_no_targets_have_no_answers(at_once):
    assert allocate(np.zeros(0), 7.5).P1.shape == (0,)


@pytest.mark.parametrize(
    ("theta", "K", "T"), [([0.0, np.nan], 7.5, 0.0), ([0.0, 0.1], -1.0, 0.0), ([0.0, 90.0], 7.5, 0)]
)
def test_a_wrong_array_is_refused_as_ever(theta, K, T, at_once):
    with pytest.raises(InvalidInput, match=r"theta\[1\] = (nan|90)|K = -1"):
        allocate(np.array(theta), K, T)


def test_an_answer_can_be_pickled_and_not_changed():
    a = allocate(0.3, 7.5, 1.0)
    assert pickle.loads(pickle.dumps(a)).stiffness_interval == a.stiffness_interval
    with pytest.raises(AttributeError):
        a.P1 = 0.0


def silent(code):
    """What `code` prints in a fresh process in which warnings are errors."""
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr == ""
    return done.stdout.strip()


ASK = """
import sys, numpy as np
from allocator import allocate, warm_up
a = allocate(np.linspace(-1, 1, N), 7.5, 1.0)
print(format(a.P1[0], ".6g"), format(allocate(-1.0, 7.5, 1.0).P1, ".6g"), ASKED)
"""


def asked(n, last):
    return ASK.replace("N)", f"{n})").replace("ASKED", last)


def test_few_targets_do_not_wait_for_a_compiler():
    one, other, loaded = silent(asked(50, "'numba' in sys.modules")).split()
    assert (one, loaded) == (other, "False")


@pytest.mark.slow
def test_many_targets_are_compiled_for_without_a_word():
    one, other, loaded = silent(asked(calls._PAYS, "'numba' in sys.modules")).split()
    assert (one, loaded) == (other, "True")


@pytest.mark.slow
@pytest.mark.parametrize(
    "broken",
    [
        "import sys; sys.modules['numba'] = sys.modules['numba.extending'] = None",
        "from numba.core.caching import CacheImpl, FunctionCache; CacheImpl._locator_classes = []; "
        "FunctionCache._impl_class._locator_classes = []",
    ],
    ids=["numba is missing", "nowhere to keep what is compiled"],
)
def test_without_compiled_code_the_reference_answers_without_a_word(broken):
    one, other, warm = silent(broken + asked(calls._PAYS, "warm_up()")).split()
    assert (one, warm) == (other, "False")


@pytest.mark.slow
def test_warming_up_says_whether_it_could():
    assert warm_up()
    assert warm_up(joint=AFFINE["mckibben"])
    unequal = AntagonistJoint(PULLEY, TONDU_DMSP_20_400N, SAROSI_DMSP_20_400N, angle_limits=STOPS)
    assert warm_up(joint=unequal)
    assert allocator.warm_up(priority="weighted")
    assert not allocator.warm_up(joint=AFFINE["mckibben"], priority="weighted")
    with pytest.raises(InvalidInput, match="stifness"):
        allocator.warm_up(priority="stifness")
    with pytest.raises(InvalidInput, match="min_force=-1"):
        allocator.warm_up(min_force=-1)


def test_limits_may_be_whole_numbers():
    assert calls.answer(*question(report_joint(), 0.5, 7.5, 1.0, limits=Limits(10, 900))) is not None
    whole, same = (allocate(0.5, 7.5, 1.0, limits=Limits(min_force=F, max_force=90 * F)) for F in (10, 10.0))
    assert (whole.P1, whole.P2) == (same.P1, same.P2)
