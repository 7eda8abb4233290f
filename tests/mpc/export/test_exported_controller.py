"""The exported controller does what Python's does: the same statuses and rungs, the same commands."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from allocator import InvalidInput
from allocator.joint.antagonist import report_joint
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR, DEG
from mpc import Compensation, KalmanObserver, PlanStatus, Plant, RealPlant, Reference, Rung, TrackingMPC, Weights, sine
from mpc.export import export
from mpc.export.controller.certificate import certificate
from mpc.export.controller.sizes import check_pair
from mpc.model.faults import Fault, FrozenSensors, Leak, SilentSensors, StuckValve, SupplyDrop, WrongReadings
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.observer.gating import Verdict
from mpc.repetition.update import Update
from mpc.tracking.compiled.structured_qp.structured import StructuredQP
from mpc.tracking.qp.solvers import Riccati
from mpc.tracking.qp.step import ReadableQPStep
from mpc.trials.motions.corrections import Correction, Owner
from mpc.trials.motions.trajectories import point_to_point

from ...rigs import toolchain as tools
from ...rigs.needs import needs
from ...rigs.replay import CONTROL, in_both_precisions, record, replayed

pytestmark = pytest.mark.tools

SPAN = 5 * BAR
STANDARD = RealPlant.standard()
ELASTIC = MaxwellSlip((0.3, 0.2, -0.1), (0.01, 0.04, np.inf), 0.5, elastic=True)
U, STATUS, RUNG, EXCESS, MOVED, ANGLE = slice(0, 2), 2, 3, slice(4, 6), slice(6, 9), 9  # columns of the answers
BAD_INPUT = -1
FAULTS = (
    SilentSensors(3.0, 3.05, (0,)),
    SilentSensors(6.0, 6.5, (0,)),
    FrozenSensors(8.0, 8.4, (2,)),
    StuckValve(10.0, 10.5, 1),
    SupplyDrop(12.0, 12.3),
    Leak(13.0, 13.5, 2),
    FrozenSensors(15.0, 15.6, (0,)),
    SilentSensors(17.0, 18.2, (0, 2, 3)),
)


needs_gcc = needs("gcc")
needs_arm_gcc = needs(tools.ARM_GCC)
needs_qemu = needs("gcc", tools.ARM_GCC, tools.QEMU)


def recorded(process, controller, observer, reference, failing=()):
    """A record of the loop in which the controller's solver may exchange nothing at the steps `failing`."""

    usual = controller._solve

    def fails(k):
        controller._solve = Riccati(exchanges=0) if k in failing else usual
        return k in failing

    done = record(process, controller, observer, reference, fails)
    return done.samples, done.answers


def pair(plant, N, compensation=None, *, compiled=True, **settings):
    known = {} if compensation is None else {"compensation": compensation}
    return (
        TrackingMPC(plant, N=N, compiled=compiled, **known, **settings),
        KalmanObserver(plant, 0.01, compiled=compiled, **known),
    )


@pytest.fixture(scope="module")
def faulty_loop():
    """2 000 steps on a real plant with faults, and a solver that gives up now and then."""
    process = replace(RealPlant.standard(torque_profile=((9.0, 1.0),)), faults=FAULTS)
    controller, observer = pair(process.nominal, 10, process.known(), weights=Weights.calm())
    failing = {*range(300, 303), *range(1400, 1420), 1900}
    reference = sine(K=5.5, duration=20.0)
    return controller, observer, *recorded(process, controller, observer, reference, failing)


@pytest.fixture(scope="module")
def exported(faulty_loop, tmp_path_factory):
    return in_both_precisions(*faulty_loop[:2], tmp_path_factory.mktemp("exported"))


@needs_gcc
def test_two_thousand_steps_with_faults_have_python_s_statuses_rungs_and_commands(faulty_loop, exported):
    _, _, samples, wanted = faulty_loop
    got = replayed(tools.compiled(exported["double"], CONTROL, "vectors"), samples)
    assert len(wanted) == 2000
    assert {PlanStatus.UNSOLVED, PlanStatus.NO_MEASUREMENT, PlanStatus.BLIND} <= set(wanted[:, STATUS])
    assert {Rung.QP, Rung.SOFTENED, Rung.HOLD} <= set(wanted[:, RUNG])
    np.testing.assert_array_equal(got[:, [STATUS, RUNG]], wanted[:, [STATUS, RUNG]])
    assert np.abs(got[:, U] - wanted[:, U]).max() < 1e-8 * SPAN
    np.testing.assert_allclose(got[:, EXCESS], wanted[:, EXCESS], atol=1e-6)
    np.testing.assert_allclose(got[:, MOVED], wanted[:, MOVED], atol=1e-9)


