"""Logs of a moving joint as laboratories have them: each is read as it was meant, or refused in one sentence.

One known motion in every file: step commands, and an angle that follows them with a lag of 0.3 s.
"""

from datetime import datetime, timedelta

import numpy as np
import pytest

from allocator.errors import InvalidFile, InvalidInput
from allocator.identification import read_joint_log, read_motion_log
from allocator.units import BAR, DEG

N, STEP = 900, 0.02
T = STEP * np.arange(N)


def _commands(seed):
    return 2.5 + np.repeat(np.random.default_rng(seed).uniform(-1, 1, N // 30), 30).round(3)


P1, P2 = _commands(1), _commands(2)
THETA = np.zeros(N)
for _k in range(1, N):
    THETA[_k] = THETA[_k - 1] + STEP / 0.3 * (12 * (P1[_k] - P2[_k]) - THETA[_k - 1])
THETA = THETA.round(3)
HEADER = "t [s],theta [deg],p1 [bar],p2 [bar]"
AT = np.arange(N)


def lines(*columns, separator=",", comma=False, end="\n"):
    """The columns, numbers or words, as text."""
    words = [c if isinstance(c, list) else [f"{x:.3f}" for x in c] for c in columns or (T, THETA, P1, P2)]
    if comma:
        words = [[word.replace(".", ",") for word in column] for column in words]
    return "".join(separator.join(row) + end for row in zip(*words, strict=True))


@pytest.fixture
def written(tmp_path):
    def write(text, encoding="utf-8"):
        path = tmp_path / "log.csv"
        path.write_bytes(text if isinstance(text, bytes) else text.encode(encoding))
        return path

    return write


def is_the_known_motion(log, t=0.002):
    np.testing.assert_allclose(log.t - log.t[0], T, atol=t)
    np.testing.assert_allclose(log.theta, THETA * DEG, atol=1e-9)
    np.testing.assert_allclose([log.P1, log.P2], [P1 * BAR, P2 * BAR], rtol=1e-9)


def refused(path, **options):
    with pytest.raises(InvalidInput) as refusal:
        read_motion_log(path, **options)
    assert "\n" not in str(refusal.value)
    return str(refusal.value)


# --- layouts --------------------------------------------------------------------------------------------------------

LABVIEW = (
    "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\nDecimal_Separator\t,\n"
    "Multi_Headings\tYes\nX_Columns\tOne\nTime_Pref\tAbsolute\nOperator\tlab\nDate\t2024/05/13\n"
    "Time\t12:03:04,5671234\n***End_of_Header***\t\n\t\nChannels\t3\t\t\t\nSamples\t900\t900\t900\t\n"
    "Date\t2024/05/13\t2024/05/13\t2024/05/13\t\nTime\t12:03:04,56\t12:03:04,56\t12:03:04,56\t\n"
    "Y_Unit_Label\tdeg\tbar\tbar\t\nX_Dimension\tTime\tTime\tTime\t\nX0\t0,0E+0\t0,0E+0\t0,0E+0\t\n"
    "Delta_X\t0,020000\t0,020000\t0,020000\t\n***End_of_Header***\t\t\t\t\nX_Value\tangle\tp1\tp2\tComment\n"
)
BODY = lines()
BLANK = [""] * N
LAYOUTS = {
    "LabVIEW": LABVIEW + lines(separator="\t", comma=True, end="\t\n"),
    "LabVIEW without times": LABVIEW + lines(BLANK, THETA, P1, P2, separator="\t", comma=True, end="\t\n"),
    "LabVIEW without comments": LABVIEW + lines(separator="\t", comma=True),
    "rostopic echo -p": "%time,angle [deg],P1 [bar],P2 [bar]\n" + BODY,
    "a header that ends": "***\nlab 5\t1\n***End_of_Header***\n"
    + HEADER.replace(",", "\t")
    + "\n"
    + lines(separator="\t"),
    "oscilloscope": "Time,angle,P1,P2\n(ms),(deg),(bar),(bar)\n\n" + lines(1e3 * T, THETA, P1, P2),
    "units without brackets": "time,angle,P1,P2\ns,deg,bar,bar\n" + BODY,
    "instrument": "Model,MSO54\nFirmware,1.0\nPoints,900\nInterval,0.02\nScale,1.0,1.0,2.0\n\nLabels,,,\n"
    + HEADER
    + "\n"
    + BODY,
    "words above": f'Recorded by Anna\nDate: 13.05.2024\nWhat: "first", good\n\n{HEADER}\n{BODY}',
    "padded words above": f"Experiment 5,,,\nOperator,Anna,,\n,,,\n{HEADER}\n{BODY}",
    "percent signs": f"% made by matlab\n% twice\n{HEADER}\n{BODY}",
    "Excel's directive": "sep=;\n" + HEADER.replace(",", ";") + "\n" + lines(separator=";"),
    "numpy.savetxt": "# " + HEADER.replace(",", " ") + "\n" + lines(separator=" "),
    "savetxt with commas": f"# {HEADER}\n{BODY}",
    "comments below the names": f"# {HEADER}\n# by Anna\n{BODY}",
    "names and units again": "".join(
        "time,angle,P1,P2\ns,deg,bar,bar\n" + "\n".join(BODY.splitlines()[k : k + 300]) + "\n" for k in range(0, N, 300)
    ),
    "aligned": HEADER.replace(",", "  ") + "\n" + lines(separator="   "),
    "bars": HEADER.replace(",", "|") + "\n" + lines(separator="|"),
    "names with tabs": HEADER.replace(",", "\t") + "\n" + BODY,
    "names with commas": HEADER + "\n" + lines(separator="\t"),
    "Windows": (HEADER + "\n" + BODY).replace("\n", "\r\n"),
    "old Mac": (HEADER + "\n" + BODY).replace("\n", "\r"),
    "all quoted": "".join(
        ",".join(f'"{x}"' for x in row.split(",")) + "\n" for row in (HEADER + "\n" + BODY).splitlines()
    ),
    "lines quoted": "".join(f'"{row}"\n' for row in (HEADER + "\n" + BODY).splitlines()),
    "empty columns": HEADER + ",,\n" + lines(end=",,\n"),
    "empty names": HEADER + ",,\n" + BODY,
    "empty cells": HEADER + "\n" + lines(end=",\n"),
    "minus signs": HEADER + "\n" + BODY.replace("-", "\N{MINUS SIGN}"),
    "names again": "".join(HEADER + "\n" + "\n".join(BODY.splitlines()[k : k + 50]) + "\n" for k in range(0, N, 50)),
    "every row twice": HEADER + "\n" + "".join(2 * (row + "\n") for row in BODY.splitlines()),
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_layout_of_the_laboratory_is_read(written, name):
    is_the_known_motion(read_motion_log(written(LAYOUTS[name])))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16", "utf-16-le", "utf-16-be"])
def test_encodings_with_and_without_a_mark_are_recognised(written, encoding):
    is_the_known_motion(read_motion_log(written(HEADER.replace("deg", "°") + "\n" + BODY, encoding)))


def test_lines_above_the_names_are_left_out_where_asked_and_counted(written):
    junk = "1,2,3,4\n5,6,7,8\n9,10,11,12\n"
    path = written(junk + HEADER + "\n" + BODY)
    is_the_known_motion(read_motion_log(path, skip_rows=3))
    assert "line 1: has no column names" in refused(path)
    assert "--skip-rows" in refused(path)
    assert "expected 0 to 904" in refused(path, skip_rows=5000)
    broken = written(junk + HEADER + "\n" + BODY.replace("0.100,", "0.1oo,", 1))
    assert "line 10, column 't [s]': '0.1oo' is not a number" in refused(broken, skip_rows=3)


def test_what_was_not_read_is_listed(written):
    log = read_motion_log(written(LAYOUTS["LabVIEW"]))
    assert log.notes == ("not read: lines 1 to 22, above the column names", "columns not used: Comment")
    assert read_motion_log(written(HEADER + "\n" + BODY)).notes == ()


# --- times ----------------------------------------------------------------------------------------------------------

NANOSECONDS = [f"{1715601784567000000 + round(t * 1e9)}" for t in T]


def clock(form):
    """The times of a clock that passes midnight."""
    start = datetime(2024, 5, 13, 23, 59, 55)
    return [(start + timedelta(seconds=float(t))).strftime(form) for t in T]


@pytest.mark.parametrize(
    "form",
    [
        "%H:%M:%S.%f",
        "%H:%M:%S,%f",
        "%H:%M:%S:%f",
        "%Y-%m-%dT%H:%M:%S.%f",
        "%Y-%m-%d %H:%M:%S.%fZ",
        "%Y-%m-%dT%H:%M:%S,%f+02:00",
        "%d.%m.%Y %H:%M:%S.%f",
        "%d/%m/%Y %H:%M:%S.%f",
        "%m/%d/%Y %I:%M:%S.%f %p",
    ],
)
def test_clock_times_are_read_beyond_midnight(written, form):
    text = "Uhrzeit;Winkel [°];Druck 1 [bar];Druck 2 [bar]\n" + lines(clock(form), THETA, P1, P2, separator=";")
    is_the_known_motion(read_motion_log(written(text)))


@pytest.mark.parametrize("name", ["clock", "Clock time", "time of day", "Uhrzeit"])
def test_a_column_of_clock_times_is_found_by_its_name(written, name):
    text = f"{name},theta [deg],P1 [bar],P2 [bar]\n" + lines(clock("%H:%M:%S.%f"), THETA, P1, P2)
    is_the_known_motion(read_motion_log(written(text)))


@pytest.mark.parametrize(
    ("name", "times"),
    [
        ("timestamp_ns", NANOSECONDS),
        ("t [µs]", 1e6 * T),
        ("t (ms)", 1e3 * T),
        ("time [min]", [f"{t / 60:.9f}" for t in T]),
        ("t [s]", [f"{1715601784.567 + t:.3f}" for t in T]),
        ("Time (hh:mm:ss.ms)", clock("%H:%M:%S.%f")),
    ],
)
def test_stamps_are_read_in_every_unit(written, name, times):
    is_the_known_motion(read_motion_log(written(HEADER.replace("t [s]", name) + "\n" + lines(times, THETA, P1, P2))))


def test_a_german_file_with_stamps_of_a_controller_is_read(written):
    head = "Zeitstempel [ns];Winkel [°];Druck 1 [bar];Druck 2 [bar]\n"
    text = head + lines(NANOSECONDS, THETA, P1, P2, separator=";", comma=True)
    is_the_known_motion(read_motion_log(written(text, "cp1252")))


@pytest.mark.parametrize(
    ("name", "times", "said"),
    [
        ("t", 1e3 * T, "line 2, column 't': samples are 20 s apart, too far to see what moves; ms for s? If so, say"),
        ("stamp", 1e6 * T, '--columns "time=stamp:us"'),
        ("timestamp", NANOSECONDS, '--columns "time=timestamp:ns"'),
        ("t [ms]", T, "the log lasts 0.018 s only; s for ms?"),
        ("t [s]", T[::-1], "line 3, column 't [s]': the rows run backwards in time"),
        ("t [s]", np.where(AT % 20 < 5, T - 0.3, T), "line 22, column 't [s]': time goes back in lines 22, 42, 62"),
        ("Time", clock("%H:%M:%S"), "line 3, column 'Time': time stands still in lines 3, 4, 5, 6, 7, 8, 9 and"),
    ],
)
def test_times_that_cannot_be_are_refused_with_line_and_likely_unit(written, name, times, said):
    assert said in refused(written(HEADER.replace("t [s]", name) + "\n" + lines(times, THETA, P1, P2)))


def test_stretches_between_gaps_are_used_unless_they_are_short_and_that_is_said(written):
    late = T + 5 * (AT >= 150) + 3 * (AT >= 600)
    log = read_motion_log(written(HEADER + "\n" + lines(late, THETA, P1, P2)))
    np.testing.assert_allclose(log.theta, THETA[150:] * DEG, atol=1e-9)
    assert log.parts == (slice(0, 450), slice(450, N - 150))
    assert log.notes == (
        "the log has gaps of more than 1 s before lines 152 and 602: 2 stretches are used; 150 rows in shorter ones "
        "were left out",
    )


def test_rows_that_are_late_are_left_out_and_listed(written):
    times = np.where(AT == 300, 1.0, np.where((AT == 500) | (AT == 501), T[499], T))
    log = read_motion_log(written(HEADER + "\n" + lines(times, THETA, P1, P2)))
    np.testing.assert_allclose(log.theta, THETA[~np.isin(AT, (300, 500, 501))] * DEG, atol=1e-9)
    assert log.notes == ("rows that are not later than an earlier one were left out: lines 302, 502 and 503",)


def test_a_clock_that_begins_anew_begins_a_stretch(written):
    """Two copies of the log in one file, with the column names again between them."""
    log = read_motion_log(written(2 * (HEADER + "\n" + BODY)))
    assert log.parts == (slice(0, N), slice(N, 2 * N))
    np.testing.assert_allclose(log.theta, np.tile(THETA, 2) * DEG, atol=1e-9)
    assert f"the clock begins anew in line {N + 3}: 2 recordings" in log.notes


def test_episodes_of_90_rows_are_one_log_in_one_file_or_in_many(written, tmp_path):
    """Each lasts 1.8 s, and the second half is judged, as the state at its beginning is unknown."""
    whole = read_motion_log(written(HEADER + "\n" + lines(T + 5 * (AT // 90), THETA, P1, P2)))
    paths = [tmp_path / f"{k}.csv" for k in range(N // 90)]
    for k, path in enumerate(paths):
        path.write_text(HEADER + "\n" + lines(*(c[90 * k : 90 * k + 90] for c in (T, THETA, P1, P2))))
    log = read_motion_log(paths)
    for one in (whole, log):
        assert len(one.parts) == N // 90
        np.testing.assert_allclose(one.theta, THETA * DEG, atol=1e-9)
        assert one.settled.sum() == N / 2
    with pytest.raises(InvalidFile, match=r"0.csv, .*1.csv: 180 rows over 3.56 s are too few"):
        read_motion_log(paths[:2])
    with pytest.raises(InvalidInput, match="a file is given twice"):
        read_motion_log([paths[0], paths[0]])


# --- damaged readings -----------------------------------------------------------------------------------------------


def spoiled():
    """Angles that jump at rest and in motion, pressures that drop out: single rows, two rows, and at a step."""
    theta = np.where(np.isin(AT, (25, 33, 77)), THETA + 15, THETA)
    return theta, np.where(np.isin(AT, (100, 101, 450)), 0.0, P1), np.where(AT == 600, 0.01, P2)


def test_all_spikes_and_drop_outs_are_left_out_and_listed(written):
    log = read_motion_log(written(HEADER + "\n" + lines(T, *spoiled())))
    kept = ~np.isin(AT, (25, 33, 77, 100, 101, 450, 600))
    np.testing.assert_allclose(log.theta, THETA[kept] * DEG, atol=1e-9)
    np.testing.assert_allclose(log.P1, P1[kept] * BAR)
    (said,) = log.notes
    assert said.startswith("rows with spikes were left out: column 'theta [deg]' in lines 27, 35 and 79 (the first ")
    assert (
        "column 'p1 [bar]' in lines 102, 103 and 452 (the first 0 bar), column 'p2 [bar]' in line 602 (0.01 bar)"
        in said
    )


def test_a_noisy_sensor_has_no_spikes_and_its_drop_outs_are_found_however_long(written):
    rng = np.random.default_rng(5)
    noisy = P1 + 0.01 * rng.normal(size=N)
    assert read_motion_log(written(HEADER + "\n" + lines(T, THETA, noisy, P2))).notes == ()
    dead = np.where((AT > 400) & (AT < 415), 0.0, noisy)
    log = read_motion_log(written(HEADER + "\n" + lines(T, THETA, dead, P2)))
    assert "column 'p1 [bar]' in lines 403, 404, 405, 406, 407, 408, 409 and 7 more" in log.notes[0]
    assert log.t.size == N - 14


def test_muscles_that_are_vented_again_and_again_have_no_drop_outs(written):
    binary = 2.0 * (np.repeat(np.random.default_rng(3).random(N // 2), 2) < 0.6)
    rare = np.where((AT > 200) & (AT < 260), 0.0, P2)
    log = read_motion_log(written(HEADER + "\n" + lines(T, THETA, binary, rare)))
    np.testing.assert_allclose([log.P1, log.P2], [binary * BAR, rare * BAR])


@pytest.mark.parametrize("spelling", ["", "NaN", "#NV", "N/A", "1.#QNAN", "inf", "ERR", "--"])
def test_missing_values_are_left_out_with_all_lines(written, spelling):
    words = [spelling if k in (77, 99, 500) else f"{p:.3f}" for k, p in enumerate(P1)]
    log = read_motion_log(written(HEADER + "\n" + lines(T, THETA, words, P2)))
    assert log.t.size == N - 3
    assert log.notes == ("rows without a number in every column were left out: lines 79, 101 and 502",)


def test_a_log_whose_end_was_lost_is_read_to_there(written):
    whole = HEADER + "\n" + BODY
    for text in (whole[:-12], whole[:-12] + "\0" * 512):
        log = read_motion_log(written(text))
        assert log.t.size == N - 1
        assert log.notes == (f"line {N + 1}, the last one, is cut off and was not read",)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (HEADER + "\n" + BODY + "End of measurement\n", f"line {N + 2}: has 1 values under 4 column names"),
        (HEADER.replace("p2", "p1") + "\n" + BODY, "line 1: has two columns of the name 'p1 [bar]'"),
        (HEADER + "\n" + lines(T, (40 * THETA) % 360, P1, P2), "° from the row before, as in line"),
        (HEADER + "\n" + BODY.replace(",", " bar,"), "'0.000 bar' is not a number; write the unit into the column's"),
        (
            HEADER + "\n" + lines(*([f'"{x:.3f}"' for x in c] for c in (T, THETA, P1, P2)), comma=True),
            "has a comma; with",
        ),
        (BODY, "line 1: has no column names: name them, such as time [s], theta [deg]"),
        (b"PK\x03\x04 and so on", "is not a text file; save a spreadsheet as CSV"),
        ("<html><body>404</body></html>", "has column names but no samples"),
    ],
)
def test_what_cannot_be_a_log_is_one_sentence(written, text, said):
    assert said in refused(written(text))


def test_rests_of_a_raw_log_do_not_reach_across_a_gap_nor_does_the_direction(written):
    t = np.arange(0, 12, 0.05)
    theta = np.where(t < 3, 0.0, np.where(t < 6, 10.0, np.where(t < 9, 20.0, 5.0)))
    p1 = 2 + theta / 20
    late = np.where(t < 6, t, t + 100)
    header = "t [s],theta [deg],p1 [bar],p2 [bar]"
    log = read_joint_log(written(header + "\n" + lines(late, theta, p1, 2 + 0 * t)))
    assert log.theta / DEG == pytest.approx([0, 10, 20, 5])
    assert log.direction.tolist() == [0, 1, 0, -1]  # nobody saw how it came to 20°
    with pytest.raises(InvalidFile, match=r"line 3, column 't \[s\]': the rows run backwards in time"):
        read_joint_log(written(header + "\n" + lines(t[::-1], theta, p1, 2 + 0 * t)))
