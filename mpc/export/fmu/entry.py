"""Functions `export_plant_fmu` and `export_controller_fmu`: FMUs for Simulink, Modelica and other FMI 3.0 tools."""

from collections.abc import Sequence
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.errors import InvalidInput
from mpc.export.controller.demonstration import arm_at_rest
from mpc.export.entry import controller_files, pair
from mpc.export.fmu.archive import Model, packed
from mpc.export.fmu.variables import controller_variables, plant_variables
from mpc.export.parts import copied
from mpc.export.plant import plant_files, real_plant, start_of
from mpc.model.arm.model import Arm
from mpc.model.plant import NX, Plant
from mpc.model.real_plant import RealPlant
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.controller import TrackingMPC


def export_plant_fmu(
    out: str | PathLike[str],
    process: Plant | RealPlant,
    dt: float = 0.01,
    *,
    x0: ArrayLike | None = None,
    platforms: Sequence[str] | None = None,
) -> Path:
    """Write `process` as the FMU `out`, and return its path.

    A step of `dt` [s] equals that of `simulate`, to the last bit if the compiler follows IEEE 754. Longer steps must be
    multiples of `dt`; commands are held meanwhile. The outputs have no sensor noise. `x0` (4,) is the default initial
    state: θ [rad], ω [rad/s], P1, P2 [Pa]; if None, at rest in the middle of the joint range. `platforms`
    are those of the binaries, by default this machine's. Others, of `PLATFORMS`, are compiled by the package ziglang.
    With none, (), the importing tool compiles the sources. Raises `InvalidInput` (also for faults and a torque
    profile), `CannotWrite`, `MissingBackend` without a C compiler, and `MissingPackage` without ziglang.
    """
    real, dt = real_plant(process), checks.positive("dt", dt, "s")
    x = start_of(real) if x0 is None else np.asarray(x0, float)
    if x.shape != (NX,) or not np.isfinite(x).all():
        raise InvalidInput(f"x0 = {x0!r} has to be 4 finite numbers (theta [rad], omega [rad/s], P1 [Pa], P2 [Pa])")
    about = f"pneumatic-muscle joint: {real.nominal.summary}"
    model = Model("antagonist_plant", about, dt, plant_variables(real, x))
    own = plant_files(real, dt, "src/") | dict(copied("fmu/plant", "src/"))
    return packed(model, own, Path(out), platforms)


def export_controller_fmu(
    out: str | PathLike[str],
    controller: TrackingMPC | None = None,
    observer: KalmanObserver | None = None,
    *,
    platforms: Sequence[str] | None = None,
) -> Path:
    """Write `controller` behind `observer` as the FMU `out`, and return its path.

    By default they are those of `mpc.export.export`, in double precision. A step uses the readings and references set
    at its beginning, and its commands are for that time. `platforms` and errors are those of `export_plant_fmu`, in
    addition to the errors of `mpc.export.export`.
    """
    controller, observer = pair(None, controller, observer)
    plant = controller.plant
    x0 = arm_at_rest(plant)[0] if isinstance(plant, Arm) else start_of(real_plant(plant))
    about = f"model predictive controller and observer of pneumatic muscles: {plant.summary}"
    model = Model("antagonist_controller", about, controller.dt, controller_variables(controller, x0))
    files = controller_files(controller, observer, False, alone=True)
    own = {name: content for name, content in files.items() if name not in _DEMONSTRATION}
    return packed(model, own | dict(copied("fmu/controller", "src/")), Path(out), platforms)


_DEMONSTRATION = ("main.c", "CMakeLists.txt", "README.md", "src/demonstration.h", "src/demonstration_control.h")