@needs_gcc
def test_single_precision_keeps_commands_to_a_thousandth_of_the_supply(faulty_loop, exported):
    _, _, samples, wanted = faulty_loop
    got = replayed(tools.compiled(exported["single"], CONTROL, "vectors"), samples)
    np.testing.assert_array_equal(got[:, [STATUS, RUNG]], wanted[:, [STATUS, RUNG]])
    assert np.abs(got[:, U] - wanted[:, U]).max() < 1e-3 * SPAN


@needs_gcc
def test_a_corrected_motion_of_a_file_is_played_in_c_as_in_python(faulty_loop, exported, tmp_path):
    """One update of a learner between two repetitions; the corrected reference comes from its file."""
    controller, observer, *_ = faulty_loop
    process, motion = STANDARD, sine(K=5.5, frequency=0.5, duration=6.0).resampled(0.01)
    before, _ = recorded(process, controller, observer, motion)
    error = np.append(motion.theta[:-1] - before[:, 0], 0.0)[:, None]
    shift = Update(0.7, 0.03, 4.0, 0.9, ()).applied(np.zeros_like(error), error, 0.01)[:, 0]
    owner = Owner.of(process.nominal, controller.compensation)
    Correction(motion, shift, owner).save(tmp_path / "sine.correction.toml")
    played = Correction.load(tmp_path / "sine.correction.toml").reference
    samples, wanted = recorded(process, controller, observer, played)
    got = replayed(tools.compiled(exported["double"], CONTROL, "vectors"), samples)
    np.testing.assert_array_equal(got[:, [STATUS, RUNG]], wanted[:, [STATUS, RUNG]])
    assert np.abs(got[:, U] - wanted[:, U]).max() < 1e-8 * SPAN
    first, second = (np.sqrt(np.mean((motion.theta[:-1] - read[:, 0]) ** 2)) for read in (before, samples))
    assert second < 0.8 * first


BINDING = pytest.mark.parametrize(
    ("settings", "angle", "K"),
    [
        ({}, 140 * DEG, 12.0),  # beyond the joint range, and stiffer than can be
        ({"min_force": 60.0}, 60 * DEG, 1.0),  # less stiff than can be
        ({"blocks": (1, 1, 2, 3, 5), "iterations": 2}, 100 * DEG, 9.5),
    ],
    ids=["joint range", "taut muscles", "blocked moves, two QPs"],
)


def limited(directory, precision, settings, angle, K):
    """What the exported controller and Python's answer along a reference that cannot be followed."""
    plant = Plant()
    controller, observer = pair(plant, 12, **settings)
    reference = sine(amplitude=angle, K=K, K_amplitude=0.0, frequency=0.5, duration=1.4, ramp=0.3)
    samples, wanted = recorded(plant, controller, observer, reference, failing={60, 61})
    assert wanted[:, MOVED].max() > 0.1
    made = export(directory, controller=controller, observer=observer, precision=precision)
    return replayed(tools.compiled(made, CONTROL, "vectors", *tools.QUICK), samples), wanted


@needs_gcc
@BINDING
def test_limits_that_bind_bind_in_c_as_they_do_in_python(settings, angle, K, tmp_path):
    got, wanted = limited(tmp_path / "c", "double", settings, angle, K)
    np.testing.assert_array_equal(got[:, [STATUS, RUNG]], wanted[:, [STATUS, RUNG]])
    assert np.abs(got[:, U] - wanted[:, U]).max() < 1e-8 * SPAN


@needs_gcc
@BINDING
def test_single_precision_refuses_few_answers_where_limits_bind_and_commands_the_same(settings, angle, K, tmp_path):
    got, wanted = limited(tmp_path / "c", "single", settings | {"weights": Weights.calm()}, angle, K)
    differs = (got[:, [STATUS, RUNG]] != wanted[:, [STATUS, RUNG]]).any(axis=1)
    assert differs.mean() <= 0.03
    assert (got[differs, STATUS] == PlanStatus.UNSOLVED).all()
    assert (got[differs, RUNG] == Rung.SOFTENED).all()
    apart = np.abs(got[:, U] - wanted[:, U]).max(axis=1) / SPAN
    assert np.quantile(apart, 0.98) < 1e-3
    assert apart.max() < 2e-3  # where a plan turns from one limit to the next, rounding the readings counts 40-fold


