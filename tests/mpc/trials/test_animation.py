"""A run becomes a film of as many frames as its time wants."""

import numpy as np
import pytest
from PIL import Image

from allocator.errors import MissingBackend
from mpc import Plant, TrackingMPC, simulate, sine
from mpc.trials.pictures.animation import save_animation, save_film

pytestmark = pytest.mark.compiles


@pytest.fixture(scope="module")
def run():
    return simulate(Plant(), TrackingMPC(Plant(), dt=0.02, N=10), sine(duration=1.0, ramp=0.5))


@pytest.mark.slow
def test_a_gif_has_its_frames_and_they_move(run, tmp_path):
    save_animation(run, tmp_path / "run.gif", "a run")
    with Image.open(tmp_path / "run.gif") as film:
        assert 9 <= film.n_frames <= 14
        first = film.convert("RGB").tobytes()
        film.seek(film.n_frames // 2)
        assert film.convert("RGB").tobytes() != first
        size = (tmp_path / "run.gif").stat().st_size
        assert size < 5_000 * film.n_frames, "a frame holds more than what has moved"


def test_a_lit_floor_and_a_drawing_keep_their_colours(tmp_path):
    light, (rows, columns) = np.linspace(0, 1, 320), np.indices((180, 320))
    floor = np.array([140, 150, 165]) + light[None, :, None] * 30 + 4 * (((rows + columns) // 20) % 2)[..., None]
    floor[60:90, 40:120] = np.random.default_rng(0).integers(0, 255, (30, 80, 3))  # all that moves on it
    drawing = np.full((180, 320, 3), 255)
    drawing[:, 100:103] = 0, 114, 178
    for picture, most in ((floor, 8.0), (drawing, 0.1)):
        save_film([picture.astype(np.uint8)] * 3, tmp_path / "film.gif", 20)
        with Image.open(tmp_path / "film.gif") as film:
            shown = np.asarray(film.convert("RGB"), float)
        assert np.abs(shown - picture).mean() < most


def test_mp4_without_ffmpeg_says_so(run, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(MissingBackend, match=r"ffmpeg.*available: \.gif"):
        save_animation(run, tmp_path / "run.mp4")
    assert not (tmp_path / "run.mp4").exists()
