"""The exported controller of an arm does what Python's does: the same statuses, verdicts and commands."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from allocator import InvalidInput
from allocator.units import BAR, DEG
from mpc import Arm, Compensation, KalmanObserver, PlanStatus, Rung, TrackingMPC, Weights
from mpc.export import export, export_controller_fmu
from mpc.export.controller.certificate import certificate
from mpc.model.faults import FrozenSensors, Leak, SilentSensors, StuckValve, SupplyDrop
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.model.real import RealArm
from mpc.observer.filter import CALM_NOISE
from mpc.tracking.qp.solvers import Riccati
from mpc.trials.motions.arm_trajectories import circle, reach

from ...rigs import toolchain as tools
from ...rigs.fmus import Stepped
from ...rigs.needs import needs
from ...rigs.replay import CONTROL, answered, in_both_precisions, record, replayed

pytestmark = pytest.mark.tools

SPAN, ARM = 5 * BAR, Arm.machine("arm26")
U, VERDICT, EXCESS, MOVED, VERDICTS = slice(0, 6), slice(6, 8), slice(8, 10), slice(10, 13), slice(13, 21)
STATUS, RUNG = 6, 7  # columns of the answers
COLUMNS, EXCESS_AND_MOVED = 21, slice(2, 7)  # the latter after the commands
SIZES = {"joints": 2, "muscles": 6}
FAULTS = (
    SilentSensors(3.0, 3.05, (0,), **SIZES),
    SilentSensors(6.0, 6.5, (1,), **SIZES),
    FrozenSensors(8.0, 8.4, (4,), **SIZES),
    StuckValve(10.0, 10.5, 1, **SIZES),
    SupplyDrop(12.0, 12.3, **SIZES),
    Leak(13.0, 13.5, 2, **SIZES),
    FrozenSensors(15.0, 15.6, (0,), **SIZES),
    SilentSensors(17.0, 18.2, (0, 4, 5, 9), **SIZES),
)
GAINS = (1.05, 0.95, 1.0, 1.1, 0.92, 1.03)

needs_gcc = needs("gcc")
needs_arm_gcc = needs(tools.ARM_GCC)
needs_qemu = needs("gcc", tools.ARM_GCC, tools.QEMU)


def pair(arm, N, known, *, compiled=True, **settings):
    return (
        TrackingMPC(arm, N=N, weights=Weights.calm(), compensation=known, compiled=compiled, **settings),
        KalmanObserver(arm, 0.01, CALM_NOISE, known, compiled=False),
    )


def real(known, arm=ARM, **effects):
    noisy = {"encoder": 0.02 * DEG, "pressure_noise": 0.02 * BAR, "force_gains": GAINS}
    return RealArm.of(arm, known, **(noisy | effects))


def recorded(*loop, failing=()):
    """Samples and answers of a loop whose QP solver may exchange nothing at the steps `failing`."""
    usual = loop[1]._solve

    def fails(k):
        loop[1]._solve = Riccati(exchanges=0) if k in failing else usual
        return k in failing

    done = record(*loop, fails)
    return done.samples, done.answers


def assert_alike(got, wanted, near=1e-8):
    np.testing.assert_array_equal(got[:, VERDICT], wanted[:, VERDICT])
    np.testing.assert_array_equal(got[:, VERDICTS], wanted[:, VERDICTS])
    assert np.abs(got[:, U] - wanted[:, U]).max() < near * SPAN


@pytest.fixture(scope="module", params=[False, True], ids=["no gas", "gas"])
def faulty_loop(request):
    """2 000 steps on an arm with other muscles, friction, faults, and a solver that gives up now and then."""
    arm = replace(ARM, gas=request.param)
    known = Compensation(Friction.of_width(arm, 2 * DEG), dead_time=0.02, dead_band=0.05 * BAR)
    controller, observer = pair(arm, 10, known)
    loop = real(known, arm, faults=FAULTS), controller, observer, circle(arm, turns=9.5)
    return controller, observer, *recorded(*loop, failing={*range(300, 303), *range(1400, 1420), 1900})


@pytest.fixture(scope="module")
def exported(faulty_loop, tmp_path_factory):
    return in_both_precisions(*faulty_loop[:2], tmp_path_factory.mktemp("exported"))


@needs_gcc
@pytest.mark.compiles
def test_two_thousand_steps_with_faults_have_python_s_statuses_verdicts_and_commands(faulty_loop, exported):
    _, _, samples, wanted = faulty_loop
    got = replayed(tools.compiled(exported["double"], CONTROL, "vectors"), samples, COLUMNS)
    assert len(wanted) == 2000
    assert {PlanStatus.UNSOLVED, PlanStatus.NO_MEASUREMENT, PlanStatus.BLIND} <= set(wanted[:, STATUS])
    assert {Rung.QP, Rung.SOFTENED, Rung.HOLD} <= set(wanted[:, RUNG])
    assert_alike(got, wanted)
    np.testing.assert_allclose(got[:, EXCESS], wanted[:, EXCESS], atol=1e-6)
    np.testing.assert_allclose(got[:, MOVED], wanted[:, MOVED], atol=1e-9)


@needs_gcc
@pytest.mark.compiles
def test_single_precision_keeps_commands_to_a_thousandth_of_the_supply_in_99_percent_of_samples(faulty_loop, exported):
    _, _, samples, wanted = faulty_loop
    got = replayed(tools.compiled(exported["single"], CONTROL, "vectors"), samples, COLUMNS)
    np.testing.assert_array_equal(got[:, VERDICT], wanted[:, VERDICT])
    apart = np.abs(got[:, U] - wanted[:, U]).max(axis=1) / SPAN
    assert np.quantile(apart, 0.99) < 1e-3
    assert apart.max() < 2e-3  # after a second and more without readings


@needs_gcc
@pytest.mark.compiles
@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.filterwarnings("ignore::mpc.tracking.preview.BadNumbers")
def test_garbage_is_answered_as_in_python_within_supply_and_slew_and_no_sanitizer_finds_anything(
    precision, faulty_loop, exported
):
    controller, observer, samples, _ = faulty_loop
    rng, samples = np.random.default_rng(0), samples[290:420].copy()
    samples[:, 8] = 0.0  # the solver never gives up
    garbage = samples[rng.choice(len(samples), 300)]
    wild = rng.choice([0.0, np.nan, np.inf, -np.inf, 1e-300, 1e300, -1e300, 0.5, 3e5], (300, 8))
    garbage[:, :8] = np.where(rng.random((300, 8)) < 0.3, wild, garbage[:, :8])
    garbage[::7, 9:] = rng.choice([np.nan, 0.1, 5.0, 1e9, -3.0], garbage[::7, 9:].shape)
    rows = np.concatenate([np.full((2, samples.shape[1]), np.nan), samples, garbage, samples])
    program = tools.compiled(exported[precision], CONTROL, "vectors", *tools.SANITISED)
    got = replayed(program, rows, COLUMNS)
    u = got[:, U]
    assert (got[:2, STATUS] == PlanStatus.BAD_INPUT).all()
    assert ((u >= 0) & (u <= SPAN)).all()
    assert np.abs(np.diff(u[2:], axis=0)).max() <= 5 * BAR * 0.01 * (1 + 1e-4)
    if precision == "double":
        wanted = answered(controller, observer, rows)
        unlike = (np.delete(got[:, 6:], EXCESS_AND_MOVED, axis=1) != wanted[:, 6:]).any(axis=1)
        gas = controller.plant.gas is not None  # an arm that is not seen flies: rounding decides what is proved of it
        assert unlike.sum() <= (4 if gas else 0)
        assert (wanted[unlike, STATUS] == PlanStatus.NO_MEASUREMENT).all()
        assert np.abs(u - wanted[:, U]).max() < (1e-6 if gas else 1e-8) * SPAN


@needs_gcc
@pytest.mark.compiles
def test_a_loop_that_rests_rests_in_c_at_the_same_samples_with_the_same_commands(tmp_path):
    known = Compensation(dead_time=0.02, dead_band=0.1 * BAR)
    controller, observer = pair(ARM, 10, known)
    samples, wanted = recorded(
        real(known, friction=Friction.of_width(ARM, 2 * DEG)), controller, observer, reach(ARM, rest=6.0)
    )
    directory = export(tmp_path / "c", controller=controller, observer=observer)
    program = tools.compiled(directory, CONTROL, "vectors", *tools.QUICK)
    assert 0.1 < (wanted[:, STATUS] == PlanStatus.RESTING).mean() < 0.9
    assert_alike(replayed(program, samples, COLUMNS), wanted)


@needs("gcc", tools.ARM_GCC)
@pytest.mark.slow
@pytest.mark.parametrize("gas", [None, True], ids=["no gas", "gas"])
def test_friction_of_each_joint_and_old_readings_are_python_s_in_c(gas, tmp_path):
    slips = tuple(
        MaxwellSlip.of_width(ARM, w * DEG, steps, joint=i)
        for i, (w, steps) in enumerate([(2, (0.01, 0.04)), (3, (0.02,))])
    )
    known, arm = Compensation(frictions=slips, dead_time=0.02, reading_age=0.03), replace(ARM, gas=gas)
    controller, observer = pair(arm, 6, known)
    faults = (SilentSensors(0.5, 0.55, (0,), **SIZES), FrozenSensors(0.9, 1.2, (5,), **SIZES))
    plant = replace(real(known, faults=faults), nominal=arm)
    samples, wanted = recorded(plant, controller, observer, circle(ARM, turns=0.8))
    directory = export(tmp_path / "c", controller=controller, observer=observer)
    got = replayed(tools.compiled(directory, CONTROL, "vectors", *tools.SANITISED), samples, COLUMNS)
    assert_alike(got, wanted)
    assert 0.7 < tools.stack(directory, *tools.CORTEX_M4F) / certificate(controller, single=False).stack <= 1
    printed = tools.run(tools.compiled(directory, Path("main.c"), "demonstration", *tools.SANITISED))
    assert printed in (directory / "README.md").read_text()


@needs_gcc
@pytest.mark.compiles
@pytest.mark.parametrize(
    "settings", [{"min_force": 40.0}, {"iterations": 2, "blocks": (1, 2, 3)}], ids=["taut", "blocks"]
)
def test_limits_that_bind_and_other_settings_are_python_s_in_c(settings, tmp_path):
    """A motion to the ends of the ranges, which the supply cannot follow."""
    controller, observer = pair(ARM, 6, Compensation(dead_time=0.02), **settings)
    asked = circle(ARM, frequency=3.0, turns=2.0, size=3.0)
    samples, wanted = recorded(ARM, controller, observer, asked, failing={*range(20, 60)})
    assert {Rung.QP, Rung.SOFTENED} <= set(wanted[:, RUNG])
    directory = export(tmp_path / "c", controller=controller, observer=observer)
    assert_alike(replayed(tools.compiled(directory, CONTROL, "vectors", *tools.QUICK), samples, COLUMNS), wanted)


@needs_gcc
@pytest.mark.slow
def test_the_demonstration_of_three_joints_and_seven_muscles_prints_python_s_numbers(tmp_path):
    controller, observer = pair(Arm.machine("leg37"), 4, Compensation(), compiled=False)
    directory = export(tmp_path / "c", controller=controller, observer=observer, what="mpc")
    printed = tools.run(tools.compiled(directory, Path("main.c"), "demonstration", *tools.QUICK))
    assert printed in (directory / "README.md").read_text()
    assert printed.count("rung 0") == 10


@needs_gcc
@pytest.mark.compiles
def test_the_fmu_of_the_controller_gives_python_s_commands(faulty_loop, tmp_path):
    controller, observer, samples, wanted = faulty_loop
    path = export_controller_fmu(tmp_path / "arm.fmu", controller, observer)
    ahead, commands = 2 * (controller.ahead + 1), [f"u{i}" for i in range(1, 7)]
    names = "theta1", "theta2", *(f"P{i}" for i in range(1, 7))
    steps = 300  # up to the first sample in which the solver gives up
    with Stepped(path, tmp_path / "unpacked", controller.dt) as stepped:
        for sample, answer in zip(samples[:steps], wanted, strict=False):
            rows = {"theta_ref": sample[9 : 9 + ahead], "K_ref": sample[9 + ahead :]}
            stepped.set(**dict(zip(names, sample, strict=False)), **rows)
            stepped.step()
            np.testing.assert_allclose(stepped.get(*commands), answer[U], atol=1e-8 * SPAN)
            assert stepped.get("status", "rung") == answer[VERDICT].tolist()


@needs_qemu
@pytest.mark.compiles
def test_a_cortex_m4f_gives_the_pc_s_commands(faulty_loop, exported):
    samples = faulty_loop[2][:60]
    program = tools.compiled_for_cortex(exported["single"], CONTROL, "m4.elf")
    there = replayed(program, samples, COLUMNS, runner=tools.run_on_cortex)
    here = replayed(tools.compiled(exported["single"], CONTROL, "vectors"), samples, COLUMNS)
    np.testing.assert_array_equal(there[:, VERDICT], here[:, VERDICT])
    assert np.abs(there[:, U] - here[:, U]).max() < 1e-3 * SPAN


@needs_arm_gcc
@pytest.mark.compiles
def test_ten_samples_ahead_fit_into_a_microcontroller(faulty_loop, exported):
    """Without gas, into 62 KiB of flash and as much memory in single precision."""
    controller = faulty_loop[0]
    most = {"single": 62, "double": 102} if controller.plant.gas is None else {"single": 66, "double": 109}
    for precision, kibibytes in most.items():
        size = tools.linked_size(exported[precision])
        assert max(size.code, size.memory) <= kibibytes * 1024
        stack = tools.stack(exported[precision], *tools.CORTEX_M4F)
        assert 0.7 < stack / certificate(controller, precision == "single").stack <= 1


@pytest.mark.parametrize(
    ("arm", "why"),
    [
        (replace(ARM, endpoint=ARM.bodies.endpoint), "not that of a hand"),
    ],
)
def test_arms_that_c_does_not_know_are_refused_with_the_reason(arm, why, tmp_path):
    controller = TrackingMPC(arm, N=4, compiled=False)
    with pytest.raises(InvalidInput, match=why):
        export(tmp_path / "c", controller=controller)
    assert not (tmp_path / "c").exists()