@needs_gcc
@pytest.mark.parametrize(
    ("blocks", "proved", "near"),
    [(None, 0.99, 1e-3), ((1, 1, 1, 2, 3, 4, 6, 12), 0.9, 0.1)],
    ids=["free moves", "blocked moves"],
)
def test_single_precision_proves_sharp_weights_over_a_long_horizon(blocks, proved, near, tmp_path):
    """Its gradients are rounded to more than the curvature of the weakest direction allows; the cost-to-go of a long
    block of commands is rounded by as much as that curvature.
    """
    plant, dt = Plant(), 0.02
    controller = TrackingMPC(plant, dt, N=30, blocks=blocks, compiled=False)
    observer = KalmanObserver(plant, dt, compiled=False)
    samples, wanted = recorded(STANDARD, controller, observer, sine(K=5.5, duration=4.0))
    made = export(tmp_path / "c", controller=controller, observer=observer, precision="single")
    got = replayed(tools.compiled(made, CONTROL, "vectors", *tools.QUICK), samples)
    assert (wanted[:, STATUS] == PlanStatus.OPTIMAL).all()
    assert (got[:, STATUS] == PlanStatus.OPTIMAL).mean() >= proved
    assert np.abs(got[:, U] - wanted[:, U]).max() < near * SPAN


@needs_gcc
@pytest.mark.parametrize("precision", ["double", "single"])
def test_no_sanitizer_finds_anything_and_all_commands_keep_supply_and_slew(precision, faulty_loop, exported):
    samples = faulty_loop[2][290:420].copy()
    rng = np.random.default_rng(3)
    wild = rng.choice([0.0, np.nan, np.inf, -np.inf, 1e-300, 1e300, -1e300, 0.5, 3e5], (300, 3))
    hit = rng.choice(len(samples), 300)
    garbage = samples[hit]
    garbage[:, :3] = np.where(rng.random((300, 3)) < 0.5, wild, garbage[:, :3])
    garbage[::7, 4:] = rng.choice([np.nan, 0.1, 5.0, 1e9, -3.0], garbage[::7, 4:].shape)
    program = tools.compiled(exported[precision], CONTROL, "vectors", *tools.SANITISED)
    nothing = np.full((2, samples.shape[1]), np.nan)
    got = replayed(program, np.concatenate([nothing, samples, garbage, samples]))
    u = got[:, U]
    assert (got[:2, STATUS] == BAD_INPUT).all()
    assert ((u >= 0) & (u <= SPAN)).all()
    assert np.abs(np.diff(u[2:], axis=0)).max() <= 5 * BAR * 0.01 * (1 + 1e-4)


@dataclass(frozen=True)
class Wild(Fault):
    """Sensors half of whose readings are wild."""

    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(3))

    def read(self, y, previous):
        wild = self.rng.choice([0.0, np.nan, np.inf, -np.inf, 1e-300, 1e300, -1e300, 0.5, 3e5], y.shape)
        return np.where(self.rng.random(y.shape) < 0.5, wild, y)


@needs_gcc
@pytest.mark.parametrize(
    "faults",
    [(Wild(2.9, 5.9),), (SupplyDrop(3.0, supply=1.5 * BAR), WrongReadings(5.0, 5.5, (0,), 0.9))],
    ids=["from wild ones", "from wrong ones at a low supply"],
)
def test_good_readings_lead_back(faults, faulty_loop, exported):
    process = replace(RealPlant.standard(), faults=faults)
    samples, wanted = recorded(process, *faulty_loop[:2], sine(K=5.5, duration=9.0))
    got = replayed(tools.compiled(exported["double"], CONTROL, "vectors", *tools.SANITISED), samples)
    lost = got[:, ANGLE] > Verdict.ACCEPTED
    assert lost[290:590].any()
    assert not lost[650:].any()
    assert (got[-50:, RUNG] == Rung.QP).all()
    np.testing.assert_array_equal(got[:, [STATUS, RUNG, ANGLE]], wanted[:, [STATUS, RUNG, ANGLE]])


@pytest.fixture(scope="module")
def resting_loop():
    """A joint that is moved, rests, is pushed and rests again, on the real plant without and with its friction."""
    process = RealPlant.standard(torque_profile=((5.0, 1.0),))
    controller, observer = pair(process.nominal, 10, process.known(), weights=Weights.calm())
    move = point_to_point(rest=8.0).resampled(0.01)
    move = Reference(move.t[: 10_00 + 1], move.theta[300 : 1300 + 1], move.K[: 10_00 + 1])
    return (
        controller,
        observer,
        [recorded(real, controller, observer, move) for real in (process, replace(process, friction=Friction()))],
    )


