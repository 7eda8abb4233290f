"""A film of a run shows the arm as it moves: rendered by MuJoCo where there is a GL, else drawn by matplotlib."""

from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from allocator.calculus import Array
from allocator.errors import MissingBackend
from allocator.presentation.plotting import new_figure
from allocator.units import BAR
from mpc.arm.mujoco_plant import MujocoPlant
from mpc.arm.picture import Camera
from mpc.model.arm.bodies import Bodies
from mpc.model.arm.model import Arm
from mpc.trials.pictures.animation import Picture, drawn, save_film
from mpc.trials.pictures.plotting import COLOURS

SIZE = 480, 360  # [pixels]
_RATE = 20  # pictures a second


class Film:
    """A film takes pictures of a `plant` every twentieth of a second while it moves; to be used in a `with`.

    `by` says what draws it: MuJoCo and its GL, or matplotlib and why.
    """

    def __init__(self, plant: MujocoPlant, arm: Arm) -> None:
        self.pictures: list[Picture] = []
        self._plant, self._camera = plant, None
        self._next = 0.0
        try:
            self._camera = Camera(plant, *SIZE)
            self._draw: Callable[[], Picture] = self._camera.render
            self.by = "MuJoCo"
        except MissingBackend as missing:
            self._draw = _Drawing(plant, arm).render
            self.by = f"matplotlib, because MuJoCo cannot render here ({missing})"

    def watch(self) -> None:
        """Take a picture if it is time for the next one."""
        if self._plant.time >= self._next - 1e-9:
            self.pictures.append(self._draw())
            self._next += 1 / _RATE

    def save(self, path: Path) -> None:
        """Write the film as a GIF or an MP4. Raises `CannotWrite`, and `MissingBackend` for an MP4 without ffmpeg."""
        save_film(self.pictures, path, _RATE)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, raised: BaseException | None, _: TracebackType | None) -> None:
        if self._camera is not None:
            self._camera.close()


class _Drawing:
    """A drawing has the links as lines, the way of the hand, and a bar for the pressure of every muscle."""

    def __init__(self, plant: MujocoPlant, arm: Arm) -> None:
        self._plant, self._arm = plant, arm
        self._figure = new_figure(SIZE[0] / 80, SIZE[1] / 80)
        self._figure.set_dpi(80)
        plane, bars = self._figure.subplots(1, 2, width_ratios=[3, 2])
        self._two = np.array([0, 1])
        if isinstance(arm.bodies, Bodies):
            reach = 1.1 * sum(arm.bodies.length)
            limits = (-0.4 * reach, reach), (-reach, reach)
        else:
            limits = self._seen_from()
        names = "xyz"[self._two[0]], "xyz"[self._two[1]]
        plane.set(xlim=limits[0], ylim=limits[1], xlabel=f"{names[0]} [m]", ylabel=f"{names[1]} [m]", aspect="equal")
        (self._links,) = plane.plot([], [], color=COLOURS[7], lw=6, marker="o", mfc=COLOURS[6], solid_capstyle="round")
        (self._way,) = plane.plot([], [], color=COLOURS[1], lw=1)
        self._trace: list[Array] = []
        self._bars = bars.barh(arm.mechanism.muscle_names, np.zeros(arm.m), color=COLOURS[1])
        bars.set(xlim=np.array(plant.pressure_limits) / BAR, xlabel="pressure [bar]")
        bars.tick_params(axis="y", labelsize=7)

    def render(self) -> Picture:
        """Return the drawing of the plant as it is now (height, width, 3)."""
        points = self._points()
        self._trace.append(points[-1])
        self._links.set_data(points[:, 0], points[:, 1])
        self._way.set_data(*np.transpose(self._trace))
        for bar, pressure in zip(self._bars, self._plant.P / BAR, strict=True):
            bar.set_width(pressure)
        return drawn(self._figure)

    def _points(self) -> Array:
        """Return the hinges and the end of the arm in the plane that is drawn (k, 2) [m]."""
        if isinstance(self._arm.bodies, Bodies):
            return np.asarray(self._arm.bodies.points(self._plant.q))
        return self._in_space()[:, self._two]

    def _in_space(self) -> Array:
        data = self._plant.data
        return np.vstack([data.xanchor, data.xipos[-1:]])

    def _seen_from(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Choose the two axes along which the model is largest; return how far it may reach along them."""
        points = self._in_space()
        self._two = np.sort(np.argsort(-np.ptp(points, axis=0), kind="stable")[:2])
        reach = 1.2 * float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
        x, y = points[0, self._two].tolist()
        return (x - reach, x + reach), (y - reach, y + reach)
