"""Files of corrections: read as they were written, refused for what they do not belong to, scaled in time."""

from dataclasses import replace

import numpy as np
import pytest

from allocator.errors import InvalidFile, InvalidInput
from allocator.units import DEG
from mpc import Compensation, Plant, Reference
from mpc.trials.motions.corrections import Correction, Owner
from mpc.trials.motions.trajectories import point_to_point, rested_sine

WANTED = replace(point_to_point(5.0), name="min-jerk")
OWNER = Owner.of(Plant(), Compensation(), "mpc", "gripper")
LEARNED = Correction(WANTED, 0.1 * WANTED.theta * (WANTED.t > 4), OWNER, (0.02, 0.004))


def test_it_is_read_as_it_was_written(tmp_path):
    LEARNED.save(path := tmp_path / "it.toml")
    read = Correction.load(path)
    assert (read.owner, read.errors, read.wanted.name) == (OWNER, LEARNED.errors, "min-jerk")
    np.testing.assert_array_equal(read.reference.theta, LEARNED.reference.theta)
    np.testing.assert_array_equal(read.wanted.K, WANTED.K)


def test_that_of_an_arm_is_read_as_it_was_written(tmp_path):
    K = np.tile([[9.0, 2.0], [2.0, 7.0]], (WANTED.t.size, 1, 1))
    wanted = Reference(WANTED.t, np.stack([WANTED.theta, 2 * WANTED.theta], axis=1), K, "reach", 0.5)
    Correction(wanted, 0.1 * wanted.theta, OWNER).save(path := tmp_path / "arm.toml")
    read = Correction.load(path)
    np.testing.assert_array_equal(read.wanted.K, K)
    np.testing.assert_array_equal(read.shift, 0.1 * wanted.theta)
    assert read.wanted.tail == 0.5


@pytest.mark.parametrize(
    ("other", "named"),
    [
        (Owner.of(replace(Plant(), inertia=0.06), Compensation(), "mpc", "gripper"), "another joint"),
        (Owner.of(Plant(), Compensation(dead_time=0.02), "mpc", "gripper"), "another joint"),
        (replace(OWNER, controller="lqr"), "another controller: mpc, not lqr"),
        (replace(OWNER, load=""), "another load: gripper, not no load"),
    ],
)
def test_another_owner_is_refused_by_name(other, named):
    LEARNED.check(OWNER)
    with pytest.raises(InvalidInput, match=named):
        LEARNED.check(other)


def test_a_motion_that_is_a_little_faster_takes_the_correction_scaled_in_time():
    speed = 1.2
    t = np.minimum(WANTED.t, 4) + np.maximum(WANTED.t - 4, 0) / speed
    found = LEARNED.along(Reference(t, WANTED.theta, WANTED.K))
    np.testing.assert_allclose(found.shift, LEARNED.shift, atol=0.02 * DEG)


@pytest.mark.parametrize(
    ("other", "named"),
    [
        (rested_sine(5.0), "another motion"),
        (point_to_point(6.0), "another motion"),
        (Reference(np.minimum(WANTED.t, 4) + np.maximum(WANTED.t - 4, 0) / 3, WANTED.theta, WANTED.K), "3.00 times"),
    ],
)
def test_another_motion_or_speed_is_refused(other, named):
    with pytest.raises(InvalidInput, match=named):
        LEARNED.along(other)


def test_a_file_without_a_shift_is_no_correction(tmp_path):
    LEARNED.save(path := tmp_path / "it.toml")
    path.write_text("\n".join(line for line in path.read_text().splitlines() if not line.startswith("shift")))
    with pytest.raises(InvalidFile, match="shift is missing"):
        Correction.load(path)
    path.write_text("[other]\n")
    with pytest.raises(InvalidFile, match=r"\[correction\] is missing"):
        Correction.load(path)
