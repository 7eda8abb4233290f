"""Trajectories: what a file says is what is followed; what is no trajectory is refused by line and column."""

import numpy as np
import pytest

from allocator import DEG, InvalidFile, InvalidInput, allocate
from mpc import Plant, Reference, sine
from mpc.trials.files import load, reference_called, save_reference
from mpc.trials.motions.motion_files import UnusedColumns
from mpc.trials.motions.trajectories import LEAD, usual_stiffness

HEADER = "t,theta_deg,stiffness\n"


def write(path, text):
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_the_default_trajectory_swings_40_degrees_at_half_a_hertz_and_starts_and_ends_at_rest():
    r, K = reference_called(None, None, Plant()), usual_stiffness(Plant().joint)
    s = r.t - LEAD
    full = (s >= 2) & (s <= 8)
    np.testing.assert_allclose(r.theta[full], 40 * DEG * np.sin(2 * np.pi * 0.5 * s[full]), atol=1e-8)
    np.testing.assert_allclose(r.K[full], K + 0.3 * np.sin(2 * np.pi * 0.25 * s[full]), atol=1e-8)
    assert np.ptp(r.theta[s <= 0]) < 1e-9
    speed = np.gradient(r.theta, r.t)
    assert abs(speed[[0, -1]]).max() < 1e-3 * abs(speed).max()


def test_the_default_trajectory_is_feasible_throughout():
    plant = Plant()
    r = reference_called(None, None, plant).resampled(0.01)
    omega = np.gradient(r.theta, r.t)
    T = plant.torque_for(r.theta, omega, np.gradient(omega, r.t))
    a = allocate(r.theta, r.K, T, joint=plant.joint)
    P = np.stack([a.P1, a.P2])
    assert a.success.all()
    assert P.min() > 2.0e5
    assert P.max() < 4.0e5
    assert np.abs(np.gradient(P, r.t, axis=1)).max() < 2.4e5


def test_saving_and_loading_gives_the_same_trajectory(tmp_path):
    save_reference(sine(duration=5), tmp_path / "r.csv")
    loaded = load(tmp_path / "r.csv")
    np.testing.assert_allclose(loaded.theta, sine(duration=5).theta, atol=1e-9)


def test_columns_may_come_in_any_order_with_others_between(tmp_path):
    text = "\ufeffstiffness, note ,theta_deg,t\n7.5,a,10,0\n\n7.6,b,20,0.5\r\n7.7,c,30,1\n"
    with pytest.warns(UnusedColumns, match="r.csv: columns not used: note$"):
        r = load(write(tmp_path / "r.csv", text))
    np.testing.assert_allclose(r.t, [0, 0.5, 1])
    np.testing.assert_allclose(r.theta / DEG, [10, 20, 30])
    np.testing.assert_allclose(r.K, [7.5, 7.6, 7.7])


@pytest.mark.parametrize("names", ["t (s);theta (°);K [Nm/rad]", "Zeit (s);Winkel [deg];Steifigkeit [Nm/rad]"])
def test_columns_may_have_the_letters_of_formulas_or_german_names(tmp_path, names):
    r = load(write(tmp_path / "r.csv", f"{names}\n0;10;7,5\n1,5;20;8\n"))
    np.testing.assert_allclose(r.t, [0, 1.5])
    np.testing.assert_allclose(r.K, [7.5, 8.0])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is empty"),
        ("\n\n", "is empty"),
        (HEADER, "has column names but no samples"),
        (HEADER + "0,0,7\n", "at least 2 samples, this file has 1"),
        ("t,theta_deg\n0,0\n1,1\n", "line 1, column 'stiffness': this column is missing; found: t, theta_deg"),
        ("0,0,7\n1,1,7\n", "line 1, column 't': this column is missing"),
        ("t;theta_deg;stiffness\n0;0,5;7\n", "at least 2 samples, this file has 1"),
        (HEADER + "0,0,7\n1,one,7\n", "line 3, column 'theta_deg': 'one' is not a number"),
        (HEADER + "0,0,7\n\n1,,7\n", "line 4, column 'theta_deg': a value is missing"),
        (HEADER + "0,0,7\n1,nan,7\n", "line 3, column 'theta_deg': nan is not a finite number"),
        (HEADER + "0,0,7\n1,0,inf\n", "line 3, column 'stiffness': inf is not a finite number"),
        (HEADER + "0,0,7\n1,0,0\n", "line 3, column 'stiffness': 0 N·m/rad has to be positive"),
        (HEADER + "0,0,7\n1,4000,7\n", "line 3, column 'theta_deg': 4000° is over a turn"),
        (HEADER + "0,0,7\n1,1,7\n1,2,7\n", "line 4, column 't': 1 s does not come after the sample before"),
        (HEADER + "0,0,7\n1,1\n", "line 3: has 2 values under 3 column names"),
        (b"\x00\x01", "is not a text file"),
    ],
)
def test_a_file_that_is_no_trajectory_is_refused_by_line_and_column(tmp_path, text, said):
    path = write(tmp_path / "bad.csv", text)
    with pytest.raises(InvalidFile) as refused:
        load(path)
    assert str(path) in str(refused.value)
    assert said in str(refused.value)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(InvalidFile, match="does not exist"):
        load(tmp_path / "missing.csv")


def test_resampling_a_smooth_trajectory_stays_on_it():
    r = sine(duration=6).resampled(0.007)
    assert np.diff(r.t) == pytest.approx(0.007)
    fine = sine(duration=6, dt=1e-4)
    np.testing.assert_allclose(r.theta, np.interp(r.t, fine.t, fine.theta), atol=1e-6)
    assert 6 - 0.007 < r.t[-1] <= 6


def test_a_step_between_coarse_samples_does_not_overshoot():
    r = Reference([0, 1, 1.1, 3], [0, 0, 20 * DEG, 20 * DEG], [7, 7, 9, 9]).resampled(0.01)
    assert r.theta.min() >= 0
    assert r.theta.max() <= 20 * DEG * (1 + 1e-12)
    assert (r.K >= 7 - 1e-12).all()


def test_a_preview_holds_the_last_value_beyond_the_end():
    r = Reference([0, 1, 2], [0.1, 0.2, 0.3], [7, 8, 9])
    theta, K = r.preview(1, 4)
    np.testing.assert_allclose(theta, [0.2, 0.3, 0.3, 0.3, 0.3])
    np.testing.assert_allclose(K, [8, 9, 9, 9, 9])


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        (([0, 1], [0, 0], [7]), "rows of one length"),
        (([0], [0], [7]), "2 or more"),
        (([0, 2, 1], [0, 0, 0], [7, 7, 7]), r"t\[2\] = 1 s does not come after t\[1\] = 2 s"),
        (([0, 1], [0, 90], [7, 7]), "if degrees were meant"),
        (([0, 1], [0, 0], [7, -1]), r"K\[1\] = -1"),
        (([0, np.nan], [0, 0], [7, 7]), r"t\[1\] = nan"),
    ],
)
def test_samples_that_make_no_trajectory_are_refused(columns, said):
    with pytest.raises(InvalidInput, match=said):
        Reference(*columns)


def test_a_sine_needs_room_for_its_ramps():
    with pytest.raises(InvalidInput, match="ramps"):
        sine(duration=3, ramp=2)