@needs_gcc
@pytest.mark.parametrize(("precision", "near"), [("double", 1e-8), ("single", 1e-3)])
def test_a_loop_that_rests_rests_in_c_at_the_same_samples_with_the_same_commands(
    precision, near, resting_loop, tmp_path
):
    controller, observer, records = resting_loop
    directory = export(tmp_path / "c", controller=controller, observer=observer, precision=precision)
    program = tools.compiled(directory, CONTROL, "vectors", *tools.SANITISED)
    for samples, wanted in records:
        got = replayed(program, samples)
        resting = wanted[:, STATUS] == PlanStatus.RESTING
        assert 0.2 < resting.mean() < 0.9
        assert (np.abs(np.diff(resting.astype(int))).sum()) > 2  # it comes to rest and leaves it again
        np.testing.assert_array_equal(got[:, [STATUS, RUNG]], wanted[:, [STATUS, RUNG]])
        assert np.abs(got[:, U] - wanted[:, U]).max() < near * SPAN


@needs_gcc
@pytest.mark.slow
@pytest.mark.parametrize(
    ("friction", "age", "precision", "near"),
    [
        (STANDARD.friction, 0.03, "double", 1e-8),
        (ELASTIC, 0.0, "double", 1e-8),
        (ELASTIC, 0.0, "single", 1e-3),
    ],
    ids=["springs of their own, old readings", "shares of the stiffness and a gain", "the same in single precision"],
)
def test_the_memory_of_maxwell_slip_and_old_readings_are_python_s_in_c(friction, age, precision, near, tmp_path):
    known = replace(STANDARD.known(), friction=friction, reading_age=age)
    controller, observer = pair(STANDARD.nominal, 10, known, weights=Weights.calm())
    faults = SilentSensors(1.0, 1.05, (0,)), FrozenSensors(1.5, 1.9, (2,)), SilentSensors(2.2, 2.6, (2,))
    process = replace(STANDARD, reading_age=age, faults=faults)
    samples, wanted = recorded(process, controller, observer, sine(K=5.5, K_amplitude=0.5, duration=3.0, ramp=1.0))
    directory = export(tmp_path / "c", controller=controller, observer=observer, precision=precision)
    got = replayed(tools.compiled(directory, CONTROL, "vectors", *tools.SANITISED), samples)
    np.testing.assert_array_equal(got[:, [STATUS, RUNG]], wanted[:, [STATUS, RUNG]])
    assert np.abs(got[:, U] - wanted[:, U]).max() < near * SPAN
    if age:
        printed = tools.run(tools.compiled(directory, Path("main.c"), "demonstration", *tools.SANITISED))
        assert printed in (directory / "README.md").read_text()


def test_friction_that_c_does_not_know_is_refused_by_its_name(tmp_path):
    class Unknown:
        def __getattr__(self, name):
            return getattr(Friction(), name)

    plant = Plant()
    controller, observer = pair(plant, 10, Compensation(Unknown()))
    with pytest.raises(InvalidInput, match="Unknown cannot be exported"):
        export(tmp_path / "c", controller=controller, observer=observer)
    assert not (tmp_path / "c").exists()


@needs_qemu
def test_a_cortex_m4f_gives_the_pc_s_commands(faulty_loop, exported):
    samples = faulty_loop[2][:150]
    program = tools.compiled_for_cortex(exported["single"], CONTROL, "m4.elf")
    there = replayed(program, samples, runner=tools.run_on_cortex)
    here = replayed(tools.compiled(exported["single"], CONTROL, "vectors"), samples)
    np.testing.assert_array_equal(there[:, [STATUS, RUNG]], here[:, [STATUS, RUNG]])
    assert np.abs(there[:, U] - here[:, U]).max() < 1e-3 * SPAN


@needs_arm_gcc
def test_ten_samples_ahead_fit_into_128_kib_of_flash_and_64_kib_of_memory(exported):
    size = tools.linked_size(exported["single"])
    assert size.code <= 128 * 1024
    assert size.memory <= 64 * 1024


@needs_arm_gcc
def test_twenty_samples_ahead_fit_into_40_kib_of_memory_in_single_and_48_in_double_precision(tmp_path):
    controller, observer = pair(STANDARD.nominal, 20, STANDARD.known(), weights=Weights.calm())
    for precision, most in (("single", 40), ("double", 48)):
        made = export(tmp_path / precision, controller=controller, observer=observer, precision=precision)
        assert tools.linked_size(made).memory <= most * 1024
        assert 0.7 < tools.stack(made, *tools.CORTEX_M4F) / certificate(controller, precision == "single").stack <= 1


