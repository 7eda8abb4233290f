"""Results show themselves in a few lines and as tables: numbers with units, never dumped arrays."""

from html.parser import HTMLParser

import numpy as np
import pytest

from allocator import BAR, DEG, Status, allocate
from allocator.identification import fit, fit_joint, load_dataset
from allocator.muscles import Hogan1984, Sarosi2012
from allocator.presentation.tables import html_table, number, span
from mpc import Plant, Reference, TrackingMPC, simulate
from mpc.trials.files import save_run

THETA = np.linspace(-1.0, 1.0, 12).reshape(3, 4)


@pytest.fixture(scope="module")
def batch():
    return allocate(THETA, 7.5, 9.0)


@pytest.fixture(scope="module")
def run():
    plant = Plant()
    return simulate(plant, TrackingMPC(plant), Reference([0, 0.2], [0.0, 0.02], [7.0, 7.0]))


@pytest.fixture(scope="module")
def sheet_fit():
    sheet = load_dataset("dmsp-20-sheet")
    return fit(Sarosi2012, sheet.contraction, sheet.pressure, sheet.force)


@pytest.fixture(scope="module")
def joint_fit(joints):
    joint = joints["sarosi-pulley"]
    P1, P2 = (P.ravel() for P in np.meshgrid(np.linspace(2, 4, 5) * BAR, np.linspace(2, 4, 5) * BAR))
    T = np.tile([-1.0, 0.0, 1.0, 0.5, -0.5], 5)
    theta = joint.equilibrium(P1, P2, T)
    return fit_joint(theta, P1, P2, torque=T, geometry=joint.geometry, model="Sarosi2012")


@pytest.fixture(params=["one", "batch", pytest.param("run", marks=pytest.mark.compiles), "sheet_fit", "joint_fit"])
def shown(request):
    return allocate(0.5, 7.5, 30.0) if request.param == "one" else request.getfixturevalue(request.param)


class Tags(HTMLParser):
    """Which tags are open, and the text of the cells."""

    def __init__(self):
        super().__init__()
        self.open, self.cells = [], []

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.cells.append(data)


def parsed(html):
    tags = Tags()
    tags.feed(html)
    assert not tags.open
    return tags.cells


def test_a_result_shows_itself_in_at_most_three_lines_without_arrays(shown):
    text = repr(shown)
    assert text.startswith(tuple(kind.__name__ for kind in type(shown).__mro__))  # of a pair: Allocation
    assert len(text.splitlines()) <= 3
    assert "array" not in text
    assert "[" not in text


def test_its_html_is_one_table_with_every_tag_closed(shown):
    assert shown._repr_html_().startswith("<table>")
    assert len(parsed(shown._repr_html_())) > 5


def test_text_in_a_table_is_escaped():
    assert parsed(html_table("P < 5", [("a & b", "<i>")])) == ["P < 5", "a & b", "<i>"]


def test_a_single_answer_shows_its_pressures_in_bar_and_its_angle_in_degrees():
    a = allocate(30 * DEG, 7.5, 1.0)
    assert repr(a) == (
        f"Allocation EXACT at 30°: P1 = {a.P1 / 1e5:.4g} bar, P2 = {a.P2 / 1e5:.4g} bar\n"
        "  torque 1 N·m (asked 1), isobaric stiffness 7.5 N·m/rad (asked 7.5)"
    )


def test_an_answer_off_the_targets_says_why():
    a = allocate(0.5, 7.5, 30.0)
    assert repr(a).endswith(a.message)


def test_what_is_zero_but_for_rounding_shows_as_zero():
    assert number(-8.9e-16) == number(-0.0) == "0"
    assert number(np.nan) == "nan"
    assert "-0" not in repr(allocate(0.0, 7.5, 0.0))


def test_a_span_leaves_out_what_is_no_number():
    assert span([3.0, np.nan, -1.0], "bar") == "-1 … 3 bar"
    assert span([np.nan], "bar") == span([], "bar") == "none"


def test_an_answer_that_does_not_exist_and_an_empty_one_show_themselves():
    assert "NO_INVERSE" in repr(allocate(0.5, 99.0, 1.0, method="analytic"))
    assert repr(allocate(np.zeros(0), 7.5)).startswith("Allocation (0,), 0 targets")


# --- tables -----------------------------------------------------------------------------------------------------------


def test_the_columns_of_many_answers_are_rows_of_one_length(batch):
    table = batch.to_dict()
    assert {np.shape(column) for column in table.values()} == {(THETA.size,)}
    np.testing.assert_allclose(table["theta_deg"], np.degrees(THETA.ravel()))
    np.testing.assert_allclose(table["P1_bar"], batch.P1.ravel() / 1e5)
    assert [Status[name] for name in table["status"]] == batch.status.ravel().tolist()
    assert table["limits"].tolist() == [" + ".join(bound) for bound in batch.active.flat]


def test_a_single_answer_is_one_row_of_the_table_of_many(batch):
    table = batch.to_dict()
    for i, theta in enumerate(THETA.flat):
        one = allocate(float(theta), 7.5, 9.0).to_dict()
        assert one.keys() == table.keys()
        assert all(np.ndim(value) == 0 for value in one.values())
        for name, value in one.items():
            same = value == table[name][i] if isinstance(value, str) else value == pytest.approx(table[name][i], 1e-9)
            assert same, name


def test_no_answers_are_a_table_without_rows():
    assert {len(column) for column in allocate(np.zeros(0), 7.5).to_dict().values()} == {0}


@pytest.mark.compiles
def test_a_run_is_the_table_that_track_writes(run, tmp_path):
    save_run(run, tmp_path / "run.csv")
    written = np.genfromtxt(tmp_path / "run.csv", delimiter=",", names=True)
    table = run.to_dict()
    assert written.dtype.names == tuple(table)
    assert {np.shape(column) for column in table.values()} == {(run.t.size,)}
    for name, column in table.items():
        np.testing.assert_allclose(written[name], column, rtol=1e-8)


def test_fits_are_rows_of_one_table(sheet_fit):
    row = sheet_fit.to_dict()
    assert all(np.ndim(value) == 0 for value in row.values())
    assert row["rms_error_N"] == pytest.approx(np.sqrt(np.mean(sheet_fit.residuals()[~sheet_fit.slack] ** 2)))
    assert {name: row[name] for name in sheet_fit.muscle.parameters} == sheet_fit.muscle.parameters
    assert row["taut_samples"] + row["slack_samples"] == sheet_fit.samples.n


def test_a_fit_with_warnings_shows_the_first_of_them():
    sheet = load_dataset("dmsp-20-sheet")
    found = fit(Hogan1984, sheet.contraction, sheet.pressure, sheet.force, folds=0)
    assert found.warnings
    assert repr(found).endswith(f"warning 1 of {len(found.warnings)}: {found.warnings[0]}")


def test_a_fitted_joint_is_a_row_in_degrees(joint_fit):
    row = joint_fit.to_dict()
    assert all(np.ndim(value) == 0 for value in row.values())
    assert row["rms_error_deg"] == pytest.approx(np.degrees(joint_fit.rms))
