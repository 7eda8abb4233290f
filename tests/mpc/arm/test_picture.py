"""Muscles are seen to swell and to redden with their pressures."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import InvalidInput, MissingBackend
from allocator.mechanism import Mechanism, Sites, machines
from allocator.mechanism.bodies import Bodies, arm26_bodies
from allocator.mechanism.routes import Link
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR
from mpc.arm import picture
from mpc.arm.mjcf import muscle_geom, paint, to_mjcf
from mpc.arm.mujoco_plant import MujocoPlant
from mpc.arm.picture import Camera, radii

ARM = machines.arm26()


@pytest.fixture
def rig():
    return MujocoPlant(to_mjcf(ARM, arm26_bodies()), ARM.muscles)


def painted(rig, P):
    rig.reset((0.2, 0.4), P)
    paint(rig.model, rig.muscle_names, rig.lengths, radii(rig), rig.P / (5 * BAR))


def test_a_drawn_muscle_has_its_length_radius_and_colour(rig):
    first = rig.model.geom(muscle_geom("elbow flexor"))
    before = first.pos[0] - first.size[1] - first.size[0]
    painted(rig, [1 * BAR, 1 * BAR, 5 * BAR, 1 * BAR, 1 * BAR, 1 * BAR])
    radius, half = first.size[:2]
    assert 2 * (half + radius) == pytest.approx(rig.lengths[2], rel=1e-9)
    assert first.pos[0] - half - radius == pytest.approx(before, abs=1e-12)  # its mount stays
    assert first.rgba[0] > 4 * first.rgba[1]
    full = np.sqrt(SAROSI_DMSP_20_400N.volume(5 * BAR, 1 - rig.lengths[2] / 0.4, 0.4) / (np.pi * rig.lengths[2]))
    assert radius == pytest.approx(full, rel=0.05)
    painted(rig, 0.0)
    assert first.size[0] < 0.8 * radius
    assert first.rgba[1] > 0.8


def test_muscles_of_unknown_volume_swell_as_well():
    bare = replace(SAROSI_DMSP_20_400N, inner_radius=None)
    rig = MujocoPlant(to_mjcf(ARM, arm26_bodies()), [bare] * 6, gas=False)
    rig.reset((0.2, 0.4), [1 * BAR, 5 * BAR, 3 * BAR, 3 * BAR, 3 * BAR, 3 * BAR])
    assert (np.diff(radii(rig)[[0, 2, 1]]) > 0).all()
    with pytest.raises(InvalidInput, match="inner_radius"):
        rig.pneumatics.volumes(rig.lengths, rig.P)


def test_the_drawn_cable_is_paid_out_as_the_joint_turns(rig):
    """The far end of a muscle moves by r dq."""
    geom, ends = rig.model.geom(muscle_geom("shoulder extensor")), []
    for angle in (0.0, 0.5):
        rig.reset((angle, 0.0), P=[2 * BAR] * 6)
        paint(rig.model, rig.muscle_names, rig.lengths, radii(rig), rig.P / (5 * BAR))
        ends.append(geom.pos[0] + geom.size[1] + geom.size[0])
    assert ends[1] - ends[0] == pytest.approx(0.02 * 0.5, rel=1e-9)


def test_tendons_between_sites_swell_and_redden_themselves():
    sites = Sites(0.4, [Link()], [[(-1, (-0.3, 0.04)), (0, (0.04, 0.03))], [(-1, (-0.3, -0.04)), (0, (0.04, -0.03))]])
    mechanism = Mechanism(sites, SAROSI_DMSP_20_400N)
    rig = MujocoPlant(to_mjcf(mechanism, Bodies.rods((0.3,), (1.0,), 0.1)), mechanism.muscles)
    rig.reset([0.1], [5 * BAR, 0.0])
    paint(rig.model, rig.muscle_names, rig.lengths, radii(rig), rig.P / (5 * BAR))
    assert rig.model.tendon_width[0] > 1.2 * rig.model.tendon_width[1]
    assert rig.model.tendon_rgba[0, 1] < 0.1 < rig.model.tendon_rgba[1, 1]


@pytest.mark.slow
def test_a_picture_shows_it_or_says_which_gl_is_missing(rig):
    """On a machine without any GL the sentence has to name what to install."""
    rig.reset((0.2, 0.4), [5 * BAR] * 6)
    camera, said = None, ""
    try:
        camera = Camera(rig, 320, 240)
    except MissingBackend as error:
        said = str(error)
    if camera is None:
        assert "EGL" in said
        assert "OSMesa" in said
        return
    with camera:
        full = camera.render().astype(int)
        rig.reset((0.2, 0.4), [0.0] * 6)
        empty = camera.render().astype(int)
    assert full.shape == (240, 320, 3)
    red = [((image[..., 0] > 120) & (image[..., 1] < 90)).sum() for image in (full, empty)]
    assert red[0] > 1000  # pixels
    assert red[1] == 0


def test_without_any_gl_the_advice_is_given(rig, monkeypatch):
    def broken(width, height):
        raise ImportError("no such library")

    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(picture, "_MAKERS", dict.fromkeys(("egl", "osmesa", "glfw"), broken))
    with pytest.raises(MissingBackend, match=r"EGL .*OSMesa .*"):
        Camera(rig)


def test_gl_that_is_not_there_is_named(rig, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "vulkan")
    with pytest.raises(MissingBackend, match="egl, glfw, osmesa"):
        Camera(rig)


def test_impossible_pictures_are_refused(rig):
    with pytest.raises(InvalidInput, match="width"):
        Camera(rig, 5000, 300)
    with pytest.raises(InvalidInput, match="camera = 'side' is none"):
        Camera(rig, camera="side")


BARE = """<mujoco><worldbody><body><joint name="s" axis="0 0 1"/>
<geom type="capsule" fromto="0 0 0 .25 0 0" size=".01"/>
<site name="s1" pos="0 .03 0"/></body><site name="a1" pos="-.3 .02 0"/></worldbody>
<tendon><spatial name="one" user=".34 0"><site site="a1"/><site site="s1"/></spatial></tendon>{more}</mujoco>"""
SKY = '<asset><texture type="skybox" builtin="flat" rgb1="0 1 0" rgb2="0 1 0" width="8" height="8"/></asset>'


def test_a_model_without_sky_and_lights_is_not_shown_dark_before_black():
    """Bright behind, and the link (grey .5) neither lost in it nor dark; a model's own sky stays."""
    own = []
    for more in ("", SKY):
        rig = MujocoPlant(BARE.format(more=more), (SAROSI_DMSP_20_400N,), rest_length=0.34, cable=0.0)
        with Camera(rig) as camera:
            own.append(camera.render().astype(float))
    bare, green = own
    behind = (green[..., 1] > 100) & (green[..., 0] < 50)
    assert 0.5 < behind.mean() < 0.999
    assert bare[behind].mean() > 200
    assert 60 < bare[~behind].mean() < 200
