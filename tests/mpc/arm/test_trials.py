"""What is written of a run is what happened, and films are made with and without a GL."""

import csv
import os
import stat
from dataclasses import replace

import numpy as np
import pytest

from allocator import BAR, allocate
from allocator.errors import CannotWrite, InvalidInput, MissingBackend
from allocator.mechanism import Endpoint, Mechanism, Pulleys
from allocator.muscles import SAROSI_DMSP_20_400N
from mpc.arm import film as filming
from mpc.arm.film import Film
from mpc.arm.mjcf import to_mjcf
from mpc.arm.mujoco_plant import MujocoPlant
from mpc.model.arm.model import Arm
from mpc.trials.files import save_run
from mpc.trials.metrics import metrics
from mpc.trials.motions.arm_trajectories import circle, draw, reference, usual_stiffness
from mpc.trials.pictures.animation import check_film
from mpc.trials.pictures.plotting import tracking_figure
from mpc.trials.pictures.report import limits_of_reference
from mpc.trials.simulation import Run

ARM = Arm.machine("arm26")
M = 20


@pytest.fixture
def run():
    """Return a run that nobody ran: every joint 0.01 rad off, two commands beyond the slew."""
    t = np.linspace(0, 0.2, M + 1)
    q_ref, K_ref = draw(ARM).preview(0, M)
    x = np.hstack([q_ref + 0.01, np.zeros((M + 1, 2)), np.full((M + 1, 6), 3e5)])
    u = np.full((M, 6), 3e5)
    u[5, 0] += 10e3
    status = np.zeros(M, int)
    K = K_ref + 0.5
    F = ARM.forces(x)
    estimate, none = np.hstack([x[1:], np.zeros((M, 2))]), np.zeros(M)
    return Run(
        ARM, 0.01, t, x, estimate, u, q_ref, K_ref, K, F, np.full(M, 1e-4), status, status, none, none,
        np.zeros((M, 3)), "compiled",
    )  # fmt: skip


def test_metrics_are_what_the_arrays_say(run):
    found = metrics(run)
    np.testing.assert_allclose(found.theta_rms, np.degrees(0.01))
    np.testing.assert_allclose(found.K_worst, 0.5)
    assert found.step_median == pytest.approx(0.1)
    assert found.rungs["QP"] == sum(found.rungs.values()) == M
    assert found.violations["pressure slew"][0] == pytest.approx(5.0, rel=1e-6)  # bar/s above 5
    assert not found.limits_kept
    assert found.violations["commanded pressure"][0] == 0.0
    assert repr(found).startswith("Metrics: angle 0.573 … 0.573° RMS, ")
    assert f"{found.K_worst.min():.3g} … 0.5 N·m/rad worst" in repr(found)


def test_a_reference_that_stretches_the_arm_out_asks_for_no_stiffness_of_the_hand():
    hand = replace(ARM, endpoint=ARM.bodies.endpoint)
    with pytest.raises(InvalidInput, match=r"cannot be followed with the stiffness of the hand: .* singular"):
        reference("circle", hand)
    assert reference("circle", ARM).duration == 8.0
    assert np.isfinite(reference("draw", hand).K).all()


def test_a_joint_that_no_muscle_moves_is_named():
    idle = Pulleys(0.4, [(0.02, 0.0), (-0.02, 0.0)], 0.1375)
    mechanism = Mechanism(idle, SAROSI_DMSP_20_400N, joint_names=("shoulder", "elbow"))
    with pytest.raises(InvalidInput, match="no muscle moves elbow: the arm does not hold itself there"):
        reference("reach", Arm(mechanism, ARM.bodies))


def test_the_usual_stiffness_is_one_that_the_muscles_come_near(run):
    weak = replace(ARM, mechanism=replace(ARM.mechanism, pressure_limits=(0.0, 2.0 * BAR)))
    q = (ARM.angle_limits[0] + ARM.angle_limits[1]) / 2
    usual = usual_stiffness(ARM)(q[None])[0]
    assert allocate(q, usual, joint=ARM.mechanism).success
    assert not allocate(q, usual, joint=weak.mechanism).success
    asked = circle(weak, turns=1.0)
    swing = 1 + 0.1 * np.sin(np.pi * asked.t)[:, None, None]
    still = (asked.K / swing)[::20]
    assert allocate(asked.theta[::20], still, joint=weak.mechanism).success.all()
    far = metrics(replace(run, K_ref=10 * run.K_ref))
    assert "100 % of the reference is out of reach" in next(limits_of_reference(far, 5 * BAR))


def test_the_usual_stiffness_is_reachable_by_an_arm_that_holds_itself_against_gravity():
    leg = Arm.machine("leg37")
    asked = reference("reach", leg).resampled(0.1)
    assert leg.reachable(asked.theta, asked.K, leg.bodies.gravity_torque(asked.theta)).all()


