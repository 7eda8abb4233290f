"""The log of a moving joint is read from a CSV file.

Columns by name and unit as for `read_samples` (`phi [deg]`, `P1_bar`, …), in any order, others are ignored:

    time [s, ms]                increasing; s without a unit
    theta [deg, rad]            as the encoder shows it
    pressure1, pressure2 [bar, mbar, kPa, MPa, Pa, psi], gauge, commanded or measured
"""

from collections.abc import Mapping

from allocator.errors import InvalidFile, InvalidInput
from allocator.files.csv_table import FilePath
from allocator.identification.columns import read_columns
from allocator.identification.motion.samples import MotionLog

_WANTED = (("time",), ("theta",), ("pressure1",), ("pressure2",))


def read_motion_log(path: FilePath, columns: Mapping[str, str] | None = None) -> MotionLog:
    """Read the log of a moving joint; `columns` as for `read_joint_log`: ``{"theta": "phi:deg"}``.

    Raises `InvalidFile`, with line and column where one is at fault, also where the log moves too little.
    """
    values = read_columns(path, _WANTED, (), columns).values
    rows = values["time"], values["theta"], values["pressure1"], values["pressure2"]
    try:
        MotionLog.checked(*rows)
    except InvalidInput as error:
        raise InvalidFile(path, str(error)) from None
    return MotionLog(*rows)


__all__ = ["read_motion_log"]
