"""`tune` as a whole: on the report's joint, with a budget of a few evaluations."""

import json
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest
from typer.testing import CliRunner

from allocator import BAR, InvalidInput
from allocator.errors import MissingBackend
from mpc import Compensation, Plant, tune
from mpc.cli import app
from mpc.model.storage import save_plant
from mpc.trials.loops import Settings, loop
from mpc.trials.margins import linear, margins
from mpc.trials.tuned import Tuning
from mpc.tuning.cost import THROWN
from mpc.tuning.picture import plot_tuned
from mpc.tuning.result import with_tuning
from mpc.tuning.robustness import Listening

mpl.use("Agg")

PLANT, TOLD = Plant(gas=True), Compensation(dead_time=0.02, dead_band=0.08 * BAR)
FEW = {"evaluations": 4, "n_draws": 2, "seed": 5}


@pytest.fixture(scope="module")
def tuned():
    return tune(PLANT, TOLD, **FEW)


@pytest.fixture
def mine(tmp_path):
    """A user's file of a plant as above, whose compiled runs are those of `tuned`."""
    path = tmp_path / "plant.toml"
    save_plant(path, PLANT.joint, {"inertia": 0.05, "gas": True})
    told = "\n[regulators]\ndead_time = 0.02\ndead_band = 8e3\n# the user's own words\n"
    path.write_text(path.read_text() + told)
    return path


@pytest.mark.compiles
def test_the_tuning_is_never_worse_than_the_defaults(tuned):
    assert len(tuned.evaluations) == FEW["evaluations"]
    assert tuned.before.tuning == Tuning.start("mpc", tuned.problem.settings)
    least = min(one.objective for one in tuned.evaluations)
    assert tuned.after.objective == (least if least < 0.9 * tuned.before.objective else tuned.before.objective)


@pytest.mark.compiles
def test_a_loop_beyond_a_limit_is_charged_for_it(tuned):
    for one in tuned.evaluations:
        within = one.sensitivity_peak <= 2.1 and one.peak_of_draws <= 3.0 and one.inertia_margin >= one.bears
        assert (one.objective > one.error) != within
        assert bool(one.draws) or one.error == THROWN
    assert tuned.after.robust == (not tuned.warning)


@pytest.mark.compiles
def test_the_seed_decides_and_not_who_runs_it(tuned):
    state = np.random.get_state()[1]  # noqa: NPY002 - a library's search must leave it alone
    with ProcessPoolExecutor(2) as pool:
        again = tune(PLANT, TOLD, executor=pool, **FEW)
    assert [one.tuning for one in again.evaluations] == [one.tuning for one in tuned.evaluations]
    assert [one.objective for one in again.evaluations] == [one.objective for one in tuned.evaluations]
    assert (np.random.get_state()[1] == state).all()  # noqa: NPY002
    other = tune(PLANT, TOLD, **{**FEW, "evaluations": 2, "seed": 6})
    assert other.evaluations[1].tuning != tuned.evaluations[1].tuning


@pytest.mark.compiles
def test_a_tuning_is_judged_on_as_many_draws_of_another_seed(tuned):
    before, after = tuned.judged(77)
    assert (before.tuning, after.tuning) == (tuned.before.tuning, tuned.tuning)
    assert len(before.draws) == len(after.draws) == FEW["n_draws"]
    assert before.draws != tuned.before.draws
    assert tuned.judged(FEW["seed"])[0].error == tuned.before.error
    assert [row[1] for row in tuned.rows((before, after))] != [row[1] for row in tuned.rows()]


@pytest.mark.compiles
def test_margins_of_compiled_runs_are_those_of_the_readable_loop(tuned):
    settings = tuned.tuning.applied(tuned.problem.settings)
    two = replace(settings.compensation, lag_up=0.08, lag_down=0.14, flow=5 * BAR, reading_age=0.01)
    settings, tour = settings._replace(compensation=two), tuned.problem.tour
    found, _ = Listening(settings, tuned.problem.draws, tour).margins("mpc", settings)
    parts = loop("mpc", settings._replace(compensation=linear(settings.compensation)))
    for ours, theirs in zip(found, margins(*parts, tour.postures), strict=True):
        assert (ours.theta, ours.K) == (theirs.theta, theirs.K)
        assert ours.sensitivity_peak == pytest.approx(theirs.sensitivity_peak, rel=0.02)
        assert ours.inertia_margin == pytest.approx(theirs.inertia_margin, rel=0.02)


@pytest.mark.compiles
def test_a_tuning_bears_three_times_the_inertia_or_as_much_as_the_defaults(tuned):
    assert {one.bears for one in tuned.evaluations} == {min(3.0, tuned.before.inertia_margin)}
    quick = Tuning("mpc", {**tuned.before.tuning.numbers, "omega_error": 1.0, "theta_error": 0.0005})
    found = tuned.problem.evaluated(quick, always=True)
    assert found.inertia_margin < found.bears
    assert not found.robust


@pytest.mark.compiles
def test_every_evaluation_is_in_the_picture(tuned):
    figure = plot_tuned(tuned)
    axes = figure.axes[0]
    dots = axes.collections[0].get_offsets()
    crosses = next(line for line in axes.lines if line.get_marker() == "x")
    assert len(dots) + len(crosses.get_xdata()) == len(tuned.evaluations)


