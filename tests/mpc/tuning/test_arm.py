"""`tune` of an arm: draws, tour, a search with a budget of a few evaluations, and its file."""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from allocator import InvalidInput
from allocator.errors import InvalidFile, MissingBackend
from allocator.machine_file import load_machine
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR
from mpc import tune
from mpc.cli import app
from mpc.model.arm.model import Arm
from mpc.model.arm.storage import load_arm, save_arm
from mpc.model.compensation import USUAL_DEAD_TIME, Compensation
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.plant_cli import PlantOptions
from mpc.trials.loops import Settings, loop
from mpc.trials.margins import margins
from mpc.trials.tuned import Tuning
from mpc.tuning.draws import Spreads, draws, payloads
from mpc.tuning.result import with_tuning
from mpc.tuning.tour import Tour

ARM, TOLD = Arm.machine("arm26"), Compensation.of_arm()
FEW = {"evaluations": 3, "n_draws": 1, "seed": 5, "dt": 0.02, "horizon": 10}


def test_draws_differ_as_their_spreads_say():
    many = draws(ARM, TOLD, 200, 0, Spreads())
    gains = np.log([one.force_gains for one in many])
    assert gains.shape == (200, 6)
    assert gains.std(axis=0) == pytest.approx([Spreads.strength] * 6, rel=0.1)
    assert np.log([one.mass for one in many]).std() == pytest.approx(Spreads.inertia, rel=0.1)
    assert np.log([one.damping for one in many]).std() == pytest.approx(Spreads.damping, rel=0.1)
    assert many == draws(ARM, TOLD, 200, 0, Spreads())
    assert many[0] != draws(ARM, TOLD, 200, 1, Spreads())[0]


def test_the_volume_of_gas_differs_too():
    with_gas = replace(ARM, gas=True)
    muscle, length = ARM.mechanism.muscles[0], ARM.mechanism.routes.rest_length[0]
    many = draws(with_gas, TOLD, 30, 0, Spreads())
    volumes = [one.nominal.mechanism.muscles[0].volume_at_rest(length) for one in many]
    assert np.log(volumes).std() == pytest.approx(Spreads.volume, rel=0.1)
    assert np.median(volumes) == pytest.approx(muscle.volume_at_rest(length), rel=0.05)


def test_known_friction_is_drawn_and_unknown_friction_is_usual():
    usual = MaxwellSlip.of_width(ARM, Spreads.width, joint=1).springs[0]
    half = tuple(MaxwellSlip.of_width(ARM, Spreads.width / 2, joint=i) for i in range(2))
    for known, expected in ((TOLD, usual), (Compensation(frictions=half), usual / 2)):
        shares = [one.frictions[1].springs[0] / expected for one in draws(ARM, known, 50, 0, Spreads())]
        assert 0.5 <= min(shares) < 0.55
        assert 1.4 < max(shares) <= 1.5


def test_payloads_turn_every_joint_by_a_few_degrees():
    K = Tour.of(ARM, 0.01).K
    turns = np.linalg.solve(K, np.transpose(payloads(8, 0, K, Spreads()))).T
    low, high = Spreads.payload
    assert ((np.abs(turns) >= low) & (np.abs(turns) <= high)).all()
    assert {tuple(signs) for signs in np.sign(turns)} == {(1, 1), (-1, 1), (1, -1), (-1, -1)}


def test_the_tour_rests_before_the_payload_and_at_the_end():
    tour = Tour.of(ARM, 0.01)
    theta = tour.reference.theta
    assert list(tour.legs) == ["min-jerk", "load", "min-jerk loaded"]
    assert tour.motions == ("min-jerk",)
    for rest in tour.rests:
        assert (theta[rest] == ARM.middle).all()
    assert (np.ptp(theta[tour.legs["min-jerk"]], axis=0) > 0.3).all()
    assert np.shape(tour.postures[0][0]) == (2,)
    stiff = Tour.of(ARM, 0.01, np.diag([9.0, 7.0])).reference.K
    assert (stiff == np.diag([9.0, 7.0])).all()


