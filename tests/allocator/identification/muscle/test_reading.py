"""A table of forces from a file: what is read, and one clear sentence for what cannot be right."""

import numpy as np
import pytest

from allocator.errors import InvalidFile, InvalidInput, MissingBackend
from allocator.identification import DATASETS, load_dataset, read_samples
from allocator.units import BAR, PSI

EPS, P, F = np.array([0.02, 0.1, 0.2]), np.array([1.5, 3.0, 5.0]) * BAR, np.array([200.0, 400.0, 350.0])


def written(tmp_path, text, encoding="utf-8"):
    path = tmp_path / "data.csv"
    path.write_text(text, encoding=encoding)
    return path


def table(eps="contraction", pressure="pressure_bar", eps_unit=1.0, pressure_unit=BAR):
    rows = "".join(
        f"{e / eps_unit!r},{p / pressure_unit!r},{f!r}\n"
        for e, p, f in zip(EPS.tolist(), P.tolist(), F.tolist(), strict=True)
    )
    return f"{eps},{pressure},force_N\n{rows}"


def same(samples):
    np.testing.assert_allclose(samples.contraction, EPS, rtol=1e-12)
    np.testing.assert_allclose(samples.pressure, P, rtol=1e-12)
    np.testing.assert_allclose(samples.force, F, rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "unit"),
    [("bar", BAR), ("kpa", 1e3), ("kPa", 1e3), ("mpa", 1e6), ("MPa", 1e6), ("psi", PSI), ("Pa", 1.0)],
)
def test_pressures_are_read_in_every_unit(tmp_path, name, unit):
    same(read_samples(written(tmp_path, table(pressure=f"pressure_{name}", pressure_unit=unit))))


def test_contractions_are_read_in_percent(tmp_path):
    same(read_samples(written(tmp_path, table("contraction_pct", eps_unit=0.01))))


@pytest.mark.parametrize(("name", "unit"), [("length_mm", 1e-3), ("length_m", 1.0)])
def test_lengths_become_contractions_by_the_rest_length(tmp_path, name, unit):
    lines = "".join(
        f"{0.3 * (1 - e) / unit!r},{p / BAR!r},{f!r}\n"
        for e, p, f in zip(EPS.tolist(), P.tolist(), F.tolist(), strict=True)
    )
    path = written(tmp_path, f"{name},pressure_bar,force_N\n{lines}")
    same(read_samples(path, rest_length=0.3))
    with pytest.raises(InvalidFile, match="need the rest length"):
        read_samples(path)
    with pytest.raises(InvalidFile, match=r"do not belong to a muscle of 300 m; mm for m\?"):
        read_samples(path, rest_length=300.0)
    with pytest.raises(InvalidInput, match="rest_length = -1 m has to be positive"):
        read_samples(path, rest_length=-1)


def test_semicolons_and_decimal_commas_are_read_right(tmp_path):
    text = "Nr;contraction;pressure_bar;force_N\n1;0,02;1,5;200,0\n2;0,1;3,0;4e2\n3;0,2;5;350\n"
    same(read_samples(written(tmp_path, text)))
    same(read_samples(written(tmp_path, text.replace(",", "."))))
    same(read_samples(written(tmp_path, text.replace(";", "\t"))))


def test_comments_blank_lines_other_columns_and_a_byte_order_mark_do_not_disturb(tmp_path):
    head = "# a muscle\n\nforce_N, pressure_bar , who, contraction\n"
    text = head + "200,1.5,ann,0.02 # first\n\n400,3,,0.1\n# end\n350,5,bob,0.2\n"
    same(read_samples(written(tmp_path, text, encoding="utf-8-sig")))