@pytest.mark.slow
@pytest.mark.parametrize("controller", ["pi", "predictive-pid"])
def test_baselines_are_tuned_on_the_same_draws(controller, tuned):
    theirs = tune(PLANT, TOLD, controller=controller, **{**FEW, "evaluations": 2, "n_draws": 1})
    assert theirs.problem.draws == tune_draws(tuned, 1)
    assert theirs.after.objective <= theirs.before.objective
    assert 0 < theirs.before.error < THROWN


def tune_draws(tuned, n):
    from mpc.tuning.draws import Spreads, draws

    return draws(PLANT, TOLD, n, tuned.problem.seed, Spreads())


@pytest.mark.compiles
def test_the_command_writes_the_plant_with_what_it_found(mine, tmp_path):
    before = mine.read_text()
    out, picture = tmp_path / "tuned.toml", tmp_path / "tuning.png"
    small = ["--evaluations", "2", "--draws", "1", "--workers", "1"]
    files = ["--out", str(out), "--plot", str(picture), "--judge", "9"]
    result = CliRunner().invoke(app, ["tune", "--machine", str(mine), *files, *small])
    assert result.exit_code == 0, result.output
    assert "draws of the other seed" in result.output
    assert "M_s on the model" in result.output
    assert "M_s on the draws" in result.output
    assert "delay margin on the model [ms]" in result.output
    assert "inertia margin on the model" in result.output
    assert mine.read_text() == before
    assert out.read_text().startswith(before)
    assert picture.stat().st_size > 1000
    assert ("the defaults stay" in result.output) == (Tuning.load(out) is None)
    result = CliRunner().invoke(app, ["tune", "--machine", str(mine), "--in-place", *small])
    assert result.exit_code == 0, result.output
    assert (tmp_path / "plant.toml.before-tuning").read_text() == before
    assert Tuning.load(mine) == Tuning.load(out)


@pytest.mark.compiles
def test_track_takes_a_tuning_for_its_own_controller_alone(mine, tmp_path):
    out = tmp_path / "tuned.toml"
    out.write_text(with_tuning(mine, Tuning.start("mpc", Settings(PLANT))))
    files = ["--out", str(tmp_path / "run.csv"), "--plant", "real"]
    tracked = CliRunner().invoke(app, ["track", "steps", "--machine", str(out), *files])
    assert tracked.exit_code == 0, tracked.output
    assert "tuning of mpc for this plant: theta error" in tracked.output
    other = CliRunner().invoke(app, ["track", "steps", "--machine", str(out), "--controller", "pid", "--force", *files])
    assert "tuning of" not in other.output


@pytest.mark.slow
def test_a_dask_cluster_gives_the_same_answer(mine):
    from distributed import LocalCluster

    small = ["--evaluations", "3", "--draws", "1", "--json"]
    here = CliRunner().invoke(app, ["tune", "--machine", str(mine), *small, "--workers", "1"])
    with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as cluster:
        there = CliRunner().invoke(
            app, ["tune", "--machine", str(mine), *small, "--scheduler", cluster.scheduler_address]
        )
    assert here.exit_code == there.exit_code == 0, there.output
    assert json.loads(there.stdout) == json.loads(here.stdout)


def test_tuned_numbers_reach_the_exported_controller(tmp_path):
    from mpc.export.cli import ControllerOptions

    path = tmp_path / "plant.toml"
    save_plant(path, PLANT.joint, {"inertia": 0.05})
    start = Tuning.start("mpc", Settings(PLANT, weights=replace(Settings(PLANT).weights)))
    mine = Tuning("mpc", {name: 1.25 * value for name, value in start.numbers.items()} | {"friction_share": 0.75})
    path.write_text(path.read_text() + "\n".join(mine.lines()) + "\n")
    built = ControllerOptions(machine=str(path)).built()
    assert built.controller.weights.theta == pytest.approx(mine.numbers["theta_error"] ** -2)
    assert built.observer.noise.d_walk == mine.numbers["d_walk"]
    assert "tuning of mpc for this plant" in built.tuned
    errors = ControllerOptions(machine=str(path), errors="theta=0.1").built()
    assert errors.controller.weights.theta == pytest.approx((0.1 * np.pi / 180) ** -2)


def test_wrong_inputs_are_one_sentence(tmp_path):
    for wrong, said in (
        ({"evaluations": 1}, "evaluations"),
        ({"n_draws": 0}, "n_draws"),
        ({"peak": 1.0}, "peak"),
        ({"seed": -1}, "seed"),
    ):
        with pytest.raises(InvalidInput, match=said):
            tune(PLANT, TOLD, **wrong)
    with pytest.raises(MissingBackend, match="nmpc"):
        tune(PLANT, TOLD, controller="nmpc")
    mine = tmp_path / "plant.toml"
    save_plant(mine, PLANT.joint, {})
    for arguments, said in (
        (["--out", str(mine)], "is read by this command"),
        (["--in-place", "--out", str(tmp_path / "new.toml")], "give one of the two"),
        (["--workers", "2", "--scheduler", "tcp://127.0.0.1:1"], "give one of the two"),
        (["--plot", str(tmp_path / "a.txt")], "ending"),
    ):
        result = CliRunner().invoke(app, ["tune", "--machine", str(mine), *arguments])
        assert result.exit_code != 0
        assert said in str(result.exception) + result.output