def test_the_table_has_every_sample_in_degrees_and_bar(run, tmp_path):
    save_run(run, tmp_path / "arm.csv")
    with (tmp_path / "arm.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == M + 1
    assert float(rows[3]["shoulder_deg"]) == pytest.approx(np.degrees(run.theta[3, 0]), rel=1e-8)
    assert float(rows[5]["shoulder_flexor_command_bar"]) == pytest.approx(3.1)
    assert float(rows[-1]["K12"]) == pytest.approx(run.K[-1, 0, 1], rel=1e-8)
    assert set(rows[0]) == set(run.to_dict())


def test_the_hand_s_jacobian_is_the_slope_of_its_position():
    q, h = np.array([0.3, 0.7]), 1e-6
    slopes = [(ARM.bodies.points(q + h * e) - ARM.bodies.points(q - h * e))[-1] / (2 * h) for e in np.eye(2)]
    np.testing.assert_allclose(ARM.bodies.endpoint.jacobian(q), np.transpose(slopes), atol=1e-9)


def test_the_figure_shows_every_muscle_and_joint(run):
    figure = tracking_figure(run)
    labels = {label for axes in figure.axes for label in axes.get_legend_handles_labels()[1]}
    assert {*ARM.mechanism.muscle_names, *ARM.mechanism.joint_names, "K11", "K12", "K22", "hand"} <= labels
    x = run.x.copy()
    x[M // 2 :, 1] = np.nan  # an encoder fell silent
    assert len(tracking_figure(replace(run, x=x)).axes) == len(figure.axes)


def plant():
    made = MujocoPlant(to_mjcf(ARM.mechanism, ARM.bodies), ARM.mechanism.muscles)
    made.reset((0.2, 0.4), 3e5)
    return made


def no_gl(*_):
    raise MissingBackend("offscreen GL", "none", ["a screen"])


def test_without_gl_matplotlib_draws(monkeypatch, tmp_path):
    from PIL import Image

    monkeypatch.setattr(filming, "Camera", no_gl)
    moving = plant()
    film = Film(moving, ARM)
    for _ in range(20):
        moving.step(np.full(6, 3e5), 0.01)
        film.watch()
    left = moving.kept()
    film.save(tmp_path / "arm.gif")
    for was, now in zip(left[:5], moving.kept()[:5], strict=True):
        np.testing.assert_array_equal(was, now)  # drawing has not moved the plant
    assert film.by.startswith("matplotlib, because MuJoCo cannot render here")
    with Image.open(tmp_path / "arm.gif") as picture:
        assert picture.n_frames == len(film.pictures) == 5  # at 10, 50, 100, 150 and 200 ms
    drawn = film.pictures[0]
    assert drawn.shape[2] == 3
    assert len(np.unique(drawn.reshape(-1, 3), axis=0)) > 20  # something is on it
    assert (film.pictures[0] != film.pictures[-1]).any()  # and it moves


def test_a_film_of_a_hand_in_another_plane_shows_its_path_and_ellipse():
    text = (
        '<mujoco><worldbody><site name="a" pos="-.3 0 .05"/><site name="b" pos="-.3 0 -.05"/><body>'
        '<joint name="one" axis="0 -1 0" damping=".2"/><geom size=".01" fromto="0 0 0 .3 0 0" type="capsule" mass="1"/>'
        '<site name="c" pos="0 0 .05"/><site name="d" pos="0 0 -.05"/><body pos=".3 0 0">'
        '<joint name="two" axis="0 -1 0" damping=".2"/><geom size=".01" fromto="0 0 0 .2 0 0" type="capsule" mass="1"/>'
        '<site name="e" pos="0 0 .05"/><site name="f" pos="0 0 -.05"/><site name="tip" pos=".2 0 0"/></body></body>'
        '</worldbody><tendon><spatial name="k"><site site="a"/><site site="c"/></spatial>'
        '<spatial name="l"><site site="b"/><site site="d"/></spatial>'
        '<spatial name="m"><site site="c"/><site site="e"/></spatial>'
        '<spatial name="n"><site site="d"/><site site="f"/></spatial></tendon></mujoco>'
    )
    arm = Arm.from_mjcf(text, ARM.mechanism.muscles[0], 0.25, contraction=0.1)
    rig = MujocoPlant.of(arm)
    rig.reset([0.3, -0.6], 3e5)
    hand = filming.Hand(rig, arm, Endpoint.from_mjcf(text, "tip", axes="xz"))
    tip = rig.data.site("tip").xpos
    assert hand.position() == pytest.approx(tip)
    curve = hand.ellipse() - tip
    assert curve[:, 1] == pytest.approx(np.zeros(len(curve)))
    assert np.linalg.norm(curve, axis=1).max() == pytest.approx(0.15 * 0.5, rel=1e-3)  # of a reach of 0.5 m


def test_an_mp4_is_what_ffmpeg_makes_of_all_pictures(monkeypatch, tmp_path):
    program = tmp_path / "ffmpeg"
    program.write_text('#!/bin/sh\nfor last; do :; done\nwc -c > "$last"\n', encoding="utf-8")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setattr(filming, "Camera", no_gl)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    film = Film(plant(), ARM)
    film.watch()
    film.save(tmp_path / "arm.mp4")
    assert int((tmp_path / "arm.mp4").read_text()) == film.pictures[0].size
    program.write_text("#!/bin/sh\ncat > /dev/null\necho no codec >&2\nexit 1\n", encoding="utf-8")
    with pytest.raises(CannotWrite, match="no codec"):
        film.save(tmp_path / "arm.mp4")


def test_an_mp4_without_ffmpeg_is_refused_in_a_sentence(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(MissingBackend, match="ffmpeg"):
        check_film(tmp_path / "arm.mp4")
