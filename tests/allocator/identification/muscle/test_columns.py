"""Files as people have them: names of columns in several manners and languages, mappings, and units that cannot be."""

import numpy as np
import pytest

from allocator.errors import InvalidFile, InvalidInput
from allocator.identification import read_joint_log, read_samples
from allocator.identification.columns import ATMOSPHERE, parse_columns
from allocator.identification.headers import meaning_of
from allocator.units import BAR, DEG, PSI

EPS, P, F = (
    np.array([0.0, 0.02, 0.1, 0.2]),
    np.array([1.5, 2.0, 3.0, 5.0]) * BAR,
    np.array([250.0, 270.0, 400.0, 350.0]),
)
L0 = 0.4


def written(tmp_path, header, *columns, separator=",", comma=False, encoding="utf-8"):
    rows = [separator.join(f"{x:.10g}" for x in row) for row in zip(*columns, strict=True)]
    text = "\n".join(rows).replace(".", ",") if comma else "\n".join(rows)
    path = tmp_path / "data.csv"
    path.write_text(f"{header}\n{text}\n", encoding=encoding)
    return path


def same(samples):
    np.testing.assert_allclose(samples.contraction, EPS, atol=1e-9)
    np.testing.assert_allclose(samples.pressure, P, rtol=1e-8)
    np.testing.assert_allclose(samples.force, F, rtol=1e-8)


@pytest.mark.parametrize(
    ("header", "eps", "p", "f"),
    [
        ("eps [%], p [bar], F [N]", 0.01, BAR, 1),
        ("ε,P (kPa),F/N", 1, 1e3, 1),
        ("Contraction_pct,PRESSURE_BAR,Force_N", 0.01, BAR, 1),
        ("contraction ratio,gauge pressure [psig],force [lbf]", 1, PSI, 4.4482216152605),
        ("Kontraktion in %,Druck in mbar,Kraft in kN", 0.01, 100, 1e3),
        ("contraction [-],pression (bar rel),Force [N]", 1, BAR, 1),
        ("epsilon [percent],Pressure MPa,muscle force [N]", 0.01, 1e6, 1),
        ("contraction (%),pressure/kPa,pulling force / N", 0.01, 1e3, 1),
        ("eps [%],p [bar],load cell [kg]", 0.01, BAR, 9.80665),
    ],
)
def test_units_stand_in_brackets_or_after_the_quantity_in_several_languages(tmp_path, header, eps, p, f):
    same(read_samples(written(tmp_path, header, EPS / eps, P / p, F / f)))


@pytest.mark.parametrize(("unit", "scale"), [("mm", 1e-3), ("cm", 1e-2), ("m", 1.0), ("in", 0.0254)])
def test_lengths_are_read_in_every_unit(tmp_path, unit, scale):
    path = written(tmp_path, f"Pressure (kPa),Length ({unit}),Force (N)", P / 1e3, L0 * (1 - EPS) / scale, F)
    same(read_samples(path, L0))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
def test_german_files_with_decimal_commas_are_read_in_the_encodings_of_spreadsheets(tmp_path, encoding):
    header = "Überdruck [bar];Länge [mm];Kraft [N];Prüfer [°]"
    columns = P / BAR, 1e3 * L0 * (1 - EPS), F, 0 * F
    same(read_samples(written(tmp_path, header, *columns, separator=";", comma=True, encoding=encoding), L0))


@pytest.mark.parametrize(
    ("name", "quantity", "unit"),
    [
        ("P1_bar", "pressure1", "bar"),
        ("p 2 [MPa]", "pressure2", "MPa"),
        ("θ (°)", "theta", "deg"),
        ("phi [rad]", "theta", "rad"),
        ("Winkel in Grad", "theta", "deg"),
        ("torque [N·m]", "torque", "Nm"),
        ("Torque N m", "torque", "Nm"),
        ("t", "time", ""),
        ("time [ms]", "time", "ms"),
        ("l0_mm", "rest_length", "mm"),
        ("l [in]", "length", "in"),
        ("Shortening %", "contraction", "%"),
        ("stroke [mm]", "shortening", "mm"),
    ],
)
def test_a_name_is_a_quantity_and_a_unit(name, quantity, unit):
    assert meaning_of(name)[:2] == (quantity, unit)


