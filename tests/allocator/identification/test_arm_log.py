"""Logs of arms as laboratories have them, and the command that fits them."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from allocator.cli import app
from allocator.errors import InvalidFile, InvalidInput
from allocator.identification import read_arm_log
from allocator.units import BAR, DEG

from .test_arm import EPISODES, PAIRS, STEP

FULL = 5.0  # [bar]
HEADER = "time [s],q1 [deg],q2 [deg],p1 [bar],p2 [bar],p3 [bar],p4 [bar]"


def rows(episode):
    """Time [s], angles [deg] and pressures [bar]."""
    return np.column_stack([STEP * np.arange(len(episode.q)), episode.q / DEG, FULL * episode.p])


@pytest.fixture
def written(tmp_path):
    def write(table, header=HEADER, name="arm.csv"):
        np.savetxt(tmp_path / name, table, delimiter=",", header=header, comments="", fmt="%.10g")
        return tmp_path / name

    return write


ONE = EPISODES[0]
KPA = rows(ONE) * [1, 1, 1, 100, 100, 100, 100]
LAYOUTS = {
    "usual": (rows(ONE), HEADER),
    "other words, units and order": (
        KPA[:, [6, 0, 3, 2, 4, 1, 5]],
        "p4/kPa,t,P1 (kPa),angle2 [deg],Druck2 kPa,θ1 [°],p_3_kPa",
    ),
    "speeds": (np.column_stack([rows(ONE), ONE.v]), HEADER + ",v1_rad_s,v2 [rad/s]"),
    "speeds of one joint alone": (np.column_stack([rows(ONE), ONE.v[:, 0]]), HEADER + ",v1_rad_s"),
    "more columns": (
        np.column_stack([rows(ONE), ONE.v, ONE.v]),
        HEADER + ",torque1 [Nm],note,q1_ref [deg],p1_command [bar]",
    ),
    "voltages": (np.column_stack([rows(ONE), ONE.v]), HEADER + ",v1 [V],v2 [V]"),
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_columns_are_found_by_name_and_unit(written, name):
    (episode,), notes = read_arm_log(written(*LAYOUTS[name]))
    np.testing.assert_allclose(episode.q, ONE.q, atol=1e-9)
    np.testing.assert_allclose(episode.v, ONE.v, atol=1e-6)
    np.testing.assert_allclose(episode.p, FULL * BAR * ONE.p, rtol=1e-6)
    assert episode.step == pytest.approx(STEP)
    assert not notes


def test_pressures_may_be_in_an_unknown_unit_and_columns_have_any_names(written):
    names = {"time": "stamp:s", "theta1": "elbow:deg", "q2": "wrist:deg"} | {f"p{i + 1}": "abcd"[i] for i in range(4)}
    (episode,), _ = read_arm_log(written(rows(ONE), "stamp,elbow,wrist,a,b,c,d"), names)
    np.testing.assert_allclose(episode.p, FULL * ONE.p, rtol=1e-6)
    np.testing.assert_allclose(episode.q, ONE.q, atol=1e-9)


def test_a_column_may_be_given_in_two_units_if_one_is_ignored_or_chosen(written):
    path = written(np.column_stack([rows(ONE), ONE.q[:, 0]]), HEADER + ",q1 [rad]")
    for columns in ({"ignore": "q1 [rad]"}, {"theta1": "q1 [deg]:deg"}, {"q1": "q1 [rad]:rad"}):
        (episode,), _ = read_arm_log(path, columns)
        np.testing.assert_allclose(episode.q, ONE.q, atol=1e-9)


def test_a_gap_and_a_clock_that_begins_anew_end_an_episode_and_bad_rows_are_interpolated(written):
    table = np.concatenate([rows(ONE), rows(EPISODES[1])])
    table[40:90, 0] += 3
    table[20, 1], table[60, 2] = np.nan, table[60, 2] + 50
    episodes, notes = read_arm_log(written(table))
    assert [len(e.q) for e in episodes] == [40, 50, 90]
    np.testing.assert_allclose(episodes[2].q, EPISODES[1].q, atol=1e-9)
    np.testing.assert_allclose(np.concatenate([episodes[0].q, episodes[1].q]), ONE.q, atol=0.3 * DEG)
    assert [note.partition(":")[0] for note in notes] == [
        "rows without a number in every column were left out",
        "the clock begins anew in line 92",
        "rows with spikes were left out",
    ]


@pytest.mark.parametrize(
    ("header", "said"),
    [
        (HEADER.replace("q1 [deg]", "q1"), "column 'q1': has no unit; known are deg, rad"),
        (HEADER.replace("q1 [deg]", "q1 [turns]"), "column 'q1 [turns]': has an unknown unit 'turns'"),
        (HEADER.replace("p4 [bar]", "load"), "has no column for pressure4 among time [s], q1 [deg]"),
        (HEADER.replace("q1 [deg]", "load"), "has no column for theta1 among"),
        (HEADER.replace("q2 [deg]", "p5 [bar]"), "has 5 pressures for 1 joints, two each are needed"),
        (HEADER.replace("p4 [bar]", "p4"), "gives some pressures with a unit and others without"),
        (
            HEADER.replace("p4 [bar]", "p3 [psi]"),
            "column 'p3 [psi]': gives pressure3 again: leave one out by --columns",
        ),
        (HEADER.replace("q2 [deg]", "q2"), "column 'q2': has no unit; known are deg, rad"),
        (HEADER.replace("time [s]", "row"), "has no column for the time"),
    ],
)
def test_what_is_no_log_of_an_arm_is_refused_in_one_sentence(written, header, said):
    with pytest.raises(InvalidFile) as refusal:
        read_arm_log(written(rows(ONE), header))
    assert said in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_log_that_is_too_short_and_a_column_that_is_not_there_are_refused(written):
    with pytest.raises(InvalidFile, match="has no stretch of 10 rows without a gap"):
        read_arm_log(written(rows(ONE)[:6]))
    with pytest.raises(InvalidInput, match="there is no column 'nose'"):
        read_arm_log(written(rows(ONE)), {"theta1": "nose:deg"})


def test_a_recording_is_read_by_its_topics(tmp_path):
    from ..test_bags import write_json

    joints = [{"position": q.tolist()} for q in ONE.q]
    valves = [{"bar": (FULL * p).tolist()} for p in ONE.p]
    stamps = [round(1e9 * STEP * k) for k in range(len(ONE.q))]
    series = {"/joints": list(zip(stamps, joints, strict=True)), "/valves": list(zip(stamps, valves, strict=True))}
    topics = [f"q{i + 1}=/joints.position[{i}]" for i in range(2)] + [
        f"p{i + 1}=/valves.bar[{i}]:bar" for i in range(4)
    ]
    (episode,), _ = read_arm_log(write_json(tmp_path / "a.mcap", series), topics=" ".join(topics))
    np.testing.assert_allclose(episode.q, ONE.q, atol=1e-8)
    np.testing.assert_allclose(episode.p, FULL * BAR * ONE.p, rtol=1e-7)


@pytest.mark.slow
def test_the_command_finds_the_muscles_and_predicts_left_out_episodes(written):
    paths = [str(written(rows(e), name=f"{k}.csv")) for k, e in enumerate(EPISODES[:4])]
    done = CliRunner().invoke(app, ["fit-arm", *paths, "--no-terms", "--horizon", "20", "--json"])
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert told["episodes"] == 4
    assert [(j["raised_by"] - 1, j["lowered_by"] - 1) for j in told["joints"]] == list(PAIRS)
    assert all(j["error_deg"] < 0.05 * j["hold_deg"] for j in told["joints"])
    shown = CliRunner().invoke(app, ["fit-arm", *paths, "--no-terms", "--horizon", "20"])
    assert "4 episodes, 360 rows, 10 ms apart" in shown.output
