"""Films as files: a GIF is written by Pillow, which matplotlib brings, an MP4 by the program ffmpeg."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from allocator.errors import CannotWrite, MissingBackend
from allocator.files.atomic import replacing

ENDINGS = (".gif", ".mp4")
_COLOURS = 64  # of a GIF

Picture = NDArray[np.uint8]  # (height, width, 3)


def check_film(path: Path) -> None:
    """Insist that a film with the ending of `path` can be written here. Raises `MissingBackend`."""
    if path.suffix.lower() == ".mp4" and shutil.which("ffmpeg") is None:
        raise MissingBackend("writer of .mp4, ffmpeg,", "which is not installed", [".gif"])


def save_film(pictures: list[Picture], path: Path, per_second: int) -> None:
    """Write the pictures as a GIF or an MP4, whole or not at all. Raises `CannotWrite`, and as `check_film`."""
    check_film(path)
    with replacing(path) as draft:
        if path.suffix.lower() == ".mp4":
            _save_mp4(pictures, draft, per_second, path)
        else:
            _save_gif(pictures, draft, per_second)


def _save_gif(pictures: list[Picture], path: Path, per_second: int) -> None:
    """Write the pictures in colours that all of them share: a frame then holds no more than what has moved."""
    from PIL import Image

    some = np.concatenate(pictures[:: max(1, len(pictures) // 8)])
    palette = Image.fromarray(some).quantize(_COLOURS, method=Image.Quantize.MAXCOVERAGE)  # white stays white
    frames = [Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    frames[0].save(
        path, format="GIF", save_all=True, append_images=frames[1:], duration=round(1000 / per_second), loop=0
    )


def _save_mp4(pictures: list[Picture], path: Path, per_second: int, said: Path) -> None:
    height, width, _ = pictures[0].shape
    given = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(per_second), "-i", "-"]
    made = ["-an", "-vcodec", "libx264", "-pix_fmt", "yuv420p", "-f", "mp4", str(path)]
    raw = b"".join(picture.tobytes() for picture in pictures)
    done = subprocess.run(["ffmpeg", "-y", "-loglevel", "error", *given, *made], input=raw, capture_output=True)
    if done.returncode:
        raise CannotWrite(said, OSError(done.stderr.decode(errors="replace").strip()[:200]))
