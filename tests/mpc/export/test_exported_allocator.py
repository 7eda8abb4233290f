"""The exported allocator says what Python's says, on a PC, under sanitizers and on a Cortex-M4F."""

import subprocess
from dataclasses import replace

import numpy as np
import pytest

from allocator import AntagonistJoint, Lever, PrandtlIshlinskii, report_joint
from allocator.allocation.two_muscles import exact
from allocator.allocation.two_muscles.certificate import assess
from allocator.allocation.two_muscles.problem import Problem
from allocator.joint.limits import Limits
from allocator.muscles.catalogue import SAROSI_DMSP_20_200N, SAROSI_DMSP_20_400N
from allocator.units import BAR, DEG
from mpc.export.entry import export

from ...rigs import toolchain as tools
from ...rigs.needs import needs
from ...rigs.replay import ALLOCATE, ALLOCATION_COLUMNS, STIFFNESS, STIFFNESS_COLUMNS, replayed

pytestmark = pytest.mark.tools

LEVER = Lever(rest_length=0.40, anchor=0.30, lever=0.03, offset=0.0435)
JOINTS = {
    "tondu": report_joint(),
    "sarosi": report_joint(SAROSI_DMSP_20_400N),
    "lever": AntagonistJoint(LEVER, SAROSI_DMSP_20_400N, SAROSI_DMSP_20_200N, angle_limits=(-80 * DEG, 80 * DEG)),
}
SPAN = 5 * BAR
BAD_INPUT, BEYOND_MODEL = -1, -2
# priority, least and greatest force, slew limit: what the targets of one call share
CASES = [
    (priority, least, greatest, slew)
    for priority in ("torque", "stiffness")
    for least in (None, 0.0, 40.0)
    for greatest in (None, 400.0)
    for slew in (False, True)
]


needs_gcc = needs("gcc")
needs_cmake = needs("gcc", "cmake")
needs_arm_gcc = needs(tools.ARM_GCC)
needs_qemu = needs("gcc", tools.ARM_GCC, tools.QEMU)


def readable(problem):
    """What the readable implementation, without compiled kernels, answers (n, 6)."""
    outside = problem.joint.outside_range(problem.theta)
    problem = problem.at(np.clip(problem.theta, *problem.joint.angle_range))
    P1, P2, _ = exact.solve(problem)
    found = assess(problem, P1, P2, outside)
    return np.stack([P1, P2, found.T, found.K, found.status, found.limits], axis=1)