@pytest.mark.parametrize(
    "name", ["theta_ref_deg", "P1_command_bar", "stiffness", "F1", "omega_deg_per_s", "", "#", "bar"]
)
def test_a_name_with_further_words_is_another_quantity(name):
    assert meaning_of(name) is None


def test_what_the_caller_says_goes_before_the_names(tmp_path):
    header = "time,pressure,strain,F left,F right"
    path = written(tmp_path, header, 0 * F, (P + ATMOSPHERE) / PSI, 100 * EPS, 0 * F, -F / 1e3)
    columns = parse_columns("pressure=pressure:psi(abs),eps=strain:%, force = F right : -kN")
    assert columns == {"pressure": "pressure:psi(abs)", "eps": "strain:%", "force": "F right : -kN"}
    same(read_samples(path, columns=columns))


def test_a_mapping_chooses_between_two_columns(tmp_path):
    path = written(tmp_path, "eps,length [mm],p [bar],pressure [kPa],F [N]", EPS, 0 * F + 1, 0 * P, P / 1e3, F)
    same(read_samples(path, columns={"contraction": "eps", "pressure": "pressure [kPa]"}))


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"pressure": "q:bar"}, "has no column 'q' among eps, p, F [N]"),
        ({"pressure": "p"}, "pressure=p needs a unit after a colon, one of bar, kPa"),
        ({"pressure": "p:kg"}, "needs a unit after a colon"),
        ({"colour": "p:bar"}, "'colour' is no quantity; known are contraction"),
        (
            {"theta": "p:deg"},
            "there is no theta to be read, only contraction, length, shortening, pressure, force",
        ),
    ],
)
def test_a_mapping_that_cannot_be_is_one_sentence(tmp_path, columns, said):
    with pytest.raises(InvalidInput) as refusal:
        read_samples(written(tmp_path, "eps,p,F [N]", EPS, P / BAR, F), columns=columns)
    assert said in str(refusal.value)


@pytest.mark.parametrize(
    "text", ["pressure", "pressure=", "=p:bar", "pressure=p:bar,pressure=q:bar", "pressure=p:bar force=F:N"]
)
def test_a_mapping_on_the_command_line_that_is_none_is_refused(text):
    with pytest.raises(InvalidInput, match="--columns"):
        parse_columns(text)


@pytest.mark.parametrize(
    ("header", "said"),
    [
        ("eps [%],eps [%],p [bar],F [N]", "has two columns of the name 'eps [%]'; rename one"),
        ("eps [%],contraction,p [bar],F [N]", "'eps [%]' and 'contraction' give the contraction twice; choose by"),
        ("eps [%],length [mm],p [bar],F [N]", 'choose by --columns "contraction=eps [%]" or "length=length [mm]"'),
        ("eps,x,p,F", "columns 'p', 'F' have no unit: name them such as 'p [bar]', or say --columns \"pressure=p:bar,"),
        ("eps,x,p [bar],Sensor B [lbf]", 'or say --columns "force=Sensor B [lbf]"'),
        ("eps,x,A (psi),F [N]", 'or say --columns "pressure=A (psi)"'),
        ("eps,x,A,F [N]", "or say --columns pressure=NAME:bar"),
        ("1,2,3,4", "line 1: has no column names: name them, such as contraction [%], pressure [bar], force [N]"),
        ("eps,x,p [bar(a)],F [N]", 'is absolute, gauge pressure is wanted: --columns "pressure=p [bar(a)]:bar(abs)"'),
        ("eps,x,absolute pressure [kPa],F [N]", ':kPa(abs)" takes the standard atmosphere off, 1.01325 bar'),
    ],
)
def test_what_the_names_leave_open_is_asked_in_one_sentence(tmp_path, header, said):
    with pytest.raises(InvalidFile) as refusal:
        read_samples(written(tmp_path, header, EPS, EPS, P / BAR, F))
    assert said in str(refusal.value)


