"""A muscle on disk: what is written, and one sentence for every file that is none."""

import tomllib

import pytest

from allocator.errors import InvalidFile, InvalidInput
from allocator.identification import fit, load_dataset
from allocator.muscles import Muscle, Sarosi2012, TonduLopez1995
from allocator.muscles.catalogue import MUSCLES, SAROSI_DMSP_20_400N

GOOD = 'model = "TonduLopez1995"\n[parameters]\nr0 = 0.01\nalpha0 = 0.41\n'
HOGAN = 'model = "Hogan1984"\n[parameters]\neps_max = 0.3\nP_max = 500000\n'


@pytest.fixture
def path(tmp_path):
    return tmp_path / "my.toml"


def test_the_file_is_plain_toml_that_a_person_can_write(path):
    path.write_text(GOOD)
    assert Muscle.load(path) == TonduLopez1995(r0=0.01, alpha0=0.41)


def test_whole_numbers_may_be_written_without_a_point(path):
    path.write_text('model = "Hogan1984"\nparameters = { F_max = 1500, eps_max = 0.3, P_max = 500_000 }\n')
    assert Muscle.load(path).F_max == 1500.0


@pytest.mark.parametrize("character", [chr(code) for code in (0, 7, 9, 10, 13, 31, 34, 92, 127, 128, 0x2028, 0x1F600)])
def test_every_character_survives_in_texts_and_in_names_of_entries(path, character):
    SAROSI_DMSP_20_400N.save(path, {f"made{character}by": f"a{character}b"})
    assert Muscle.load(path) == SAROSI_DMSP_20_400N
    with path.open("rb") as file:
        assert tomllib.load(file)["source"] == {f"made{character}by": f"a{character}b"}


def test_half_a_character_is_refused_before_anything_is_written(path):
    with pytest.raises(InvalidInput, match="half a character"):
        SAROSI_DMSP_20_400N.save(path, {"by": "a\ud800"})
    assert not path.exists()


def test_every_digit_survives(path):
    for muscle in MUSCLES.values():
        muscle.save(path)
        assert Muscle.load(path).parameters == muscle.parameters


def test_the_covariance_and_the_source_travel_with_the_muscle(path):
    measured = load_dataset("dmsp-20-sheet")
    found = fit(Sarosi2012, measured.contraction, measured.pressure, measured.force, pressure_range=(9e4, 7e5))
    found.save(path, {"data": "sheet"})
    loaded = Muscle.load(path)
    assert loaded == found.muscle
    assert loaded.covariance == found.muscle.covariance
    assert loaded.covariance is not None
    assert tomllib.loads(path.read_text())["source"]["data"] == "sheet"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", 'is not a muscle: the line model = "…" is missing'),
        ("model = ", "is not TOML"),
        ('model = "Tondu2031"', "unknown model 'Tondu2031'; known: Hogan1984, "),
        ("model = 3", "unknown model 3"),
        ('model = "Muscle"', "unknown model 'Muscle'"),
        ('model = "TonduLopez1995"', "has no table [parameters]"),
        (GOOD.replace("r0 = 0.01\n", ""), "needs the parameter r0, which is missing"),
        (GOOD + "q = 0.8\n", "has no parameter q; it has r0, alpha0"),
        (GOOD.replace("0.41", '"wide"'), "alpha0 = 'wide' is not a finite number"),
        (GOOD.replace("0.41", "23.5"), "degrees?"),
        (GOOD + "[covariance]\nrows = [[1.0]]\n", "covariance has to be 2 rows of 2 finite numbers"),
        (GOOD + '[covariance]\nrows = [[1.0, "a"], [0.0, 1.0]]\n', "is no covariance, 2 rows of 2 finite numbers"),
        (GOOD + "[covariance]\nrows = [[1.0], [0.0, 1.0]]\n", "is no covariance, 2 rows of 2 finite numbers"),
        (GOOD + "[covariance]\nrows = [[1.0, 0.5], [0.4, 1.0]]\n", "covariance has to be symmetric"),
        (GOOD + "[covariance]\nrows = [[1.0, 5.0], [5.0, 1.0]]\n", "covariance has a negative eigenvalue"),
        (
            GOOD + "[covariance]\nmatrix = [[1.0, 0.0], [0.0, 1.0]]\n",
            "[covariance] has no matrix; it has rows",
        ),
        (GOOD + "[covarience]\nrows = []\n", "a muscle has no covarience; it has model, parameters, source"),
        (GOOD.replace("0.41", '"0.41"'), "alpha0 = '0.41' is not a finite number"),
        (
            HOGAN + "F_max = 1e300",
            "the force of this Hogan1984 is 1e+300 N at 5 bar and rest length; check F_max = 1e+300",
        ),
        (HOGAN.replace("0.3", "30") + "F_max = 1500.0", "this Hogan1984 contracts up to the ratio 30; if percent was"),
        (HOGAN + "F_max = -1500.0", "is -1500 N at 5 bar and rest length; check F_max = -1500, eps_max = 0.3, P_max"),
        (GOOD.replace("0.41", "true"), "alpha0 = True is not a finite number"),
    ],
)
def test_a_file_that_is_no_muscle_is_one_sentence_with_its_name(path, text, said):
    path.write_text(text)
    with pytest.raises(InvalidFile) as refusal:
        Muscle.load(path)
    assert said in str(refusal.value)
    assert str(refusal.value).startswith(str(path))
    assert "\n" not in str(refusal.value)


def test_the_mark_with_which_some_editors_begin_a_file_does_no_harm(path):
    path.write_text(GOOD, encoding="utf-8-sig")
    assert Muscle.load(path) == TonduLopez1995(0.01, 0.41)


def test_a_joint_s_muscle_may_push_where_it_was_never_measured(path):
    parameters = {"c1": -0.00241, "c2": -0.00685, "c3": 0.00185, "c4": -140.0, "c5": -106.0, "c6": -26.0}
    muscle = Sarosi2012(**parameters)
    assert muscle.force(5e5, 0.0) < 0 < muscle.force(5e5, 0.1)
    muscle.save(path)
    assert Muscle.load(path) == muscle


def test_a_toml_from_another_model_is_refused(path):
    path.write_text(GOOD)
    with pytest.raises(InvalidFile, match="holds a TonduLopez1995, not a Sarosi2012"):
        Sarosi2012.load(path)


def test_a_file_that_does_not_exist_is_named(path):
    with pytest.raises(InvalidFile, match="does not exist"):
        Muscle.load(path)


def test_bytes_that_are_no_text_are_refused(path):
    path.write_bytes(b"\xff\xfe\x00model")
    with pytest.raises(InvalidFile, match="is no text in UTF-8"):
        Muscle.load(path)


def test_a_source_that_toml_cannot_hold_is_refused(path):
    with pytest.raises(ValueError, match="neither text nor a number"):
        SAROSI_DMSP_20_400N.save(path, {"when": [1, 2]})
