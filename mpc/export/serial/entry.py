"""`export_board` writes the firmware of a board on a serial line, and its simulation, as a directory of C files."""

from os import PathLike
from pathlib import Path

from numpy.typing import ArrayLike

from mpc.export.building import check, write
from mpc.export.entry import controller_files, pair
from mpc.export.parts import Files, is_single
from mpc.export.plant import real_plant, start_of
from mpc.export.serial.firmware import Safety, firmware_files, simulation_files
from mpc.model.plant import Plant
from mpc.model.real_plant import RealPlant
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.controller import TrackingMPC


def export_board(
    out: str | PathLike[str],
    *,
    process: Plant | RealPlant | None = None,
    controller: TrackingMPC | None = None,
    observer: KalmanObserver | None = None,
    safety: Safety | None = None,
    precision: str = "double",
    x0: ArrayLike | None = None,
) -> Path:
    """Write the firmware of a board to the directory `out`, and return it.

    Parameters
    ----------
    process
        The plant under the simulated board; its joint's supply is what commands have to lie within. By default the
        controller's plant, or `Plant()`.
    controller, observer
        What is to run on the board; without a controller it is a dumb terminal.
    safety
        What the board does when the host is silent, by default `Safety()`.
    precision
        Of the controller, "double" or "single".
    x0
        State (4,) that the simulated plant begins in: θ [rad], ω [rad/s], P1, P2 [Pa]; by default at rest in the middle
        of the joint range.

    Raises
    ------
    InvalidInput
        For what C cannot do (see `mpc.export.export`), and for a directory that is not empty. Nothing is written then.
    MissingBackend
        For an unknown `precision`.
    """
    single = is_single(precision)
    check(Path(out))
    return write(board_files(process, controller, observer, safety or Safety(), single, x0), out)


def board_files(
    process: Plant | RealPlant | None,
    controller: TrackingMPC | None,
    observer: KalmanObserver | None,
    safety: Safety,
    single: bool = False,
    x0: ArrayLike | None = None,
) -> Files:
    """Return the files of the firmware and of the simulated board; see `export_board`."""
    if process is None:
        process = Plant() if controller is None else controller.plant
    real = real_plant(process)
    files: Files = {}
    if controller is not None:
        files = controller_files(*pair(None, controller, observer), single, alone=True)
    files |= firmware_files(real.nominal.joint.pressure_limits, safety, controller)
    return files | simulation_files(real, start_of(real) if x0 is None else x0)
