"""A run becomes a film of as many frames as its time wants."""

import pytest
from PIL import Image

from allocator.errors import MissingBackend
from mpc import Plant, TrackingMPC, simulate, sine
from mpc.trials.pictures.animation import save_animation

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


def test_mp4_without_ffmpeg_says_so(run, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(MissingBackend, match=r"ffmpeg.*available: \.gif"):
        save_animation(run, tmp_path / "run.mp4")
    assert not (tmp_path / "run.mp4").exists()
