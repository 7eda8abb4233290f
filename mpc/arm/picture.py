"""Pictures of a plant, rendered offscreen, with muscles that swell and redden with their pressures.

A model that is not from `mpc.arm.mjcf` may have neither sky nor lights, so that MuJoCo shows it dark on black. Its
pictures get a bright sky and a lamp at the camera.
"""

import os
import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from allocator.errors import InvalidInput, MissingBackend
from mpc.arm.mjcf import paint
from mpc.arm.mujoco_plant import MujocoPlant

if TYPE_CHECKING:
    from mujoco import MjvScene
    from mujoco.egl import GLContext  # those of OSMesa and GLFW have the same methods

_BARE = 0.010, 0.006  # [m] radius of a muscle of unknown volume: empty, and its growth at full pressure
_SKY = np.array([224, 232, 240], np.uint8)
_AMBIENT, _DIFFUSE = 0.4, 0.5  # of the lamp at the camera
_FILLING = 3.0  # rate at which a muscle looks full, over the supply's range


class Camera:
    """Camera for pictures of a `MujocoPlant`, arrays (height, width, 3) of bytes, by EGL, OSMesa or GLFW.

    `MUJOCO_GL` selects one of them; without it the first that works is used. Close it, or use it in a `with`.
    """

    def __init__(self, plant: MujocoPlant, width: int = 640, height: int = 480, camera: str | int = -1) -> None:
        """Open a context; `camera` is one of the model's, by default "view" if there is one, else a free one.

        Raises `InvalidInput`, and `MissingBackend` with the packages to install if no GL renders offscreen.
        """
        import mujoco

        self.plant, model = plant, plant.model
        most = model.vis.global_
        self._size = _sized("width", width, most.offwidth), _sized("height", height, most.offheight)
        self._view = mujoco.MjvCamera()
        mujoco.mjv_defaultFreeCamera(model, self._view)
        named = "view" if camera == -1 else str(camera)
        chosen = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, named)
        if isinstance(camera, int) and camera >= 0:
            chosen = camera
        if chosen >= model.ncam or (chosen < 0 and camera != -1):
            names = ", ".join(repr(model.camera(i).name) for i in range(model.ncam))
            raise InvalidInput(f"camera = {camera!r} is none of the model's ({names})")
        if chosen >= 0:
            self._view.type, self._view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, chosen
        self._sky = None if (model.tex_type == int(mujoco.mjtTexture.mjTEXTURE_SKYBOX)).any() else _SKY
        if not model.nlight:
            lamp = model.vis.headlight
            lamp.ambient[:], lamp.diffuse[:] = np.maximum(lamp.ambient, _AMBIENT), np.maximum(lamp.diffuse, _DIFFUSE)
        self._scene, self._option = mujoco.MjvScene(model, maxgeom=2000), mujoco.MjvOption()
        self._context = _context(*self._size)
        self._context.make_current()
        self._gpu = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._gpu)

    def render(self, mark: "Callable[[MjvScene], None] | None" = None) -> NDArray[np.uint8]:
        """Return the picture of the present plant (height, width, 3), with the marks that `mark` adds to the scene."""
        import mujoco

        plant, (width, height) = self.plant, self._size
        low, high = plant.pressure_limits
        fill = np.clip((plant.P - low) / (high - low), 0.0, 1.0)
        paint(plant.model, plant.muscle_names, plant.lengths, radii(plant), fill)
        mujoco.mj_kinematics(plant.model, plant.data)  # of the moved muscles
        self._context.make_current()
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(plant.model, plant.data, self._option, None, self._view, everything, self._scene)
        if mark is not None:
            mark(self._scene)
        window, picture = mujoco.MjrRect(0, 0, width, height), np.empty((height, width, 3), np.uint8)
        mujoco.mjr_render(window, self._scene, self._gpu)
        if self._sky is None:
            mujoco.mjr_readPixels(picture, None, window, self._gpu)
        else:
            depth = np.empty((height, width), np.float32)
            mujoco.mjr_readPixels(picture, depth, window, self._gpu)
            picture = np.where((depth >= 1.0)[..., None], self._sky, picture)
        return picture[::-1].copy()

    def close(self) -> None:
        """Release the context."""
        self._gpu.free()
        self._context.free()

    def __enter__(self) -> "Camera":
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()


def radii(plant: MujocoPlant) -> Array:
    """Return the radii (m,) [m] of the drawn muscles.

    At full pressure they are cylinders with the muscles' lengths and volumes; an empty one has its manufactured radius.
    Muscle models without a volume are drawn with a guessed radius.
    """
    low, high = plant.pressure_limits
    filled = 1 - np.exp(-_FILLING * np.clip((plant.P - low) / (high - low), 0.0, 1.0))
    try:
        volumes = plant.pneumatics.volumes(plant.lengths, plant.P)
        empty = plant.pneumatics.volumes(plant.pneumatics.rest_length, np.zeros(plant.m))
    except InvalidInput:  # a muscle model without a radius
        return np.asarray(_BARE[0] + _BARE[1] * filled)
    thin = np.sqrt(empty / (np.pi * plant.pneumatics.rest_length))
    return np.asarray(thin + filled * (np.sqrt(np.maximum(volumes, 0.0) / (np.pi * plant.lengths)) - thin))


def _context(width: int, height: int) -> "GLContext":
    """Return a context of the GL in `MUJOCO_GL`, or of the first that works. Raises `MissingBackend`."""
    asked = os.environ.get("MUJOCO_GL", "").lower()
    if asked and asked not in _MAKERS:
        raise MissingBackend("MUJOCO_GL", asked, _MAKERS)
    windows = [] if sys.platform.startswith("linux") and not os.environ.get("DISPLAY") else ["glfw"]
    why = []
    for name in [asked] if asked else [*(["egl", "osmesa"] if sys.platform.startswith("linux") else []), *windows]:
        try:
            return _MAKERS[name](width, height)
        except Exception as error:  # exceptions of a missing driver: AttributeError, ImportError, GLError, …
            why.append(f"{name}: {type(error).__name__}")
    raise MissingBackend("offscreen GL", ", ".join(why) or sys.platform, _ADVICE)


def _made(name: str, width: int, height: int) -> "GLContext":
    context: GLContext = import_module(f"mujoco.{name}").GLContext(width, height)
    return context


def _sized(name: str, value: int, most: int) -> int:
    if not 1 <= value <= most:
        raise InvalidInput(f"{name} = {value!r} has to lie between 1 and the model's {most} pixels (visual/global)")
    return int(value)


_MAKERS = {name: partial(_made, name) for name in ("egl", "osmesa", "glfw")}
_ADVICE = [
    "EGL (Debian: apt install libegl1, then MUJOCO_GL=egl)",
    "OSMesa (Debian: apt install libosmesa6, then MUJOCO_GL=osmesa)",
    "a screen (MUJOCO_GL=glfw)",
]
