"""Films: a GIF by Pillow, a dependency of matplotlib, or an MP4 by the program ffmpeg; and the film of a joint's run.

The latter shows the joint with its muscles next to angle, stiffness and pressures, in real time.
"""

import shutil
import subprocess
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from allocator.errors import CannotWrite, MissingBackend
from allocator.files.atomic import replacing
from allocator.lazy import Figure
from allocator.presentation.plotting import fit_captions, new_figure
from allocator.units import BAR, DEG
from mpc.trials.simulation import Run

ENDINGS = (".gif", ".mp4")
_COLOURS = 64  # of a GIF

Picture = NDArray[np.uint8]  # (height, width, 3)


def check_film(path: Path) -> None:
    """Raise `MissingBackend` unless a film with the suffix of `path` can be written."""
    if path.suffix.lower() == ".mp4" and shutil.which("ffmpeg") is None:
        raise MissingBackend("writer of .mp4, ffmpeg,", "which is not installed", [".gif"])


def save_film(pictures: list[Picture], path: Path, per_second: int) -> None:
    """Write the pictures as a GIF or an MP4, whole or not at all. Raises `CannotWrite`, and like `check_film`."""
    check_film(path)
    with replacing(path) as draft:
        if path.suffix.lower() == ".mp4":
            _save_mp4(pictures, draft, per_second, path)
        else:
            _save_gif(pictures, draft, per_second)


