"""One build in C does with numbers what Python's controllers do with other weights, slew and least force."""

from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from allocator.errors import InvalidInput
from allocator.units import BAR, DEG
from mpc import KalmanObserver, PlanStatus, Plant, RealPlant, TrackingMPC, Weights, sine
from mpc.cli import app
from mpc.export import export
from mpc.export.controller.tuning import tuning_numbers, weights_from, write_tuning
from mpc.tracking.qp.solvers import Riccati

from ...rigs import toolchain as tools
from ...rigs.needs import needs
from ...rigs.replay import CONTROL, CONTROL_COLUMNS, record

pytestmark = pytest.mark.tools

needs_gcc = needs("gcc")
PROCESS = RealPlant.standard()
PLANT, KNOWN = PROCESS.nominal, PROCESS.known()
TUNINGS = {
    "the build's": {},
    "sharp": {"weights": Weights()},
    "angle and rate": {"weights": weights_from("theta=0.05, rate=2")},
    "stiffness, cheap slacks": {
        "weights": replace(Weights.calm(), K=1 / 0.01**2, slack=1e8, slack_square=1e9, slack_force_square=1e4)
    },
    "taut, slow": {"min_force": 60.0, "plant": replace(PLANT, slew=1.5 * BAR)},
}


def controller_of(weights=None, min_force=0.0, plant=PLANT, N=8):
    return TrackingMPC(plant, N=N, compensation=KNOWN, weights=weights or Weights.calm(), min_force=min_force)


def recorded(controller):
    """A second of a loop that reaches limits, with a solver that fails at two samples."""
    observer = KalmanObserver(controller.plant, controller.dt, compensation=KNOWN)
    usual = controller._solve

    def fails(k):
        controller._solve = Riccati(exchanges=0) if k in {40, 41} else usual
        return k in {40, 41}

    reference = sine(amplitude=70 * DEG, K=5.5, frequency=0.6, duration=1.4, ramp=0.3)
    return record(PROCESS, controller, observer, reference, fails)


@pytest.fixture(scope="module")
def loops():
    return {name: recorded(controller_of(**settings)) for name, settings in TUNINGS.items()}


@pytest.fixture(scope="module")
def builds(tmp_path_factory):
    """The export in both precisions, compiled once each."""
    found = {}
    for precision in ("double", "single"):
        out = export(tmp_path_factory.mktemp("c") / precision, controller=controller_of(), precision=precision)
        found[precision] = tools.compiled(out, CONTROL, "vectors", *tools.QUICK)
    return found


def answers(program, samples, tuning):
    samples.tofile(program.parent / "in")
    tools.run(program, "in", "out", str(tuning))
    return np.fromfile(program.parent / "out").reshape(-1, len(CONTROL_COLUMNS))


@needs_gcc
@pytest.mark.slow
@pytest.mark.parametrize(("precision", "agree"), [("double", 1e-8), ("single", 1e-3)])
def test_one_build_commands_what_python_commands_with_each_tuning(precision, agree, loops, builds, tmp_path):
    own = builds[precision], loops["the build's"].samples
    untuned = None
    for name, settings in TUNINGS.items():
        write_tuning(tmp_path / "tuning.txt", controller_of(**settings))
        done = loops[name]
        got = answers(builds[precision], done.samples, tmp_path / "tuning.txt")
        other = (got[:, 2:4] != done.answers[:, 2:4]).any(axis=1).sum()
        assert other <= (precision == "single"), name  # whose certificate refuses more of sharp weights
        assert np.abs(got[:, :2] - done.answers[:, :2]).max() < agree * 5 * BAR, name
        here = answers(*own, tmp_path / "tuning.txt")[:, :2]
        untuned = here if untuned is None else untuned
        assert name == "the build's" or np.abs(here - untuned).max() > 1e-2 * BAR, "a tuning that tunes nothing"
    assert {PlanStatus.OPTIMAL, PlanStatus.UNSOLVED} <= {*loops["sharp"].answers[:, 2].astype(int)}


