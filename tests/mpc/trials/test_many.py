"""Many runs are those of `simulate`, whatever is compiled of them, on however many processes."""

from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import pytest

from allocator import BAR, DEG, InvalidInput
from mpc import KalmanObserver, PlanStatus, RealPlant, Reference, TrackingMPC, Weights, simulate, simulate_many
from mpc.codegen.graphs import Untranslatable
from mpc.model.arm.model import Arm
from mpc.model.faults import SilentSensors, WrongReadings
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.model.real import RealArm
from mpc.observer.base import Differentiator
from mpc.trials.many.driving import driving
from mpc.trials.many.entry import Loop, spread
from mpc.trials.many.plant import compiled_plant
from mpc.trials.metrics import metrics
from mpc.yardsticks.baselines import (
    FeedForwardControl,
    LQRControl,
    PIControl,
    PIDControl,
    PIDGains,
    PredictivePIDControl,
)

pytestmark = pytest.mark.compiles

DT = 0.01
REAL = RealPlant.standard(torque_profile=((0.3, 0.5), (0.6, -0.5)))
MODEL = REAL.nominal
MOVE = Reference(np.linspace(0, 1, 11), 20 * DEG * np.sin(np.linspace(0, 3, 11)), np.full(11, 5.5))
FIELDS = (
    "t", "x", "estimate", "u", "theta_ref", "K_ref", "K", "forces", "rung", "status", "slack", "slack_force", "moved",
)  # fmt: skip
KINDS = {
    "nominal": MODEL,
    "all effects": REAL,
    "half a sample late": replace(REAL, dead_time=0.037, encoder=0.0),
    "sensors off, an angle disturbed": replace(
        REAL,
        reading_age=0.017,
        pressure_offset=(0.02 * BAR, -0.03 * BAR),
        faults=(WrongReadings(0.2, 0.3, (0,), 1e-3, added=True),),
    ),
    "gas behind a shut valve, Dahl": replace(
        REAL, nominal=replace(MODEL, gas=True), shut=(True, False), friction=REAL.friction.as_dahl(MODEL)
    ),
}

ARM = Arm.machine("arm26")
SLIPS = tuple(MaxwellSlip.of_width(ARM, 4 * DEG, joint=i) for i in range(2))
GAINS = (1.1, 0.9, 1.05, 0.95, 1.02, 1.08)
ARMS = {
    "sliding": RealArm(ARM, GAINS, pressure_noise=1e-3),
    "all effects": RealArm(
        ARM, GAINS, SLIPS, 0.025, 0.1 * BAR, 0.08, 0.13, 5 * BAR, 0.05 * DEG, 0.017, 0.01 * BAR,
        tuple(np.arange(6) * 100.0), ((0.3, (0.5, -0.2)),),
        faults=(WrongReadings(0.2, 0.3, (1,), 1e-3, added=True, joints=2, muscles=6),), mass=1.2, damping=0.8,
    ),
    "gas behind a shut valve, Dahl": RealArm(
        replace(ARM, gas=True), GAINS, (Friction(0.02, 0.1), Friction(0.03)), shut=(True, *(False,) * 5)
    ),
}  # fmt: skip


def same(one, other):
    return all(np.allclose(getattr(one, f), getattr(other, f), rtol=1e-9, atol=1e-9, equal_nan=True) for f in FIELDS)


# --- the plant --------------------------------------------------------------------------------------------------------


@pytest.mark.slow  # compiles
@pytest.mark.parametrize("kind", KINDS)
def test_a_compiled_plant_is_the_plant_bit_by_bit(kind):
    process, rng = KINDS[kind], np.random.default_rng(7)
    x0 = process.at_rest(0.1, 5.5)
    ours, theirs = (p.begin(DT, x0, 3) for p in (compiled_plant(process, DT), process))
    for u in rng.uniform(0.5 * BAR, 4.5 * BAR, (100, 2)):
        np.testing.assert_array_equal(ours.measure(), theirs.measure())
        ours.advance(u)
        theirs.advance(u)
        np.testing.assert_array_equal(ours.x, theirs.x)


