"""Parts of a tuning: draws, the tour, the numbers and their table in a file."""

import itertools
import pickle

import numpy as np
import pytest

from allocator import BAR, InvalidFile, InvalidInput
from allocator.errors import MissingBackend
from mpc import Compensation, Plant
from mpc.trials.loops import Settings, loop
from mpc.trials.margins import Margins
from mpc.trials.tuned import TUNABLE, Tuning
from mpc.tuning.cost import Evaluation, Figures, Problem
from mpc.tuning.draws import LEAST, Spreads, draws, payloads
from mpc.tuning.result import Tuned, with_tuning
from mpc.tuning.tour import MOTIONS, Tour

PLANT, TOLD = Plant(gas=True), Compensation(dead_time=0.02, dead_band=0.08 * BAR)
USUAL = Settings(PLANT, compensation=TOLD)
FILE = "# mine\n[machine]\npressure_limits = [0.0, 5e5]  # kept\n"


def test_draws_differ_as_their_spreads_say():
    many = draws(PLANT, TOLD, 400, 0, Spreads())
    gains = np.log([plant.force_gains for plant in many])
    assert gains.std(axis=0) == pytest.approx([Spreads.strength] * 2, rel=0.1)
    assert np.abs(gains.mean(axis=0)).max() < 0.005
    inertia = np.log([plant.nominal.inertia / PLANT.inertia for plant in many])
    assert inertia.std() == pytest.approx(Spreads.inertia, rel=0.1)
    offsets = np.array([plant.pressure_offset for plant in many])
    assert np.abs(offsets).max() <= Spreads.offset
    assert np.abs(offsets.mean(axis=0)).max() < 0.02 * Spreads.offset
    length = PLANT.joint.geometry.rest_length
    volumes = [plant.nominal.joint.agonist.volume_at_rest(length) for plant in many]
    assert np.log(volumes).std() == pytest.approx(Spreads.volume, rel=0.1)


def test_the_hysteresis_is_a_share_of_what_is_told():
    from mpc.model.friction.maxwell_slip import MaxwellSlip

    told = Compensation(MaxwellSlip.of_width(PLANT, 0.1))
    shares = [plant.friction.springs[0] / told.friction.springs[0] for plant in draws(PLANT, told, 50, 0, Spreads())]
    assert 0.5 <= min(shares) < 0.55
    assert 1.4 < max(shares) <= 1.5


@pytest.mark.parametrize("range_of", [(0.5, 1.5), (0.6, 1.0)])
def test_a_felt_stiffness_varies_as_strengths_and_shares_of_hysteresis_do(range_of):
    rng, spreads = np.random.default_rng(0), Spreads(strength=0.06, hysteresis=range_of)
    backbone, added = 5.0, np.array([0.0, 3.0, 12.0])
    off = backbone * np.expm1(0.06 * rng.standard_normal((100_000, 1))) + added * (
        rng.uniform(*range_of, (100_000, 1)) - 1
    )
    assert spreads.felt_std(backbone, backbone + added) == pytest.approx(np.sqrt((off**2).mean(axis=0)), rel=0.02)


def test_the_seed_alone_decides_on_the_draws():
    assert draws(PLANT, TOLD, 4, 7, Spreads()) == draws(PLANT, TOLD, 4, 7, Spreads())
    assert draws(PLANT, TOLD, 4, 7, Spreads()) != draws(PLANT, TOLD, 4, 8, Spreads())
    one, two = np.sign(payloads(2, 0, 5.0, Spreads()))
    assert one == -two


def test_intervals_of_a_fit_narrow_the_draws_down_to_the_error_of_the_model():
    spreads = Spreads.of({"inertia": (0.0490, 0.0510), "lag_up": (0.1, 0.2), "dead_time": (0.0, 0.0)})
    for spread, usual, fitted in ((spreads.inertia, 0.15, 0.02 / 1.96), (spreads.lag, 0.2, 1 / 3 / 1.96)):
        assert spread == pytest.approx(np.hypot(LEAST, (usual**-2 + fitted**-2) ** -0.5))
    hardly_seen = Spreads.of({"dead_time": (0.0, 0.1)})
    assert LEAST < hardly_seen.dead_time < Spreads.dead_time
    assert (spreads.strength, spreads.dead_time) == (Spreads.strength, Spreads.dead_time)


def test_a_file_without_intervals_has_the_usual_spreads(tmp_path):
    path = tmp_path / "plant.toml"
    path.write_text(FILE)
    assert Spreads.load(path) == Spreads()
    path.write_text(FILE + "[intervals]\ninertia = [2.0, 1.0]\n")
    with pytest.raises(InvalidFile, match="inertia"):
        Spreads.load(path)


def test_every_leg_of_the_tour_begins_and_ends_at_rest_without_the_others():
    tour = Tour.of(PLANT, 0.01)
    theta, legs = tour.reference.theta, list(tour.legs.values())
    assert set(tour.legs) == {*MOTIONS, "load", *(f"{name} loaded" for name in MOTIONS)}
    for leg in legs:
        assert np.abs(theta[[leg.start - 1, leg.stop - 1]]).max() < 1e-6
    assert all(before.stop <= after.start for before, after in itertools.pairwise(legs))
    for rest in tour.rests:
        assert not theta[rest].any()
    assert tour.legs["load"].start * 0.01 == pytest.approx(tour.loaded)