def test_the_share_of_friction_is_that_of_every_joint():
    frictions = tuple(MaxwellSlip.of_width(ARM, 0.05, joint=i) for i in range(2))
    settings = Settings(ARM, compensation=Compensation(frictions=frictions))
    start = Tuning.start("mpc", settings)
    told = Tuning("mpc", {**start.numbers, "friction_share": 0.5}).applied(settings).compensation.frictions
    assert [one.springs[0] for one in told] == pytest.approx([0.5 * one.springs[0] for one in frictions])


def test_an_arms_file_takes_regulators_and_a_tuning(tmp_path):
    path, tuning = tmp_path / "arm.toml", Tuning.start("mpc", Settings(ARM))
    save_arm(ARM, path)
    assert Compensation.of_arm(path).dead_time == USUAL_DEAD_TIME
    path.write_text(path.read_text() + "\n[regulators]\ndead_time = 0.03\n")
    path.write_text(with_tuning(path, tuning))
    assert Compensation.of_arm(path).dead_time == 0.03
    assert Tuning.load(path) == tuning
    assert load_arm(path) == ARM
    assert load_machine(path) == ARM.mechanism


def test_an_arms_file_takes_the_friction_of_each_joint(tmp_path):
    path = tmp_path / "arm.toml"
    save_arm(ARM, path)
    text = path.read_text()
    path.write_text(text + "\n[friction]\ncoulomb = [0.5, 0.2]\nmu = 0.02\n")
    assert Compensation.of_arm(path).frictions == (Friction(0.02, 0.5), Friction(0.02, 0.2))
    assert load_arm(path) == ARM
    wrongs = {
        "coulomb = [0.5, 0.2, 0.1]": r"one per joint \(2\)",
        "coulomb = -1": "coulomb",
        "stiction = 1": "stiction",
    }
    for wrong, why in (wrongs | {'mu = "much"': "mu"}).items():
        path.write_text(f"{text}\n[friction]\n{wrong}\n")
        with pytest.raises(InvalidFile, match=rf"\[friction\].*{why}"):
            Compensation.of_arm(path)


def test_without_a_tuning_half_of_a_mujoco_models_dry_friction_is_known(tmp_path):
    model = tmp_path / "elbow.xml"
    model.write_text(ELBOW.replace('damping=".2"', 'damping=".2" frictionloss=".4"'), encoding="utf-8")
    options = PlantOptions(machine=str(model), rest_length="300")
    known = options.compensation_of_arm()
    assert known.frictions == (Friction(coulomb=0.4),)
    told, _ = options.tuned(Settings(options.arm(), compensation=known), "mpc")
    assert told.compensation.frictions == (Friction(coulomb=0.2),)


def test_wrong_inputs_are_one_sentence(tmp_path):
    with pytest.raises(MissingBackend, match="predictive-pid"):
        tune(ARM, TOLD, controller="predictive-pid")
    with pytest.raises(InvalidInput, match="one joint; an arm"):
        loop("pid", Settings(ARM))
    for K in (8.0, np.eye(3)):
        with pytest.raises(InvalidInput, match="K has the shape"):
            Tour.of(ARM, 0.01, K)
    out, arm = ["--out", str(tmp_path / "tuned.toml")], tmp_path / "arm.toml"
    save_arm(ARM, arm)
    for arguments, said in (
        (["--machine", "arm26", "--in-place"], "--in-place is for a TOML file"),
        (["--machine", "arm26", "--stiffness", "8", *out], "--stiffness is for one joint"),
        (["--machine", "arm.xml", *out], "arm.xml: does not exist"),
        (out, "give the machine to tune for"),
        (["--machine", str(arm), "--lag", "0.2", *out], "is tuned for as it is"),
    ):
        result = CliRunner().invoke(app, ["tune", *arguments])
        assert result.exit_code != 0
        assert said in str(result.exception) + result.output


@pytest.fixture(scope="module")
def tuned():
    return tune(ARM, TOLD, **FEW)


@pytest.mark.slow
def test_the_tuning_is_never_worse_than_the_defaults(tuned):
    assert len(tuned.evaluations) == FEW["evaluations"]
    assert tuned.before.tuning == Tuning.start("mpc", tuned.problem.settings)
    assert tuned.after.objective == min(one.objective for one in tuned.evaluations) <= tuned.before.objective
    assert 0 < tuned.before.error < 10.0
    assert "min-jerk, RMS before / with load [°]" in [name for name, *_ in tuned.rows()]


