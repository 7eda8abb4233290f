"""`antagonist map` as a person meets it, and the pictures that it draws."""

import csv

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from allocator import report_joint
from allocator.feasibility import feasibility_map, plot_maps, plot_pressures, stiffness_interval
from allocator.feasibility.cli import map_command
from allocator.feasibility.plotting import limit_text, outlines
from allocator.joint.limits import Limit
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR, DEG

app = typer.Typer(pretty_exceptions_enable=False)
app.command("map")(map_command)


def run(*arguments):
    return CliRunner().invoke(app, [*map(str, arguments)])


def test_out_of_the_box_it_draws_the_report_s_map(tmp_path):
    result = run("--out", tmp_path / "map.png")
    assert result.exit_code == 0
    assert "combinations exist" in result.output
    assert "bounded by: agonist slack, antagonist slack, P2 upper, P1 upper, joint range" in result.output
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")


def test_the_table_agrees_with_the_interval(tmp_path):
    assert run("--theta", "-90:90:30", "--stiffness", "6:10:0.5", "--out", tmp_path / "map.csv").exit_code == 0
    with (tmp_path / "map.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 7 * 9
    for row in rows:
        K_min, K_max = stiffness_interval(float(row["theta_deg"]) * DEG)
        assert (row["status"] == "EXACT") == (K_min <= float(row["stiffness_Nm_per_rad"]) <= K_max)


def test_another_muscle_pulley_and_supply_and_arrays(tmp_path):
    SAROSI_DMSP_20_400N.save(tmp_path / "my.toml")
    options = (
        "--muscle",
        tmp_path / "my.toml",
        "--radius",
        25,
        "--supply",
        4,
        "--stops",
        "-60:60",
        "--torque",
        "0:2:1",
    )
    assert run(*options, "--out", tmp_path / "map.npz").exit_code == 0
    with np.load(tmp_path / "map.npz") as stored:
        assert stored["T"] == pytest.approx([0, 1, 2])
        assert stored["theta"][[0, -1]] / DEG == pytest.approx([-60, 60])
        assert stored["P1"].max() == pytest.approx(4 * BAR)


def test_a_number_for_the_angle_shows_torque_against_stiffness(tmp_path):
    assert run("--theta", 30, "--out", tmp_path / "map.npz").exit_code == 0
    with np.load(tmp_path / "map.npz") as stored:
        assert stored["theta"].shape == ()
        assert stored["T"].size == stored["K"].size == 201


def test_muscles_are_compared_on_one_picture_and_pressures_drawn(tmp_path):
    muscles = ("--muscle", "sarosi-dmsp-20-400n", "--muscle", "tondu-dmsp-20-400n")
    assert run(*muscles, "--out", tmp_path / "two.png").exit_code == 0
    assert run("--pressures", "--torque", 2, "--out", tmp_path / "pressures.png").exit_code == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--theta", "90:-90"], "--theta: the bounds 90 and -90 ° are reversed"),
        (["--theta", "0:90:0"], "--theta: a step of 0 ° does not lead from 0 to 90 °"),
        (["--theta", "0:90:-1"], "--theta: a step of -1 ° does not lead from 0 to 90 °"),
        (["--theta", "0:90:100"], "--theta: a step of 100 ° is longer than the range"),
        (["--stiffness", "7:7"], "--stiffness from 7 to 7 N·m/rad is an empty range"),
        (["--torque", "0:1:1e-9"], "--torque: 1e+09 steps of 1e-09 N·m are too many"),
        (["--torque", "0:nan"], "these have to be finite"),
        (["--theta", "a:b"], "--theta a:b: expected NUMBER or LOW:HIGH or LOW:HIGH:STEP, such as -90:90:1"),
        (["--stops", "3"], "--stops 3: expected LOW:HIGH"),
        (["--out", "map.gif"], "--out map.gif: the ending has to be one of .png, .pdf, .svg, .csv, .npz"),
        (["--muscle", "magic"], "unknown muscle 'magic'; available: a file ending in .toml, martens-dmsp-20-300"),
        (["--muscle", "nowhere.toml"], "nowhere.toml"),
        (["--torque", "0:9:0.001", "--max-memory", "0.5"], "needs 7.72 GB, max_bytes = 0.5 GB"),
        (["--theta", "10", "--stiffness", "8", "--torque", "1"], "two or three of theta, K and T"),
        (["--out", "afile/map.png"], "afile/map.png cannot be written (afile is a file, not a directory)"),
        (
            ["--muscle", "tondu-mckibben", "--muscle", "sarosi-dmsp-20-400n", "--pressures"],
            "several muscles are for pictures of the edges",
        ),
    ],
)
def test_wrong_input_is_one_sentence(arguments, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "afile").touch()
    result = run(*arguments)
    assert result.exit_code == 1
    assert said in str(result.exception)
    assert "\n" not in str(result.exception)


