"""Runs survive as NPZ."""

from contextlib import suppress
from dataclasses import fields, replace

import numpy as np
import pytest

from allocator import DEG, InvalidFile
from allocator.joint.antagonist import report_joint
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc import Arm, Plant, RealPlant, Run, TrackingMPC, simulate, sine
from mpc.trials.files import load_recording, recorded, reference_called, save_recording
from mpc.trials.metrics import metrics

pytestmark = pytest.mark.slow

MOVE = sine(amplitude=10 * DEG, K=5.5, duration=0.3, ramp=0.1)
PLANT = Plant(report_joint(SAROSI_DMSP_20_400N), lag=(0.1, 0.12), gravity_torque=0.5)


@pytest.fixture(scope="module")
def run():
    controller = TrackingMPC(PLANT, N=5, compiled=False)  # a compiler would take longer than the run
    return simulate(RealPlant(PLANT, force_gains=(1.05, 0.95)), controller, MOVE)


def test_a_recording_comes_back_to_the_last_bit_with_its_plant(run, tmp_path):
    save_recording(run, tmp_path / "run.of.today.npz")
    again = load_recording(tmp_path / "run.of.today.npz")
    for entry in fields(Run):
        if entry.name != "plant":
            np.testing.assert_array_equal(getattr(again, entry.name), getattr(run, entry.name))
    x = np.array([0.1, 0.2, 3e5, 2e5])
    np.testing.assert_array_equal(again.plant.rate(x, x[2:]), PLANT.rate(x, x[2:]))
    assert (again.plant.slew, again.dt) == (PLANT.slew, run.dt)
    assert metrics(again) == metrics(run)


def test_a_recording_is_a_trajectory_for_its_kind_of_machine(run, tmp_path):
    save_recording(run, tmp_path / "run.npz")
    reference = reference_called(str(tmp_path / "run.npz"), None, Plant())
    for values, wanted in ((reference.t, run.t), (reference.theta, run.theta_ref), (reference.K, run.K_ref)):
        np.testing.assert_array_equal(values, wanted)
    with pytest.raises(InvalidFile, match="a run with theta and stiffness; this machine needs shoulder, elbow and K11"):
        recorded(tmp_path / "run.npz", Arm.machine("arm26"))
    save_recording(replace(run, t=run.t[::-1]), tmp_path / "back.npz")
    with pytest.raises(InvalidFile, match=r"back.npz: holds no trajectory: t\[1\] = .* does not come after"):
        recorded(tmp_path / "back.npz", PLANT)


def test_numpy_alone_opens_a_recording(run, tmp_path):
    save_recording(run, tmp_path / "run.npz")
    with np.load(tmp_path / "run.npz") as archive:
        np.testing.assert_array_equal(archive["x"], run.x)
        assert "Sarosi2012" in str(archive["joint"])


def test_what_is_no_recording_is_refused_by_its_name(run, tmp_path):
    (tmp_path / "text.npz").write_text("no")
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    save_recording(run, tmp_path / "run.npz")
    with np.load(tmp_path / "run.npz") as archive:
        np.savez(tmp_path / "broken.npz", **{**archive, "plant_inertia": -1.0})
        np.savez(tmp_path / "short.npz", **{**archive, "x": np.zeros(3)})
        np.savez(tmp_path / "many.npz", **{**archive, "dt": np.zeros(3)})
    whole = bytearray((tmp_path / "run.npz").read_bytes())
    whole[200:260] = bytes(60)
    (tmp_path / "damaged.npz").write_bytes(whole)
    for name, said in (
        ("nowhere.npz", "cannot be read"),
        ("text.npz", "is not an NPZ file"),
        ("other.npz", "is not the recording of a run: K, "),
        ("broken.npz", "does not hold a plant"),
        ("short.npz", r"x has the shape \(3,\)"),
        ("many.npz", r"dt has the shape \(3,\)"),
        ("damaged.npz", "is not an NPZ file"),
    ):
        with pytest.raises(InvalidFile, match=said):
            load_recording(tmp_path / name)


def test_a_damaged_recording_is_a_sentence_whatever_the_damage(run, tmp_path):
    """Bytes changed at random, files cut off, and arrays of another kind: a run, or `InvalidFile`."""
    save_recording(run, tmp_path / "run.npz")
    rng, path = np.random.default_rng(4), tmp_path / "damaged.npz"
    for name in ("run.npz", "stored.npz"):
        with np.load(tmp_path / "run.npz") as archive:
            arrays = dict(archive)
        np.savez(tmp_path / "stored.npz", **arrays)  # whose headers lie open
        whole = (tmp_path / name).read_bytes()
        for _ in range(100):
            damaged = bytearray(whole)
            for _ in range(rng.integers(1, 6)):
                damaged[rng.integers(len(damaged))] = rng.integers(256)
            path.write_bytes(damaged[: rng.integers(len(damaged))] if rng.random() < 0.3 else damaged)
            with suppress(InvalidFile):
                assert repr(load_recording(path))
    for name, array in arrays.items():
        for value in ("word", True, 1j, -1.0, np.nan, np.inf, 1e18, np.zeros(0), np.full(array.shape, "x")):
            np.savez(path, **(arrays | {name: value}))
            with suppress(InvalidFile):
                assert repr(load_recording(path))