@pytest.mark.slow  # compiles
@pytest.mark.parametrize("kind", ARMS)
def test_a_compiled_arm_is_the_arm(kind):
    process, rng = ARMS[kind], np.random.default_rng(7)
    x0 = np.concatenate([ARM.middle, [0.5, -0.3], np.full(6, 2.5 * BAR)])
    ours, theirs = (p.begin(DT, x0, 3) for p in (compiled_plant(process, DT), process))
    for u in rng.uniform(1.5 * BAR, 3.5 * BAR, (100, 6)):
        np.testing.assert_allclose(ours.measure(), theirs.measure(), rtol=1e-9, atol=1e-9)
        ours.advance(u, np.array([0.1, -0.2]))
        theirs.advance(u, np.array([0.1, -0.2]))
        np.testing.assert_allclose(ours.x, theirs.x, rtol=1e-9, atol=1e-9)
    assert np.abs(ours.x[:2] - x0[:2]).max() > 1 * DEG


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (RealPlant.standard((1.1, 0.9)), RealPlant.standard((0.95, 1.07))),
        (ARMS["sliding"], replace(ARMS["sliding"], force_gains=GAINS[::-1])),
    ],
)
def test_plants_that_differ_in_numbers_share_what_is_compiled(one, other):
    one, other = (compiled_plant(plant, DT) for plant in (one, other))
    assert one.module is other.module
    assert (one.c != other.c).any()


def test_what_is_not_compiled_says_so():
    with pytest.raises(Untranslatable, match=r"a plant with faults \(1 of them\) is not compiled"):
        compiled_plant(replace(REAL, faults=(SilentSensors(),)), DT)
    with pytest.raises(ValueError, match=r"compiled for samples of 0.01 s, not of 0.02 s"):
        compiled_plant(REAL, DT).begin(0.02, REAL.at_rest(0.0, 5.5), 0)


# --- the runs ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def driver():
    known = REAL.known()
    controller = TrackingMPC(MODEL, DT, N=5, weights=Weights.calm(), compensation=known)
    return controller, KalmanObserver(MODEL, DT, compensation=known)


@pytest.mark.slow
def test_every_run_is_the_one_of_simulate(driver):
    controller, observer = driver
    late = replace(RealPlant.standard((0.9, 1.05)), dead_time=0.014)
    hit = replace(REAL, torque_profile=((0.3, 40.0), (0.35, 0.0)))  # the observer's gates take it for wrong readings
    plants = [REAL, late, replace(REAL, faults=(SilentSensors(0.5, 0.7),)), hit]
    seeds, x0 = (5, 6, 7, 8), np.array([MODEL.at_rest(angle, 6.0) for angle in (0.0, 0.1, 0.0, -0.1)])
    many = simulate_many(plants, controller, MOVE, x0=x0, observers=observer, seeds=seeds, keep=True)
    assert len(many) == 4
    for i in range(4):
        alone = simulate(plants[i], controller, MOVE, x0=x0[i], observer=observer, seed=seeds[i])
        assert same(many[i], alone)
        assert many.theta_rms[i] == pytest.approx(metrics(alone).theta_rms, rel=1e-9)
        assert many.statuses[i].sum() == many.rungs[i].sum() == alone.u.shape[0]
    assert many.implementation == ("compiled", "compiled", "readable", "readable")
    blind = many.statuses[:, list(PlanStatus).index(PlanStatus.NO_MEASUREMENT)]
    assert blind[2] > 0
    assert (blind[[0, 1]] == 0).all()


@pytest.mark.slow
def test_a_compiled_loop_rests_as_simulate_does(driver):
    controller, observer = driver
    t = np.linspace(0, 1, 21)
    there = Reference([*t, 5.0], 10 * DEG * np.append(1 - np.cos(np.pi * t), 2.0), np.full(22, 5.5))
    many = simulate_many(REAL, controller, there, observers=observer, seeds=[11], keep=True)
    alone = simulate(REAL, controller, there, observer=observer, seed=11)
    assert many.implementation == ("compiled",)
    assert same(many[0], alone)
    assert (many[0].status == PlanStatus.RESTING).sum() > 50
    assert np.isnan(many[0].step_time).all()