@needs("gcc", "g++")
def test_no_qp_multiplies_more_often_than_its_certificate_allows_nor_much_less(faulty_loop, exported):
    """Recorded steps, and wild ones whose QPs need many exchanges; numbers that count themselves."""
    controller, _, samples, _ = faulty_loop
    rng = np.random.default_rng(0)
    wild = samples[rng.integers(len(samples), size=6000)]
    wild[:, :3] = rng.uniform((-0.6, 0.0, 0.0), (0.6, SPAN, SPAN), (6000, 3))
    wild[:, 3] = 0.0
    wild[:, 4 : 5 + controller.ahead] = np.where(rng.random((6000, controller.ahead + 1)) < 0.5, -0.5, 0.5)
    program = tools.compiled_counting(exported["double"])
    counted, exchanges = replayed(program, np.concatenate([samples[:1000], wild]), 2).T
    bounds = certificate(controller, single=False)
    limited = 8 * controller.plant.m  # commands moved within their limits, outside the QP
    assert (counted <= bounds.begin + bounds.exchange * exchanges + limited).all()
    assert exchanges.max() > 15
    many = exchanges > 10
    assert (counted[many] / exchanges[many]).max() > bounds.plain / 5  # the bound holds for all items at once
    assert counted[exchanges == 0].max() > bounds.begin / 20  # one sweep and a proof; the bound has a barrier


@needs_arm_gcc
@pytest.mark.parametrize(
    ("precision", "optimised"), [("double", ()), ("single", ()), ("single", ("-O2",))], ids=["double", "single", "-O2"]
)
def test_a_step_s_stack_on_a_cortex_m4f_is_within_its_bound(precision, optimised, faulty_loop, exported):
    used = tools.stack(exported[precision], *tools.CORTEX_M4F, *optimised)
    assert 0.7 < used / certificate(faulty_loop[0], precision == "single").stack <= 1


@needs_gcc
def test_the_demonstration_prints_python_s_numbers(exported):
    printed = tools.run(tools.compiled(exported["double"], Path("main.c"), "demonstration"))
    assert printed in (exported["double"] / "README.md").read_text()
    assert printed.count("rung 0") == 10


@needs_gcc
@pytest.mark.parametrize(
    ("joint", "precision", "near"),
    [
        (report_joint(), "double", 1e-8),
        (report_joint(SAROSI_DMSP_20_400N), "single", 1e-3),
    ],
    ids=["volume of angle and pressure", "volume of the angle, single precision"],
)
def test_a_plant_s_gas_is_in_the_c_as_it_is_in_python(joint, precision, near, tmp_path):
    """300 steps at 1 Hz, where the gas makes a quarter of a degree, with a valve that sticks and traps it.

    The pressures fall more slowly than they rise, and neither faster than a flow that they reach.
    """
    nominal = Plant(joint, lag=0.12, venting=1.4, slew=8 * BAR)
    process = replace(RealPlant.standard(nominal=nominal), flow=3 * BAR, faults=(StuckValve(1.0, 1.4, 1),))
    known = replace(process.known(), flow=3 * BAR)
    controller, observer = pair(nominal, 10, known, weights=Weights.calm(), compiled=False)
    structured = StructuredQP(controller.problem)  # fails as in C
    controller._qp_step = ReadableQPStep(controller.problem, controller._predictor, structured)
    reference = sine(20 * DEG, 1.0, K=7.6, duration=3.0, ramp=0.5)
    samples, wanted = recorded(process, controller, observer, reference, failing={150, 151})
    directory = export(tmp_path / "c", controller=controller, observer=observer, precision=precision)
    got = replayed(tools.compiled(directory, CONTROL, "vectors", *tools.QUICK), samples)
    np.testing.assert_array_equal(got[:, [STATUS, RUNG]], wanted[:, [STATUS, RUNG]])
    assert np.abs(got[:, U] - wanted[:, U]).max() < near * SPAN


def test_what_is_exported_tracks_the_isobaric_stiffness():
    plant = Plant(report_joint(SAROSI_DMSP_20_400N), gas=True, frequency=2.0)
    with pytest.raises(InvalidInput, match="dynamic stiffness at 2 Hz cannot be exported"):
        check_pair(SimpleNamespace(plant=plant, budget=None), None)