@pytest.mark.parametrize("name", TUNABLE)
def test_the_numbers_to_begin_with_are_those_of_the_usual_loop(name):
    tuned, usual = Tuning.start(name, USUAL).applied(USUAL), USUAL
    assert tuned.noise == usual.noise
    assert tuned.weights.theta == pytest.approx(usual.weights.theta, rel=1e-12)
    if name in ("pid", "pi", "predictive-pid"):
        assert tuned.gains == loop(name, usual)[0].gains
        assert loop(name, tuned)[0].gains == tuned.gains
    for number, parameter in zip(Tuning.start(name, USUAL).numbers.values(), TUNABLE[name].values(), strict=True):
        assert parameter.low <= number <= parameter.high


def test_a_tuning_goes_through_a_plants_file_and_leaves_the_rest_alone(tmp_path):
    path, tuning = tmp_path / "plant.toml", Tuning.start("mpc", USUAL)
    path.write_text(FILE + "[tuning]  # an old one\ncontroller = 'pid'\n\n[plant]\ninertia = 0.05  # kept\n")
    text = with_tuning(path, tuning)
    path.write_text(text)
    assert Tuning.load(path) == tuning
    assert text.startswith(FILE)
    assert "inertia = 0.05  # kept" in text
    assert text.count("[tuning]") == 1
    assert pickle.loads(pickle.dumps(tuning)) == tuning


def test_a_joint_whose_defaults_stay_gets_no_table(tmp_path):
    """With a table its weights would be those of one posture, whatever the motion."""
    path, out = tmp_path / "plant.toml", tmp_path / "out.toml"
    path.write_text(FILE + "[tuning]  # an old one\ncontroller = 'pid'\n")
    problem = Problem("mpc", USUAL, (), (), Tour.of(PLANT, 0.01, 5.0), Spreads())
    for rms, stays in ((0.95, True), (0.8, False)):
        found = Tuned(problem, (tried(1.0), tried(rms)))
        found.save(path, out)
        assert (found.stays, Tuning.load(out) is None) == (stays, stays)
        assert out.read_text().startswith(FILE)


def tried(rms, echo=0.0, at=50, peaks=(1.5,)):
    """M_s on the model depends on the response to a disturbed reading: 1 + `echo`, if that is not at the end."""
    response = Margins.of(0.0, 5.0, np.array([1.0, *(echo if k == at else 0.0 for k in range(1, 100))]), 0.01)
    start = Tuning.start("mpc", Settings(PLANT))
    return Evaluation(start, (Figures({"sine": rms}, 0.0, 0.0),), (response,), peaks, 2.0, 0.0)


def test_a_tuning_that_keeps_the_limit_tells_what_it_costs():
    def note(*evaluations):
        return Tuned(None, evaluations).note

    assert not tried(1.0, echo=9.0).robust
    assert note(tried(1.0, echo=9.0), tried(1.2)).startswith("the defaults are more accurate, but exceed a limit ")
    assert note(tried(1.0, echo=9.0), tried(0.8)) == ""
    assert note(tried(1.0), tried(0.8)) == ""


def test_defaults_stay_unless_a_tuning_is_better_by_a_tenth():
    default = tried(1.0)
    for rms, better in ((0.89, True), (0.91, False), (1.2, False)):
        found = Tuned(None, (default, tried(rms)))
        assert (found.after is found.evaluations[1]) == better
        assert found.note.startswith("the defaults stay: ") != better
    assert Tuned(None, (default, tried(0.92))).note.endswith(" lowers their cost by only 8.0%")
    assert Tuned(None, (default,)).note == "the defaults stay: no tuning was better"


def test_draws_may_have_half_as_much_again_of_the_peak():
    """M_s on the draws is their 80 % quantile, the second greatest of six."""
    inside, outside = (tried(1.0, peaks=(1.0, 1.0, 1.0, 1.0, peak, 9.0)) for peak in (2.99, 3.01))
    assert (inside.robust, inside.objective) == (True, 1.0)
    assert (outside.robust, outside.peak_of_draws) == (False, 3.01)
    assert outside.objective == pytest.approx(1.0 + 50 * (1 - 3 / 3.01))
    assert [tried(1.0, echo).robust for echo in (1.09, 1.11)] == [True, False]
    assert not tried(1.0, 1.0, at=99).robust  # it does not settle


def test_wrong_tables_are_named(tmp_path):
    path = tmp_path / "plant.toml"
    lines = "\n".join(Tuning.start("mpc", USUAL).lines())
    for text, named in (
        ('[tuning]\ncontroller = "me"', "me"),
        ("[tuning]\ncontroller = [1]", "unknown controller to tune"),
        ('[tuning]\ncontroller = "mpc"\nd_walk = 1.0', "theta_error"),
        (lines.replace(f"d_walk = {USUAL.noise.d_walk}", "d_walk = -1.0"), "d_walk"),
        (lines.replace(f"d_walk = {USUAL.noise.d_walk}", 'd_walk = "much"'), "d_walk"),
    ):
        path.write_text(text)
        with pytest.raises(InvalidFile, match=named):
            Tuning.load(path)
    path.write_text(FILE)
    assert Tuning.load(path) is None


def test_what_cannot_be_tuned_is_named():
    with pytest.raises(MissingBackend, match="feedforward"):
        Tuning.start("feedforward", USUAL)
    with pytest.raises(InvalidInput, match="hysteresis"):
        Spreads(hysteresis=(1.2, 0.5))
    with pytest.raises(InvalidInput, match="lag"):
        Spreads(lag=-0.1)