HEAD = "contraction,pressure_bar,force_N\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is empty"),
        ("# nothing but words\n\n", "is empty"),
        (HEAD, "has column names but no samples"),
        (
            "contraction,pressure,force_N\n0.1,3,400\n",
            "column 'pressure' has no unit: name them such as 'pressure [bar]'",
        ),
        ("contraction,pressure_bar,force\n0.1,3,400\n", 'or say --columns "force=force:N" with your units'),
        ("length,pressure_bar,force_N\n0.1,3,400\n", "column 'length' has no unit: name them such as 'length [mm]'"),
        (
            "contraction,pressure_atm,force_N\n0.1,3,400\n",
            "column 'pressure_atm': has an unknown unit 'atm'; known are",
        ),
        ("contraction,pressure_bar\n0.1,3\n", "has no column for the force among contraction, pressure_bar; name it"),
        ("contraction,contraction_pct,pressure_bar,force_N\n0.1,10,3,4\n", "give the contraction twice"),
        ("contraction,length_mm,pressure_bar,force_N\n0.1,10,3,4\n", "has a contraction, 'contraction', and a length"),
        (HEAD + "0.1,3,400\n0.1,nan,400\n", "line 3, column 'pressure_bar': nan is not a finite number"),
        (HEAD + "0.1,3,400\n0.2,,400\n", "line 3, column 'pressure_bar': a value is missing"),
        (HEAD + "0.1,3,four\n", "line 2, column 'force_N': 'four' is not a number"),
        (HEAD + "0.1,3,400\n0.1,3\n", "line 3: has 2 values under 3 column names"),
        (HEAD + "0,1,3,400\n", "with decimal commas, separate the columns by semicolons"),
        (HEAD + "2,3,400\n20,3,100\n", "line 2, column 'contraction': a contraction ratio of 2 is beyond"),
        (HEAD + "0.1,3,400\n20,3,100\n", "line 3, column 'contraction': a contraction ratio of 20 is beyond any "),
        (HEAD + "0.7,3,400\n", "is the rest length right?"),
        (
            "contraction_pct,pressure_bar,force_N\n0.1,3,400\n0.2,3,100\n",
            "never exceeds 0.2 %, too little; was a ratio of",
        ),
        (HEAD + "0.1,3,400\n0.1,0,150\n", "line 3, column 'pressure_bar': a force of 150 N at 0 bar and the contra"),
        (HEAD + "0,4,900\n0.1,3,400\n0,1.013,2\n", "line 4, column 'pressure_bar': no force at 1.013 bar, the lowest"),
        (HEAD + "0.1,3,400\n0.1,-0.6,0\n", "line 3, column 'pressure_bar': -0.6 bar is below the atmosphere"),
    ],
)
def test_what_cannot_be_right_is_one_clear_sentence(tmp_path, text, said):
    path = written(tmp_path, text)
    with pytest.raises(InvalidFile) as refusal:
        read_samples(path)
    assert said in str(refusal.value)
    assert str(refusal.value).startswith(str(path))
    assert "\n" not in str(refusal.value)


def test_a_length_beyond_the_rest_length_is_put_down_to_it(tmp_path):
    with pytest.raises(InvalidFile, match=r"line 3, column 'length_mm': .* is the rest length right"):
        read_samples(written(tmp_path, "length_mm,pressure_bar,force_N\n280,3,400\n390,3,900\n290,3,500\n"), 0.3)


def test_a_force_of_a_stretched_muscle_at_0_bar_is_real(tmp_path):
    samples = read_samples(written(tmp_path, HEAD + "-0.04,0,684\n0,0,0\n0.1,3,400\n"))
    assert samples.force[0] == 684


def test_a_gauge_file_that_begins_at_1_bar_is_believed(tmp_path):
    assert read_samples(written(tmp_path, HEAD + "0,1.0,253\n0.1,1.0,0\n0,5,1264\n")).n == 3


@pytest.mark.parametrize("content", [b"\xff\xfe\x00a\x00", b"contraction\x00,pressure_bar\n", b"PK\x03\x04\x00\x00"])
def test_what_is_no_text_file_is_refused(tmp_path, content):
    path = tmp_path / "data.csv"
    path.write_bytes(content)
    with pytest.raises(InvalidFile, match="is not a text file; save a spreadsheet as CSV"):
        read_samples(path)


def test_a_file_that_does_not_exist_or_is_a_directory_is_said(tmp_path):
    with pytest.raises(InvalidFile, match="does not exist"):
        read_samples(tmp_path / "data.csv")
    with pytest.raises(InvalidFile, match="cannot be read"):
        read_samples(tmp_path)


@pytest.mark.parametrize(("name", "n", "taut"), [("dmsp-20-300-map", 126, 60), ("dmsp-20-sheet", 58, 48)])
def test_the_tables_of_the_package_are_complete(name, n, taut):
    samples = load_dataset(name)
    assert samples.n == n
    assert (samples.force > 0).sum() == taut
    assert len(DATASETS) == 2


def test_an_unknown_table_is_answered_with_the_known_ones():
    with pytest.raises(MissingBackend, match="unknown data set 'x'; available: dmsp-20-300-map, dmsp-20-sheet"):
        load_dataset("x")


def test_a_column_with_decimal_commas_and_points_is_refused(tmp_path):
    path = written(tmp_path, "contraction;pressure_bar;force_N\n0.02;1.5;987.5\n0.1;3;1,234\n")
    with pytest.raises(InvalidFile, match=r"line 3, column 'force_N': 1,234 has a comma and 987.5 \(line 2\) a point"):
        read_samples(path)
