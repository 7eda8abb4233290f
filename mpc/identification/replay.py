"""Free run of a plant's file over a log: the one place where the error of a file is computed."""

from os import PathLike
from typing import NamedTuple

import numpy as np

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidFile, InvalidInput
from allocator.files.toml import Table
from allocator.identification.motion.result import Errors
from allocator.identification.motion.samples import TAUT_FROM, MotionLog
from allocator.units import DEG
from mpc.model.compensation import Compensation
from mpc.model.free_run import free_run
from mpc.model.plant import Plant
from mpc.model.real_plant import RealPlant

COMMANDED, IMPOSED = "commanded", "in the muscles"  # `pressures` in [source]


class Replay(NamedTuple):
    """Log of a moving joint, and the angles that a plant's file predicts for it."""

    log: MotionLog
    theta: Array  # as the encoder would show it (n,) [rad]

    def errors(self, judged: Mask | None = None) -> Errors:
        """Return the RMS errors [rad] over the rows `judged` (n,); by default those after the first two seconds."""
        rows, taut = self.log.settled if judged is None else judged, np.minimum(self.log.P1, self.log.P2) >= TAUT_FROM
        return Errors.of(self.log.theta - self.theta, rows, taut)


def replay(path: str | PathLike[str], log: MotionLog) -> Replay:
    """Run the plant in the file `path` over the pressures of `log`, from the first angle on.

    The plant is what `Plant.load` and `Compensation.load` return, as commands, controllers and observers take it. The
    encoder's zero and whether the pressures of the log are commands stand in the file's table [source].
    Raises `InvalidFile`.
    """
    real = RealPlant.of(Plant.load(path, scale_needed=False), Compensation.load(path, scale_needed=False))
    table = Table.read(path).table("source")
    source = {} if table is None else table.entries
    zero, pressures = source.get("encoder_zero_deg", 0.0), source.get("pressures", COMMANDED)
    if pressures not in (COMMANDED, IMPOSED):
        raise InvalidFile(path, f"[source]: pressures has to be {COMMANDED!r} or {IMPOSED!r}")
    try:
        zero = checks.number("encoder_zero_deg", zero, "deg") * DEG
    except InvalidInput as error:
        raise InvalidFile(path, f"[source]: {error}") from None
    if abs(zero) > 2 * np.pi:
        raise InvalidFile(path, f"[source]: encoder_zero_deg = {zero / DEG:g} is over a turn")
    commanded = pressures == COMMANDED
    theta = free_run(real, log.t, log.P1, log.P2, begin=float(log.theta[0]) - zero, commanded=commanded)
    return Replay(log, theta + zero)
