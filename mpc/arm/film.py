"""Film of a moving arm, rendered by MuJoCo if there is a GL, otherwise drawn by matplotlib."""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from allocator.calculus import Array
from allocator.errors import MissingBackend
from allocator.mechanism.bodies import Bodies
from allocator.mechanism.endpoint.endpoint import Endpoint, LinkagePoint, stiffness_of
from allocator.presentation.plotting import new_figure
from allocator.presentation.progress import counted
from allocator.units import BAR
from mpc.arm.mujoco_plant import Kept, MujocoPlant
from mpc.arm.picture import Camera
from mpc.model.arm.model import Arm
from mpc.trials.pictures.animation import Picture, drawn, save_film
from mpc.trials.pictures.plotting import COLOURS

if TYPE_CHECKING:
    from mujoco import MjvScene

SIZES = {".gif": (640, 360), ".mp4": (1280, 720)}  # [pixels] by the ending of a file
_DOTS = 80  # per inch, of drawings
_RATE = 20  # pictures per second
_LARGEST = 0.15  # [-] of the arm's reach: initial size of its stiffness ellipse
_RING = np.linspace(0, 2 * np.pi, 41)
_THIN = 0.002  # [m] of a line
_OVER = 0.03  # [m] height of the marks over the chain
_WAY, _STIFF = (0.0, 0.45, 0.7, 1.0), (0.1, 0.55, 0.25, 1.0)  # colours


class Film:
    """Film of a moving `plant` with a picture every twentieth of a second.

    Pictures show the path of the `hand`, by default the end of a chain in the plane, and the ellipse of its stiffness
    in two coordinates: the forces against displacements of one size. `size` is in pixels, one of `SIZES`. During the
    motion only states are stored, since a picture takes longer than a step.
    """

    by = ""  # the renderer of the pictures: MuJoCo, or matplotlib and the reason

    def __init__(
        self, plant: MujocoPlant, arm: Arm, size: tuple[int, int] = SIZES[".gif"], hand: Endpoint | None = None
    ) -> None:
        hand = hand or (arm.bodies.endpoint if isinstance(arm.bodies, Bodies) else None)
        known = hand is not None and isinstance(hand.kinematics, LinkagePoint)
        self._plant, self._arm, self._size, self._hand = plant, arm, size, hand if known else None
        self._states: list[Kept] = []
        self._next = 0.0

    def watch(self) -> None:
        """Store the plant's state if it is time for the next picture."""
        if self._plant.time >= self._next - 1e-9:
            self._states.append(self._plant.kept())
            self._next += 1 / _RATE

    @cached_property
    def pictures(self) -> list[Picture]:
        """All pictures; the plant then has its present state again."""
        plant, now = self._plant, self._plant.kept()
        marks = None if self._hand is None else Hand(plant, self._arm, self._hand)
        made: list[Picture] = []
        with ExitStack() as end:
            end.callback(plant.restore, now)
            draw = self._renderer(marks, end)
            for state in counted(self._states, "filming"):
                plant.restore(state)
                made.append(draw())
        return made

    def _renderer(self, marks: "Hand | None", end: ExitStack) -> Callable[[], Picture]:
        """Return the function that draws the present plant; `end` closes it."""
        try:
            camera = end.enter_context(Camera(self._plant, *self._size))
        except MissingBackend as missing:
            self.by = f"matplotlib, because MuJoCo cannot render here ({missing})"
            return _Drawing(self._plant, self._arm, marks, self._size).render
        self.by = "MuJoCo"
        return lambda: camera.render(None if marks is None else marks.mark)

    def save(self, path: Path) -> None:
        """Write the film as a GIF or an MP4. Raises `CannotWrite`, and `MissingBackend` for an MP4 without ffmpeg."""
        save_film(self.pictures, path, _RATE)