def rows_and_answers(joint, n, seed, dtype=float):
    """Targets (24 n, 9) as the vector program reads them, and Python's answers (24 n, 6)."""
    rng = np.random.default_rng(seed)
    rows, answers = [], []
    for priority, least, greatest, slew in CASES:
        theta, K, T = rng.uniform(-2.5, 2.5, n), rng.uniform(0.1, 14, n), rng.normal(0, 6, n)
        P = rng.uniform(-0.3 * BAR, 5.3 * BAR, (2, n))  # also from outside the supply
        step = rng.choice([0.02 * BAR, 0.3 * BAR, 2 * BAR], n)
        theta[: n // 10], K[: n // 10], T[: n // 20] = (
            rng.choice([0.0, *0.999 * np.array(joint.angle_range)], n // 10),
            6.0,
            0.0,
        )
        K[-3:], T[-3:] = (1e-3, 50.0, 1e4), (1e6, -1e6, 0.0)  # absurd, but not senseless
        theta, K, T, P, step = (a.astype(dtype).astype(float) for a in (theta, K, T, P, step))
        limits = Limits(least, greatest, previous=(P[0], P[1]), max_step=step) if slew else Limits(least, greatest)
        answers.append(readable(Problem(joint, theta, K, T, priority, limits=limits)))
        low, high = -np.inf if least is None else least, np.inf if greatest is None else greatest
        step = step if slew else np.full(n, np.inf)
        columns = theta, K, T, low + 0 * K, high + 0 * K, P[0], P[1], step, (priority == "stiffness") + 0 * K
        rows.append(np.stack(columns, axis=1))
    return np.concatenate(rows), np.concatenate(answers)


def answered(program, rows, run=tools.run):
    return replayed(program, rows, ALLOCATION_COLUMNS, run)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    made = {}

    def get(name, precision):
        if (name, precision) not in made:
            out = tmp_path_factory.mktemp("exported") / f"{name}-{precision}"
            made[name, precision] = export(out, joint=JOINTS[name], what="allocate", precision=precision)
        return made[name, precision]

    return get


@needs_gcc
@pytest.mark.parametrize("name", JOINTS)
def test_a_hundred_thousand_targets_get_python_s_pressures_statuses_and_limits(name, exported):
    rows, wanted = rows_and_answers(JOINTS[name], 4200 if name == "tondu" else 1000, seed=1)
    got = answered(tools.compiled(exported(name, "double"), ALLOCATE, "vectors"), rows)
    assert len(rows) > (100_000 if name == "tondu" else 20_000)
    np.testing.assert_array_equal(got[:, 4:], wanted[:, 4:])
    assert np.abs(got[:, :2] - wanted[:, :2]).max() < 1e-12 * SPAN
    scale = 10 + np.abs(rows[:, [2, 1]])  # Python's T and K are the targets plus their errors
    assert (np.abs(got[:, 2:4] - wanted[:, 2:4]) < 1e-12 * scale).all()
    assert {0, 2, 3, 7, 8, 10} <= set(wanted[:, 4])  # what the priority "torque" can meet with; the other adds 1


@needs_gcc
@pytest.mark.parametrize("name", ["tondu", "sarosi"])
def test_single_precision_keeps_pressures_to_a_hundred_thousandth_of_the_supply(name, exported):
    rows, wanted = rows_and_answers(JOINTS[name], 400, seed=2, dtype=np.float32)
    got = answered(tools.compiled(exported(name, "single"), ALLOCATE, "vectors"), rows)
    assert np.abs(got[:, :2] - wanted[:, :2]).max() < 1e-5 * SPAN
    assert (got[:, 4] != wanted[:, 4]).mean() < 1e-3  # where an error lies between both precisions' idea of none


@needs_gcc
@pytest.mark.parametrize("precision", ["double", "single"])
def test_what_makes_no_sense_gets_a_status_and_pressures_within_the_supply(precision, exported):
    good = np.array([0.1, 7.5, 1.0, 0.0, np.inf, 2 * BAR, 2 * BAR, 1 * BAR, 0.0])
    rows = np.tile(good, (60, 1))
    wrong = [(i, value) for i in range(8) for value in (np.nan, np.inf, -np.inf)]
    wrong += [(0, 30.0), (0, -30.0), (1, 0.0), (1, -2.0), (3, -5.0), (4, 0.0), (4, -1.0), (7, 0.0), (7, -1.0)]
    fine = {(3, -np.inf), (4, np.inf), (7, np.inf)}  # no limit
    for row, (i, value) in zip(rows, wrong, strict=False):
        row[i] = value
    rows = rows[: len(wrong)]
    bad = np.array([pair not in fine for pair in wrong])
    got = answered(tools.compiled(exported("tondu", precision), ALLOCATE, "vectors", *tools.SANITISED), rows)
    np.testing.assert_array_equal(got[:, 4] == BAD_INPUT, bad)
    assert ((got[:, :2] >= 0) & (got[:, :2] <= SPAN)).all()


@needs_gcc
def test_pressures_beyond_the_muscle_model_are_said_to_be_so(exported):
    rows = np.tile([0.1, 7.5, 1.0, 0.0, np.inf, 9 * BAR, 9 * BAR, 0.1 * BAR, 0.0], (1, 1))
    got = answered(tools.compiled(exported("tondu", "double"), ALLOCATE, "vectors"), rows)
    assert got[0, 4] == BEYOND_MODEL


@needs_gcc
@pytest.mark.parametrize(("name", "precision"), [("tondu", "double"), ("tondu", "single"), ("lever", "double")])
def test_no_sanitizer_finds_anything_on_targets_of_every_size(name, precision, exported):
    rows, _ = rows_and_answers(JOINTS[name], 20, seed=3)
    rng = np.random.default_rng(4)
    wild = rng.choice([0.0, np.nan, np.inf, -np.inf, 1e-300, 1e300, -1e300, 1.0, 3e5, -3e5], (5000, 9))
    program = tools.compiled(exported(name, precision), ALLOCATE, "vectors", *tools.SANITISED)
    assert np.isfinite(answered(program, np.concatenate([rows, wild]))[:, :2]).all()


@needs_qemu
@pytest.mark.parametrize("name", ["tondu", "lever"])
def test_a_cortex_m4f_gives_the_pc_s_answers(name, exported):
    rows, _ = rows_and_answers(JOINTS[name], 40, seed=5, dtype=np.float32)
    directory = exported(name, "single")
    there = answered(tools.compiled_for_cortex(directory, ALLOCATE, "m4.elf"), rows, tools.run_on_cortex)
    here = answered(tools.compiled(directory, ALLOCATE, "vectors", "-O2", "-ffp-contract=off"), rows)
    assert np.abs(there - here)[:, :2].max() < 1e-6 * SPAN
    assert (there[:, 4] != here[:, 4]).mean() < 1e-3


@needs_arm_gcc
@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("name", JOINTS)
def test_the_allocator_takes_less_than_8_kib_on_a_cortex_m4f(name, precision, exported):
    sizes = tools.sizes(exported(name, precision))
    felt = sum(size.code for file, size in sizes.items() if "stiffness" in str(file))  # linked only if called
    code = sum(size.code for size in sizes.values())
    assert 0 < felt < 4 * 1024
    assert code - felt <= 8 * 1024
    assert sum(size.memory for size in sizes.values()) == 0


@needs_cmake
def test_one_command_exports_one_builds_and_the_demonstration_prints_python_s_numbers(exported):
    directory = exported("tondu", "double")
    commands = ["cmake", "-S", ".", "-B", "build"], ["cmake", "--build", "build"]
    for command in commands:
        subprocess.run(command, cwd=directory, check=True, capture_output=True)
    printed = tools.run(directory / "build" / "demonstration")
    assert printed in (directory / "README.md").read_text()
    assert printed.count("P1") == 9


LOOPS = PrandtlIshlinskii((0.6, 0.15, 0.15, 0.1), (1 * DEG, 2.5 * DEG, 5 * DEG), base=0.2)
LOSSY = {
    "tondu": replace(JOINTS["tondu"], hysteresis=LOOPS),
    "sarosi": replace(JOINTS["sarosi"], hysteresis=LOOPS),
    "lever": replace(JOINTS["lever"], friction=0.1),
    "unknown volumes": AntagonistJoint(LEVER, *2 * (replace(SAROSI_DMSP_20_400N, inner_radius=None),), friction=0.1),
}


def stiffnesses(joint, rows):
    """Python's terms of the stiffness (n, 5), those of unknown volumes NaN."""
    theta, P1, P2, A = rows.T
    K = joint.stiffness(theta, P1, P2)
    felt, work = (
        np.array([f(*row[:3], amplitude=float(row[3])) for row in rows]) for f in (joint.stiffness, joint.loop_work)
    )
    gas = [np.full(len(rows), np.nan)] * 2
    if joint.agonist.volume_known:
        gas = [joint.stiffness(theta, P1, P2, valves) - K for valves in ((True, False), (False, True))]
    return np.stack([K, felt - K, *gas, work / (np.pi * A**2)], axis=1)


@needs_gcc
@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("name", LOSSY)
def test_the_felt_stiffness_in_c_is_python_s(name, precision, tmp_path):
    joint = LOSSY[name]
    out = export(tmp_path / "c", joint=joint, what="allocate", precision=precision)
    left, right = joint.angle_range
    grid = np.meshgrid(np.linspace(left, right, 9) * 0.95, *2 * (np.linspace(0.5, 4.5, 7) * BAR,),
                       np.array([0.2, 1, 2, 4, 7, 20]) * DEG)  # fmt: skip
    rows = np.stack([axis.ravel() for axis in grid], axis=1).astype(np.float32).astype(float)
    got = replayed(tools.compiled(out, STIFFNESS, "vectors", *tools.SANITISED), rows, STIFFNESS_COLUMNS)
    wanted = stiffnesses(joint, rows)
    assert (np.isnan(wanted[:, 2:4]) == (name == "unknown volumes")).all()
    near = 1e-12 if precision == "double" else 2e-5
    np.testing.assert_allclose(got, wanted, rtol=near, atol=near * np.abs(wanted[:, 0]).max())
    bad = np.tile(rows[0], (5, 1))
    bad[0, 0], bad[1, 1], bad[2, 2], bad[3, 3], bad[4, 3] = np.nan, np.inf, np.nan, 0.0, -0.1
    assert np.isnan(replayed(out.parent / "c" / "vectors", bad, STIFFNESS_COLUMNS)).all()
