"""`write_tuning` writes what a build in C takes while it runs; `weights_from` reads the weights of a command."""

from dataclasses import replace
from os import PathLike

from allocator.errors import InvalidInput
from allocator.files.atomic import write_text
from allocator.shell.options import numbers, within
from allocator.units import BAR, DEG
from mpc.export.parts import is_single
from mpc.export.tuning.numbers import tuning_text
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.weights import Weights

_ERRORS = {"theta": DEG, "omega": DEG, "K": 1.0, "u": BAR, "rate": BAR}  # weights by errors, in units of SI's


def write_tuning(path: str | PathLike[str], controller: TrackingMPC, *, precision: str = "double") -> None:
    """Write a tuning for a build that has been exported: its controller goes on with other weights, without a compiler.

    `controller` is that of the build but for `weights`, `min_force` and the plant's `slew`, in the build's `precision`;
    `N` and everything else stay those of the build. The numbers are for `ant_tuning_from`, one a line. Raises
    `MissingBackend` for an unknown precision, `CannotWrite`.
    """
    write_text(path, tuning_text(controller, is_single(precision)))


def weights_from(errors: str) -> Weights:
    """Return the export's weights with some changed: "theta=0.1,rate=0.3", the errors that cost one half.

    Units are degrees, degrees/s, N·m/rad, bar and bar/s. Raises `InvalidInput`.
    """
    changed = {}
    for part in errors.split(","):
        name, _, value = (piece.strip() for piece in part.partition("="))
        if name not in _ERRORS:
            raise InvalidInput(f"--errors {part.strip()!r}: expected NAME=ERROR, NAME being {', '.join(_ERRORS)}")
        [error] = numbers(f"--errors {name}", value, 1, 1, f"{name}=0.5")
        within(f"--errors {name}", error, "(an error that costs one half)", 1e-9, 1e9)
        changed[name] = 1 / (error * _ERRORS[name]) ** 2
    return replace(Weights.calm(), **changed)