def drawn(figure: "Figure") -> Picture:
    """Return a `new_figure` as a picture."""
    canvas: FigureCanvasAgg = figure.canvas
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _save_gif(pictures: list[Picture], path: Path, per_second: int) -> None:
    """Write the pictures with one palette, so that a frame holds only the moving parts."""
    from PIL import Image

    palette = _palette(np.concatenate(pictures[:: max(1, len(pictures) // 8)]))
    frames = [Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    frames[0].save(
        path, format="GIF", save_all=True, append_images=frames[1:], duration=round(1000 / per_second), loop=0
    )


def _palette(picture: Picture) -> "Image.Image":
    """Return the `picture` in the few colours nearest to its own: drawings need others than rendered scenes."""
    from PIL import Image

    image = Image.fromarray(picture)
    found = (image.quantize(_COLOURS, method) for method in (Image.Quantize.MAXCOVERAGE, Image.Quantize.FASTOCTREE))
    return min(found, key=lambda few: np.abs(np.asarray(few.convert("RGB"), np.int16) - picture).mean())


def _save_mp4(pictures: list[Picture], path: Path, per_second: int, said: Path) -> None:
    height, width, _ = pictures[0].shape
    given = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(per_second), "-i", "-"]
    made = ["-an", "-vcodec", "libx264", "-pix_fmt", "yuv420p", "-f", "mp4", str(path)]
    raw = b"".join(picture.tobytes() for picture in pictures)
    done = subprocess.run(["ffmpeg", "-y", "-loglevel", "error", *given, *made], input=raw, capture_output=True)
    if done.returncode:
        raise CannotWrite(said, OSError(done.stderr.decode(errors="replace").strip()[:200]))


if TYPE_CHECKING:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.lines import Line2D
    from matplotlib.patches import Polygon
    from PIL import Image

Progress: TypeAlias = Callable[[Iterable[int]], Iterable[int]]

_PER_SECOND = 12  # frames
_DPI = 72
_BLUE, _ORANGE, _BLACK, _GREY = "#0072B2", "#D55E00", "#000000", "#8c8c8c"
_APART = 0.16  # of the muscles from the middle, in rest lengths: arms are too short for a drawing to scale
_THICK = 0.035  # half the width of a muscle at rest, in rest lengths
_BULGE = 0.22  # growth of that per contraction


class _Muscle(NamedTuple):
    """Drawing of a muscle: its outline and its cable."""

    outline: "Polygon"
    cable: "Line2D"


def save_animation(run: Run, path: str | Path, title: str = "", *, progress: Progress = lambda frames: frames) -> None:
    """Write the run as GIF or MP4, whole or not at all.

    `progress` wraps the iteration over the frames. Raises `MissingBackend` for MP4 without ffmpeg.
    """
    check_film(Path(path))
    film = _Film(run, title)
    save_film([film.picture(k) for k in progress(film.samples)], Path(path), _PER_SECOND)


class _Film:
    """Figure that can show any sample of the run."""

    def __init__(self, run: Run, title: str) -> None:
        self.run = run
        self.samples = range(0, run.t.size, max(1, round(1 / (_PER_SECOND * run.dt))))
        self.figure = new_figure(8, 4.2)
        self.figure.set_dpi(_DPI)
        self.figure.suptitle(title, fontsize="medium")
        left, right = self.figure.subfigures(1, 2, squeeze=False, width_ratios=[1, 1.7])[0]
        self._joint = left.subplots()
        self._traces = right.subplots(3, 1, sharex=True)
        self._draw_traces()
        self._draw_joint()
        fit_captions(self.figure)
        self.figure.draw_without_rendering()
        self.figure.set_layout_engine("none")  # laid out once, not for every frame

    def picture(self, k: int) -> Picture:
        """Return the sample k as a picture."""
        self.show(k)
        return drawn(self.figure)

    def show(self, k: int) -> None:
        """Show the sample k."""
        theta = float(self.run.x[k, 0])
        for i, muscle in enumerate(self._muscles):
            outline, cable = _shape(i, float(self.run.plant.joint.sides(theta)[i].contraction))
            muscle.outline.set_xy(outline)
            share = float(self.run.P[k, i]) / self.run.plant.joint.pressure_limits[1]
            muscle.outline.set_alpha(0.25 + 0.75 * float(np.clip(share, 0, 1)))
            muscle.cable.set_data(*cable)
        self._link.set_data([0, -np.sin(theta) * 0.42], [-0.75, -0.75 - np.cos(theta) * 0.42])
        for line in self._now:
            line.set_xdata([self.run.t[k]] * 2)

    def _draw_joint(self) -> None:
        axes = self._joint
        axes.set_aspect("equal")
        axes.set(xlim=(-0.5, 0.5), ylim=(-1.25, 0.32))
        axes.axis("off")
        axes.plot([-0.3, 0.3], [0.25, 0.25], color=_GREY, lw=4)
        turn = np.linspace(0, 2 * np.pi, 60)
        axes.plot(_APART * np.cos(turn), -0.75 + _APART * np.sin(turn), color=_BLACK, lw=1.2)
        self._muscles = [
            _Muscle(axes.fill([0], [0], color=color, lw=1)[0], axes.plot([], [], color=_BLACK, lw=1.2)[0])
            for color in (_BLUE, _ORANGE)
        ]
        (self._link,) = axes.plot([], [], color=_BLACK, lw=6, solid_capstyle="round")

    def _draw_traces(self) -> None:
        run, (angle, stiffness, pressure) = self.run, self._traces
        angle.plot(run.t, run.theta / DEG, color=_BLACK)
        angle.plot(run.t, run.theta_ref / DEG, color=_GREY, ls="--", lw=1)
        angle.set_ylabel("angle [°]")
        stiffness.plot(run.t, run.K, color=_BLACK)
        stiffness.plot(run.t, run.K_ref, color=_GREY, ls="--", lw=1)
        stiffness.set_ylabel("K [N·m/rad]")
        for i, color in enumerate((_BLUE, _ORANGE)):
            pressure.plot(run.t, run.P[:, i] / BAR, color=color)
        pressure.set_ylabel("pressures [bar]")
        pressure.set_xlabel("time [s]")
        self._now = [axes.axvline(run.t[0], color=_GREY, lw=1) for axes in self._traces]
        for axes in self._traces:
            axes.grid(alpha=0.25)
            axes.margins(x=0.01)


def _shape(muscle: int, contraction: float) -> tuple[Array, tuple[Array, Array]]:
    """Return the outline (n, 2) of a muscle (0, 1) at its contraction, and its cable, in rest lengths."""
    x, length = _APART * (1 if muscle else -1), 0.8 * (1 - contraction)
    along = np.linspace(0, 1, 30)
    half = (_THICK + _BULGE * max(contraction, 0.0)) * np.sin(np.pi * along) ** 0.4
    y = 0.25 - along * length
    outline = np.column_stack([np.concatenate([x - half, (x + half)[::-1]]), np.concatenate([y, y[::-1]])])
    return outline, (np.array([x, x]), np.array([0.25 - length, -0.75]))