@pytest.mark.parametrize(
    ("header", "scales", "said"),
    [
        (
            "eps,pressure_bar,F_N",
            (1, PSI, 1),
            "line 5, column 'pressure_bar': 72.5189 bar is too much; was 72.5189 psi",
        ),
        ("eps,pressure_bar,F_N", (1, 1e3, 1), "500 bar is too much; was 500 kPa meant?"),
        ("eps,pressure_bar,F_N", (1, 1e6, 1), "never exceeds 0.5 bar, too little; was 0.5 MPa meant?"),
        ("eps,pressure_bar,F_N", (1, 1, 1), "500000 bar is too much; was 500000 Pa meant?"),
        ("eps,pressure_kPa,F_N", (1, BAR, 1), "never exceeds 5 kPa, too little; was 5 bar meant?"),
        ("eps,pressure_bar,F_N", (1, BAR, 1e3), "line 4, column 'F_N': never exceeds 0.4 N, too little; was 0.4 kN"),
        ("eps,pressure_bar,F_kN", (1, BAR, 1), "400 kN is too much; was 400 N or 400 lbf or 400 kgf meant?"),
        ("eps_pct,pressure_bar,F_N", (1, BAR, 1), "never exceeds 0.2 %, too little; was a ratio of 0.2 meant?"),
        ("eps,pressure_bar,F_N", (0.01, BAR, 1), "line 3, column 'eps': a contraction ratio of 2 is beyond any"),
    ],
)
def test_numbers_that_cannot_be_in_their_unit_are_pointed_out(tmp_path, header, scales, said):
    eps, p, f = scales
    path = written(tmp_path, header, EPS / eps, P / p, F / f)
    with pytest.raises(InvalidFile) as refusal:
        read_samples(path)
    assert said in str(refusal.value)


def test_millimetres_under_metres_are_pointed_out(tmp_path):
    path = written(tmp_path, "length_m,pressure_bar,F_N", 1e3 * L0 * (1 - EPS), P / BAR, F)
    with pytest.raises(InvalidFile, match=r"line 2, column 'length_m': 400 m is too much; was 400 mm meant\?"):
        read_samples(path)


def test_a_unit_that_the_caller_gives_is_not_doubted(tmp_path):
    path = written(tmp_path, "eps,pressure_bar,F_N", EPS, P / 10 / BAR, F)
    with pytest.raises(InvalidFile, match='If not, say --columns "pressure=pressure_bar:bar"'):
        read_samples(path)
    np.testing.assert_allclose(read_samples(path, columns={"pressure": "pressure_bar:bar"}).pressure, P / 10)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('eps,p [bar],F [N],who\n0,1,300,a\n0,2,"300,b\n0,3,500,c\n', "line 3: a quotation mark is not closed"),
        ("eps,p [bar],F [N],who\n0,1,300," + 140_000 * "a" + "\n", "line 2: a cell has over 131072 characters"),
        ("eps,p [bar],F [N]\n0,,300\n0,,400\n", "line 2, column 'p [bar]': a value is missing"),
        ("eps,p [bar],F [N]\n0,1,300\n0,2,inf\n", "line 3, column 'F [N]': inf is not a finite number"),
    ],
)
def test_a_damaged_file_is_one_sentence(tmp_path, text, said):
    path = tmp_path / "data.csv"
    path.write_text(text)
    with pytest.raises(InvalidFile) as refusal:
        read_samples(path)
    assert said in str(refusal.value)


def test_empty_columns_and_rows_of_a_spreadsheet_and_quoted_names_do_not_disturb(tmp_path):
    rows = [f'{e},"{p}",,{f},,' for e, p, f in zip(EPS, P / BAR, F, strict=True)]
    path = tmp_path / "data.csv"
    path.write_text("\n".join(['eps,"p\n[bar]",,F [N],', *rows, ",,,,", ",,,,,"]))
    same(read_samples(path))