@pytest.mark.slow
def test_two_processes_give_the_answer_of_one(tuned):
    with ProcessPoolExecutor(2) as pool:
        again = tune(ARM, TOLD, executor=pool, **FEW)
    assert [one.tuning for one in again.evaluations] == [one.tuning for one in tuned.evaluations]
    assert [one.objective for one in again.evaluations] == [one.objective for one in tuned.evaluations]


@pytest.mark.slow
def test_its_margins_on_the_model_are_those_of_margins(tuned):
    settings, places = tuned.problem.settings, tuned.problem.tour.postures[:1]
    (theirs,) = margins(*loop("mpc", settings), places)
    assert tuned.before.nominal[0].sensitivity_peak == pytest.approx(theirs.sensitivity_peak, rel=1e-4)
    assert tuned.before.nominal[0].delay_margin == pytest.approx(theirs.delay_margin, rel=1e-3)


@pytest.mark.slow
def test_the_command_writes_an_arm_that_track_takes(tmp_path):
    out = tmp_path / "tuned.toml"
    small = ["--evaluations", "2", "--draws", "1", "--workers", "1", "--dt", "0.02", "--horizon", "10"]
    result = CliRunner().invoke(app, ["tune", "--machine", "arm26", "--out", str(out), *small])
    assert result.exit_code == 0, result.output
    assert "M_s on the draws" in result.output
    assert load_arm(out) == ARM
    files = ["--out", str(tmp_path / "run.csv"), "--dt", "0.02", "--horizon", "10"]
    tracked = CliRunner().invoke(app, ["track", "hold", "--machine", str(out), "--plant", "real", *files])
    assert tracked.exit_code == 0, tracked.output
    assert "tuning of mpc for this plant: theta error" in tracked.output


ELBOW = """<mujoco><worldbody><site name="a" pos="-.3 .05 0"/><site name="b" pos="-.3 -.05 0"/>
<body><joint name="elbow" axis="0 0 1" damping=".2" range="-45 45"/>
<geom type="capsule" fromto="0 0 0 .25 0 0" size=".01" mass=".5" contype="0" conaffinity="0"/>
<site name="c" pos=".05 .05 0"/><site name="d" pos=".05 -.05 0"/></body></worldbody>
<tendon><spatial name="flexor"><site site="a"/><site site="c"/></spatial>
<spatial name="extensor"><site site="b"/><site site="d"/></spatial></tendon></mujoco>"""


@pytest.mark.slow
def test_the_tuning_of_a_mujoco_model_is_a_table_for_tracking(tmp_path, monkeypatch, tuned):
    """The search for arm26 stands in for that for the model, which compiles for minutes."""
    model, table, given = tmp_path / "elbow.xml", tmp_path / "tuning.toml", []
    model.write_text(ELBOW, encoding="utf-8")
    monkeypatch.setattr("mpc.tuning.search.tune", lambda *told, **_: given.extend(told) or tuned)
    options = ["--machine", str(model), "--rest-length", "300", "--supply", "4", "--lag", "0.2"]
    result = CliRunner().invoke(app, ["tune", *options, "--workers", "1", "--out", str(table)])
    assert result.exit_code == 0, result.output
    arm, known = given
    wanted = Arm.from_mjcf(ELBOW, SAROSI_DMSP_20_400N, 0.3, contraction=0.1375, pressure_limits=(0.0, 4 * BAR), lag=0.2)
    assert (arm.mechanism, arm.lag, arm.slew) == (wanted.mechanism, wanted.lag, wanted.slew)
    np.testing.assert_array_equal(arm.bodies.mass_matrix([0.3]), wanted.bodies.mass_matrix([0.3]))
    assert known == replace(TOLD, frictions=(Friction(),))
    assert Tuning.load(table) == tuned.tuning
    settings, said = PlantOptions(machine=str(model), tuning=str(table)).tuned(Settings(arm), "mpc")
    assert settings == tuned.tuning.applied(Settings(arm))
    assert said == tuned.tuning.summary
    (tmp_path / "empty.toml").touch()
    with pytest.raises(InvalidInput, match=r"has no table \[tuning\] for mpc"):
        PlantOptions(machine=str(model), tuning=str(tmp_path / "empty.toml")).tuned(Settings(arm), "mpc")