@pytest.mark.slow
def test_a_compiled_loop_predicts_the_present_from_old_readings_as_simulate_does():
    known = replace(REAL.known(), dead_time=0.01, reading_age=0.02)
    controller = TrackingMPC(MODEL, DT, N=5, weights=Weights.calm(), compensation=known)
    observer = KalmanObserver(MODEL, DT, compensation=known)
    many = simulate_many(REAL, controller, MOVE, observers=observer, seeds=[11], keep=True)
    assert many.implementation == ("compiled",)
    assert same(many[0], simulate(REAL, controller, MOVE, observer=observer, seed=11))


@pytest.mark.slow
@pytest.mark.parametrize("watched", [True, False], ids=["kalman", "differences"])
@pytest.mark.parametrize("told", [REAL.known(), replace(REAL.known(), dead_time=0.01, reading_age=0.02)], ids=str)
@pytest.mark.parametrize("kind", [FeedForwardControl, PIDControl, PIControl, PredictivePIDControl, LQRControl])
def test_a_compiled_baseline_answers_as_simulate_does(kind, told, watched):
    controller = kind(MODEL, DT, told)
    observer = KalmanObserver(MODEL, DT, compensation=told) if watched else Differentiator(DT)
    many = simulate_many(REAL, controller, MOVE, observers=observer, seeds=[11], keep=True)
    assert many.implementation == ("compiled",)
    assert same(many[0], simulate(REAL, kind(MODEL, DT, told), MOVE, observer=observer, seed=11))


@pytest.mark.slow
def test_a_compiled_integral_is_frozen_at_a_limit_as_that_of_simulate_is():
    gains, jump = PIDGains(300.0, 900.0, 0.0, 0.0), replace(MOVE, theta=np.sign(MOVE.theta) * 0.3)
    controllers = [PIDControl(MODEL, DT, gains=gains) for _ in range(2)]
    many = simulate_many(MODEL, controllers[0], jump, observers=Differentiator(DT), keep=True)
    alone = simulate(MODEL, controllers[1], jump, observer=Differentiator(DT))
    assert many.implementation == ("compiled",)
    assert same(many[0], alone)
    assert (np.abs(np.diff(alone.u, axis=0)) > 0.999 * MODEL.slew * DT).any()


def test_a_baseline_of_another_kind_is_left_to_simulate():
    class Own(PIDControl):
        pass

    assert driving(Own(MODEL, DT), Differentiator(DT)) is None


@pytest.mark.parametrize("other", [{"iterations": 2}, {"budget": 10.0}, {"solver": "daqp"}])
def test_controllers_that_are_not_compiled_are_left_to_simulate(driver, other):
    controller = replace(driver[0], **other)
    assert driving(controller, driver[1]) is None
    assert driving(*driver) is not None


def test_an_observer_that_is_told_something_else_is_left_to_simulate(driver):
    assert driving(driver[0], KalmanObserver(MODEL, DT)) is None
    assert driving(driver[0], None) is None


@pytest.mark.slow
def test_two_processes_answer_as_one():
    gains = [PIDControl(MODEL, gains=PIDGains(40.0, 200.0, d)) for d in (2.0, 3.0, 4.0)]
    one, two = (simulate_many(REAL, gains, MOVE, seeds=range(3), keep=True, workers=n) for n in (1, 2))
    assert (one.theta_rms == two.theta_rms).all()
    assert (one.to_dict()["seed"] == [0, 1, 2]).all()
    assert all(same(a, b) for a, b in zip(one.kept, two.kept, strict=True))