class Hand:
    """Marks of a hand: its path so far, and the ellipse of its stiffness in two coordinates."""

    def __init__(self, plant: MujocoPlant, arm: Arm, endpoint: Endpoint) -> None:
        kinematics: Any = endpoint.kinematics
        self._plant, self._arm, self._endpoint = plant, arm, endpoint
        self._axes = ["xyz".index(axis) for axis in kinematics.axes]
        self._place = replace(endpoint, kinematics=replace(kinematics, axes="xyz"))  # in space
        self._over = np.array([0.0, 0.0, _OVER if isinstance(arm.bodies, Bodies) else 0.0])
        joints = np.vstack([plant.data.xanchor, self.position()])
        self._largest = _LARGEST * float(np.linalg.norm(np.diff(joints, axis=0), axis=1).sum())
        self._scale = 0.0
        self.way: list[Array] = []

    def position(self) -> Array:
        """Return the hand's present position (3,) [m]."""
        return self._place.position(self._plant.q)

    def ellipse(self) -> Array:
        """Return the ellipse K_x·(cos φ, sin φ) about the hand (k, 3) [m]; nothing for a singular or another hand."""
        q = self._plant.q
        at = self._endpoint.at(q[None])
        K = stiffness_of(at, self._arm.mechanism.stiffness(q, self._plant.P)[None])[0]
        if len(self._axes) != 2 or not np.isfinite(K).all():
            return np.empty((0, 3))
        self._scale = self._scale or self._largest / float(np.linalg.norm(K, 2))
        curve = np.tile(self.position(), (len(_RING), 1))
        curve[:, self._axes] += self._scale * np.stack([np.cos(_RING), np.sin(_RING)], axis=1) @ K
        return curve

    def mark(self, scene: "MjvScene") -> None:
        """Add the path and the ellipse to a scene, as far as it has room."""
        self.way.append(self.position())
        for line, colour in ((np.array(self.way), _WAY), (self.ellipse(), _STIFF)):
            for begin, end in pairwise(line):
                _add(scene, begin + self._over, end + self._over, colour)


def _add(scene: "MjvScene", begin: Array, end: Array, colour: tuple[float, ...]) -> None:
    """Add a line to a scene that has room for it."""
    import mujoco

    if scene.ngeom >= scene.maxgeom:
        return
    geom, kind = scene.geoms[scene.ngeom], mujoco.mjtGeom.mjGEOM_CAPSULE
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.zeros(9), np.array(colour, np.float32))
    mujoco.mjv_connector(geom, kind, _THIN, begin, end)
    scene.ngeom += 1


class _Drawing:
    """Drawing of the links as lines, the marks of the `hand`, and a bar for the pressure of every muscle."""

    def __init__(self, plant: MujocoPlant, arm: Arm, hand: Hand | None, size: tuple[int, int]) -> None:
        self._plant, self._arm, self._hand = plant, arm, hand
        self._figure = new_figure(size[0] / _DOTS, size[1] / _DOTS)
        self._figure.set_dpi(_DOTS)
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
        (self._ellipse,) = plane.plot([], [], color=COLOURS[2], lw=1)
        self._trace: list[Array] = []
        self._bars = bars.barh(arm.mechanism.muscle_names, np.zeros(arm.m), color=COLOURS[1])
        bars.set(xlim=np.array(plant.pressure_limits) / BAR, xlabel="pressure [bar]")
        bars.tick_params(axis="y", labelsize=7)

    def render(self) -> Picture:
        """Return the drawing of the present plant (height, width, 3)."""
        points = self._points()
        self._trace.append(points[-1])
        self._links.set_data(points[:, 0], points[:, 1])
        self._way.set_data(*np.transpose(self._trace))
        if self._hand is not None:
            self._ellipse.set_data(*self._hand.ellipse()[:, self._two].T)
        for bar, pressure in zip(self._bars, self._plant.P / BAR, strict=True):
            bar.set_width(pressure)
        return drawn(self._figure)

    def _points(self) -> Array:
        """Return the hinges and the end of the arm in the drawn plane (k, 2) [m]."""
        if isinstance(self._arm.bodies, Bodies):
            return np.asarray(self._arm.bodies.points(self._plant.q))
        return self._in_space()[:, self._two]

    def _in_space(self) -> Array:
        data = self._plant.data
        return np.vstack([data.xanchor, data.xipos[-1:] if self._hand is None else self._hand.position()])

    def _seen_from(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Choose the two axes along which the model is largest; return its reach along them."""
        points = self._in_space()
        self._two = np.sort(np.argsort(-np.ptp(points, axis=0), kind="stable")[:2])
        reach = 1.2 * float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
        x, y = points[0, self._two].tolist()
        return (x - reach, x + reach), (y - reach, y + reach)