# --- pictures -------------------------------------------------------------------------------------------------------


def labels(axes):
    return [text.get_text() for text in axes.texts]


def test_a_label_without_space_inside_the_set_is_left_out():
    axes = feasibility_map(joint=report_joint(SAROSI_DMSP_20_400N)).plot()
    assert labels(axes) == ["both slack", "P2 upper", "P1 upper"]


def test_the_map_shows_the_set_with_its_edges_named_and_units_on_the_axes():
    axes = feasibility_map().plot()
    assert labels(axes) == ["both slack", "P2 upper", "P1 upper", "joint range", "joint range"]
    assert axes.get_xlabel() == "joint angle θ [°]"
    assert axes.get_ylabel() == "isobaric stiffness K [N·m/rad]"
    degrees, K = max((line.get_data() for line in axes.lines), key=lambda xy: np.max(xy[1]))
    assert K.max() == pytest.approx(10.575, abs=1e-3)
    assert np.abs(degrees).max() == pytest.approx(125)


def test_labels_are_inside_the_picture_and_do_not_lie_on_the_edges():
    for held in ({"T": 0.0}, {"T": 3.0}, {"theta": 0.5, "T": None}, {"K": 8.0, "T": None}):
        axes = feasibility_map(**held).plot()
        axes.figure.canvas.draw()
        frame = axes.get_window_extent()
        for text in axes.texts:
            box = text.get_window_extent()
            assert frame.x0 <= box.x0 < box.x1 <= frame.x1 + 1
            assert frame.y0 - 1 <= box.y0 < box.y1 <= frame.y1 + 1


def test_the_area_of_the_outline_is_the_share_of_feasible_cells():
    found = feasibility_map(None, np.linspace(6, 11, 401), 2.0)
    x, y = outlines(found)[0]
    area = abs(np.sum(x * np.roll(y, 1) - y * np.roll(x, 1))) / 2
    assert found.share == pytest.approx(area / (250 * 5), rel=0.01)


def test_several_torques_are_drawn_on_one_picture_with_a_legend_outside():
    axes = feasibility_map(None, None, np.array([0.0, 3.0, 6.0])).plot()
    legend = axes.get_legend()
    names = [text.get_text() for text in legend.get_texts()]
    assert names == ["0 N·m", "3 N·m", "6 N·m", "supply pressure", "cable slack", "joint range"]
    axes.figure.canvas.draw()
    assert legend.get_window_extent().x0 >= axes.get_window_extent().x1


def test_the_pressures_over_the_map_fill_two_panels():
    figure = plot_pressures(feasibility_map(np.linspace(-2, 2, 41), np.linspace(6, 11, 41)))
    panels = figure.axes[:2]
    assert [panel.get_title(loc="left") for panel in panels] == ["agonist P1", "antagonist P2"]
    assert all(panel.collections for panel in panels)


def test_different_muscles_may_be_compared_but_not_different_quantities():
    maps = {"a": feasibility_map(), "b": feasibility_map(0.3, None, None)}
    with pytest.raises(ValueError, match="vary the same two quantities"):
        plot_maps(maps)
    joint = report_joint()
    other = type(joint)(joint.geometry, SAROSI_DMSP_20_400N, SAROSI_DMSP_20_400N)
    axes = plot_maps({"Tondu": feasibility_map(), "Sárosi": feasibility_map(joint=other)})
    assert axes.get_legend().get_texts()[1].get_text() == "Sárosi"


def test_limits_are_named_in_a_few_words():
    assert limit_text(Limit.AGONIST_SLACK | Limit.ANTAGONIST_SLACK) == "both slack"
    assert limit_text(Limit.P1_UPPER) == "P1 upper"
    assert limit_text(Limit.P1_UPPER | Limit.ANTAGONIST_SLACK) == "P1 upper + antagonist slack"


def test_a_map_without_a_feasible_target_says_so(tmp_path):
    result = run("--stiffness", "1e6:1e7", "--out", tmp_path / "map.csv")
    assert "none of 40401 combinations exists" in result.output
    assert "bounded by" not in result.output