def test_the_noise_of_a_seed_is_the_same_and_of_others_another():
    runs = simulate_many(REAL, FeedForwardControl(MODEL), MOVE, seeds=[4, 4, 5], keep=True)
    assert (runs[0].estimate == runs[1].estimate).all()
    assert (runs[0].estimate != runs[2].estimate).any()


# --- what is said of them ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def three():
    return simulate_many(MODEL, FeedForwardControl(MODEL), MOVE, seeds=range(3))


def test_runs_have_columns_and_a_line(three):
    table = three.to_dict()
    assert {len(column) for column in table.values()} == {3}
    assert (table["after_rest.theta_rms"] == [m.after_rest.theta_rms for m in three.metrics]).all()
    assert (three.column("pressure slew") == 0).all()
    assert three.limits_kept.tolist() == [m.limits_kept for m in three.metrics]
    assert repr(three).startswith("3 runs: RMS angle error ")
    assert "CLOSED_FORM 300" in repr(three)
    assert "<td>runs with a limit broken</td>" in three._repr_html_()


def test_what_is_not_there_is_said(three):
    with pytest.raises(InvalidInput, match=r"runs have no column 'rms'; they have theta_rms, theta_worst"):
        three.column("rms")
    with pytest.raises(InvalidInput, match=r"only figures were kept of these 3 runs; say keep=True"):
        three[0]


CONTROL = FeedForwardControl(MODEL)


@pytest.mark.parametrize(
    ("given", "options", "said"),
    [
        ((MODEL, CONTROL, MOVE), {"seeds": [0, -1]}, r"seeds\[1\] = -1 has to be a whole number, 0 or more"),
        ((MODEL, CONTROL, MOVE), {"seeds": 0.5}, r"seeds\[0\] = 0.5 has to be a whole number"),
        (([MODEL] * 2, CONTROL, MOVE), {"seeds": range(3)}, "different lengths.*: plants 2, seeds 3"),
        ((MODEL, [], MOVE), {}, "nothing in them: controllers 0"),
        ((RealPlant, CONTROL, MOVE), {}, r"plants\[0\] = <class .*> is no plant; expected: Interface of plants"),
        ((MODEL, "mpc", MOVE), {}, r"controllers\[0\] = 'mpc' is no controller; expected: Interface of controllers"),
        ((MODEL, CONTROL, 0.3), {}, r"references\[0\] = 0.3 is no reference"),
        ((MODEL, CONTROL, MOVE), {"observers": MODEL}, r"observers\[0\] = .* is no observer"),
        ((MODEL, CONTROL, MOVE), {"x0": [0.0, 0.0]}, r"x0 = \[0.0, 0.0\] has to be 4 finite numbers"),
        ((MODEL, CONTROL, MOVE), {"x0": np.zeros((2, 4)), "seeds": range(3)}, "different lengths.*: x0 2, seeds 3"),
        ((MODEL, CONTROL, MOVE), {"workers": 0}, "workers = 0 has to be a whole number, 1 or more"),
    ],
)
def test_wrong_input_is_refused_in_a_sentence(given, options, said):
    with pytest.raises(InvalidInput, match=said):
        simulate_many(*given, **options)


class Failing(FeedForwardControl):
    """A controller that breaks."""

    def step(self, *arguments):
        """Raise."""
        raise RuntimeError("no more")


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_an_error_says_in_which_run_it_was(workers):
    controllers = [CONTROL, Failing(MODEL)]
    with pytest.raises(RuntimeError, match="no more") as caught:
        simulate_many(MODEL, controllers, MOVE, seeds=[3, 9], workers=workers)
    assert caught.value.__notes__ == ["in run 1, with the seed 9"]


def test_what_cannot_be_sent_to_a_process_is_refused():
    class Local(FeedForwardControl):
        """A class that no other process finds."""

    loops = [Loop(i, MODEL, Local(MODEL), MOVE, None, None, i) for i in range(2)]
    with pytest.raises(InvalidInput, match=r"these loops cannot be sent to other processes, say workers=1: .*Local"):
        list(spread(loops, keep=False, workers=2, context=get_context("spawn")))