def test_a_hash_among_the_names_begins_no_comment(tmp_path):
    same(read_samples(written(tmp_path, "Sample #,eps,p [bar],F [N]", np.arange(EPS.size), EPS, P / BAR, F)))


@pytest.mark.parametrize("header", ["t,P1_bar,P2_bar,phi [deg]", "Zeit [s],Druck 1 [bar],Druck 2 [bar],Winkel [°]"])
def test_the_names_of_joint_logs_are_read_as_well(tmp_path, header):
    t = np.arange(0, 5, 0.05)
    log = read_joint_log(written(tmp_path, header, t, 2 + 0 * t, 3 + 0 * t, -20 + 0 * t))
    assert log.theta == pytest.approx([-20 * DEG])
    assert log.P2 == pytest.approx([3 * BAR])


def test_a_joint_log_without_units_is_asked_for_them_and_takes_a_mapping(tmp_path):
    t = np.arange(0, 5, 0.05)
    path = written(tmp_path, "t,p1,p2,phi", t, 2 + 0 * t, 3 + 0 * t, -20 + 0 * t)
    with pytest.raises(InvalidFile, match='"theta=phi:deg,pressure1=p1:bar,pressure2=p2:bar"'):
        read_joint_log(path)
    columns = {"theta": "phi:-deg", "pressure1": "p1:bar", "pressure2": "p2:bar"}
    assert read_joint_log(path, columns=columns).theta == pytest.approx([20 * DEG])


@pytest.mark.parametrize(
    ("header", "scale", "said"),
    [
        (
            "t,p1_bar,p2_bar,phi_deg",
            (1, 1, DEG),
            "column 'phi_deg': never exceeds 0.349066 deg, too little; was 0.349066 rad",
        ),
        ("t,p1_bar,p2_bar,phi_rad", (1, 1, 1), "20 rad is too much; was 20 deg meant?"),
        (
            "t,p1_bar,p2_bar,phi_deg",
            (1000, 1, 1),
            "line 2, column 't': samples are 50 s apart, too far to see what moves; ms",
        ),
        ("t,p1_bar,p2_bar,phi_deg", (1, 100, 1), "column 'p2_bar': 300 bar is too much; was 300 kPa meant?"),
    ],
)
def test_joint_logs_in_other_units_than_said_are_pointed_out(tmp_path, header, scale, said):
    t = np.arange(0, 5, 0.05)
    path = written(
        tmp_path, header, scale[0] * t, scale[1] * (2 + 0 * t), scale[1] * (3 + 0 * t), scale[2] * (20 + 0 * t)
    )
    with pytest.raises(InvalidFile) as refusal:
        read_joint_log(path)
    assert said in str(refusal.value)


@pytest.mark.parametrize(
    ("unit", "newtons"), [("kg", 9.80665), ("g", 9.80665e-3), ("gf", 9.80665e-3), ("kp", 9.80665), ("mN", 1e-3)]
)
def test_a_load_cell_in_kilograms_or_grams_is_read_as_the_weight_of_them(tmp_path, unit, newtons):
    same(read_samples(written(tmp_path, f"eps [%], p [bar], Load ({unit})", 100 * EPS, P / BAR, F / newtons)))


@pytest.mark.parametrize("name", ["Hub [mm]", "shortening_mm"])
def test_a_shortening_is_a_contraction_times_the_rest_length(tmp_path, name):
    path = written(tmp_path, f"{name},p [bar],F [N]", 1e3 * L0 * EPS, P / BAR, F)
    same(read_samples(path, L0))
    with pytest.raises(InvalidFile, match=r"lengths need the rest length"):
        read_samples(path)


def test_a_column_is_chosen_by_its_name_with_or_without_the_unit(tmp_path):
    path = written(
        tmp_path, "Strain (%),Extension [mm],p [bar],cell [gf]", -100 * EPS, -400 * EPS, P / BAR, F / 9.80665e-3
    )
    for chosen in ({"contraction": "strain:-%"}, {"shortening": "Extension [mm]:-mm"}, {"shortening": "extension:-mm"}):
        same(read_samples(path, L0, {**chosen, "force": "cell:gf"}))