@needs_gcc
def test_numbers_of_another_build_are_refused(builds, loops, tmp_path):
    program, samples = builds["double"], loops["sharp"].samples[:2]
    good = controller_of()
    wrong = {
        "plant": controller_of(plant=replace(PLANT, inertia=1.2 * PLANT.inertia)),
        "dt": TrackingMPC(PLANT, N=8, dt=0.02, compensation=KNOWN),
    }
    write_tuning(tmp_path / "good.txt", good)
    assert len(answers(program, samples, tmp_path / "good.txt")) == 2
    for controller in wrong.values():
        write_tuning(tmp_path / "wrong.txt", controller)
        with pytest.raises(RuntimeError, match="ended with 4"):
            answers(program, samples, tmp_path / "wrong.txt")
    lines = (tmp_path / "good.txt").read_text().splitlines()
    for place, text in ((9, "nan"), (10, "-1.0"), (-1, "inf"), (-2, "0.0")):
        (tmp_path / "wrong.txt").write_text("\n".join([*lines[:place], text, *lines[place:][1:]]))
        with pytest.raises(RuntimeError, match="ended with 4"):
            answers(program, samples, tmp_path / "wrong.txt")
    (tmp_path / "wrong.txt").write_text("\n".join(lines[:-1]))
    with pytest.raises(RuntimeError, match="ended with 4"):
        answers(program, samples, tmp_path / "wrong.txt")


def test_the_horizon_is_not_among_the_numbers():
    numbers = [tuning_numbers(controller_of(N=N)) for N in (5, 12)]
    for short, long in zip(*numbers, strict=True):
        np.testing.assert_allclose(short[1], long[1], rtol=1e-12, err_msg=short[0])


@needs_gcc
@pytest.mark.slow
def test_a_stranger_tunes_the_demonstration_without_a_compiler(tmp_path):
    def invoke(product, *more):
        given = ["--muscle", "sarosi-dmsp-20-400n", "--horizon", "5", *map(str, more)]
        return CliRunner().invoke(app, ["export", product, *given])

    assert invoke("controller", "--out", tmp_path / "c", "--errors", "theta=0.1,rate=0.3").exit_code == 0
    made = invoke("tuning", "--out", tmp_path / "t.txt", "--errors", "theta=0.05,rate=3")
    assert made.exit_code == 0, made.output
    program = tools.compiled(tmp_path / "c", tmp_path / "c" / "main.c", "demonstration", *tools.QUICK)
    plain, tuned = tools.run(program), tools.run(program, str(tmp_path / "t.txt"))
    assert plain != tuned
    invoke("controller", "--out", tmp_path / "other", "--errors", "theta=0.05,rate=3")
    assert tuned in (tmp_path / "other" / "README.md").read_text()
    again = invoke("tuning", "--out", tmp_path / "t.txt")
    assert "t.txt" in str(again.exception)  # which is there
    assert invoke("tuning", "--out", tmp_path / "t.txt", "--force").exit_code == 0
    assert invoke("controller", "--out", tmp_path / "new", "--force").exit_code  # which has no such option
    another_plant = "--out", str(tmp_path / "u.txt"), "--errors", "theta=0.1,rate=0.3"
    other = CliRunner().invoke(app, ["export", "tuning", *another_plant])
    assert other.exit_code == 0
    with pytest.raises(RuntimeError, match="no tuning for this build"):
        tools.run(program, str(tmp_path / "u.txt"))


@pytest.mark.parametrize(
    ("errors", "said"),
    [("theta", "expected NUMBER"), ("alpha=1", "expected NAME=ERROR"), ("theta=-1", "expected 1e-09"), ("", "NAME")],
)
def test_errors_that_are_none_are_said_in_a_sentence(errors, said):
    with pytest.raises(InvalidInput, match=said):
        weights_from(errors)


def test_errors_are_those_that_cost_one_half():
    weights = weights_from("theta=0.5,u=0.2")
    assert weights.theta * (0.5 * DEG) ** 2 / 2 == pytest.approx(0.5)
    assert weights.u * (0.2 * BAR) ** 2 / 2 == pytest.approx(0.5)
    assert weights.rate == Weights.calm().rate
    assert isinstance(PLANT, Plant)
