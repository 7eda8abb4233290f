"""Force tables as somebody else wrote them: each is read, or refused with the sentence that helps.

One known muscle in every file, so that what is read can be compared. The files are for development only (see the
fixture `shared`); `test_columns` covers the same cases with files of its own.
"""

from pathlib import Path

import numpy as np
import pytest

from allocator.errors import InvalidFile
from allocator.identification import fit, read_samples
from allocator.muscles import Sarosi2012
from allocator.muscles.catalogue import named_muscle
from allocator.units import BAR

DATA = Path("data") / "stranger"
KNOWN = "sarosi-dmsp-20-400n"  # the muscle in all of them
READ = {
    "natural.csv": None,
    "parentheses.csv": 0.4,
    "german.csv": None,
    "tabs.tsv": None,
    "comment.csv": None,
    "bom.csv": None,
    "capitals.csv": None,
    "extra_columns.csv": None,
    "kilonewton.csv": None,  # its header says force_kN, and its numbers are kN
}
REFUSED = {
    "semicolon_no_units.csv": "columns 'length', 'pressure', 'force' have no unit: name them such as 'length [mm]'",
    "no_header.csv": "line 1: has no column names",
    "absolute.csv": '"pressure=pressure_bar_abs:bar(abs)" takes the standard atmosphere off',
    "percent_as_ratio.csv": "line 3, column 'contraction': a contraction ratio of 1 is beyond any ",
    "mm_as_m.csv": "line 2, column 'length_m': 400 m is too much; was 400 mm meant?",
    "nan.csv": "line 132, column 'contraction_pct': nan is not a finite number",
}
HELPED = {  # what the sentence says to do, done
    "semicolon_no_units.csv": {"length": "length:mm", "pressure": "pressure:bar", "force": "force:N"},
    "absolute.csv": {"pressure": "pressure_bar_abs:bar(abs)"},
    "percent_as_ratio.csv": {"contraction": "contraction:%"},
    "mm_as_m.csv": {"length": "length_m:mm"},
    "negative_tension.csv": {"force": "force_N:-N"},
}


@pytest.fixture(scope="module")
def folder(shared):
    return shared(DATA)


def is_the_known_muscle(samples):
    assert samples.n == 130
    assert samples.contraction.max() == pytest.approx(0.25)
    np.testing.assert_allclose(
        np.unique(samples.pressure.round()), np.arange(1, 6) * BAR, atol=30
    )  # 1.013 bar taken as 1.01325
    assert samples.force.max() == pytest.approx(1495, abs=0.1)


@pytest.mark.parametrize("name", READ)
def test_a_table_that_says_what_it_holds_is_read(folder, name):
    is_the_known_muscle(read_samples(folder / name, READ[name]))


def test_the_sign_of_a_load_cell_is_recognised_and_said(folder):
    samples = read_samples(folder / "negative_tension.csv", 0.4)
    assert samples.force.min() == pytest.approx(-1495, abs=0.1)
    fitted = fit(Sarosi2012, samples.contraction, samples.pressure, samples.force)
    assert "the forces are negative where the muscle pulls: taken with the other sign" in fitted.samples.notes
    for name, std in fitted.standard_deviations.items():
        assert abs(fitted.muscle.parameters[name] - named_muscle(KNOWN).parameters[name]) < 3 * std, name


@pytest.mark.parametrize("name", REFUSED)
def test_a_table_that_does_not_is_refused_with_line_column_and_likely_unit(folder, name):
    with pytest.raises(InvalidFile) as refusal:
        read_samples(folder / name, 0.4)
    assert REFUSED[name] in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("name", HELPED)
def test_what_the_sentence_says_to_do_helps(folder, name):
    is_the_known_muscle(read_samples(folder / name, 0.4, HELPED[name]))
