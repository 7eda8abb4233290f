"""CSV logs of a moving joint.

Columns by name and unit as for `read_samples` (`phi [deg]`, `P1_bar`, …), in any order; others are listed in the notes:

    time [s, ms, us, ns, min]   increasing; s without a unit; also clock times (12:03:04.567, ISO 8601)
    theta [deg, rad]            as the encoder shows it
    pressure1, pressure2 [bar, mbar, kPa, MPa, Pa, psi], gauge, commanded or measured

Of a log with gaps of more than a second the longest part is used.
"""

from collections.abc import Mapping

from allocator.errors import InvalidFile, InvalidInput
from allocator.files.text import FilePath
from allocator.identification.columns import read_columns
from allocator.identification.motion.samples import MotionLog
from allocator.identification.recording import in_time, longest_stretch, refuse_spikes, refuse_turns, without_spikes

_WANTED = (("time",), ("theta",), ("pressure1",), ("pressure2",))


def read_motion_log(
    path: FilePath, columns: Mapping[str, str] | None = None, *, skip_rows: int = 0, drop_spikes: bool = False
) -> MotionLog:
    """Read the log of a moving joint; `columns` as for `read_joint_log`: ``{"theta": "phi:deg"}``.

    `skip_rows` lines are left out at the beginning of the file. With `drop_spikes`, rows are left out in which a
    reading is missing, jumps there and back, or is a pressure that drops out. `MotionLog.notes` lists what was not
    used.

    Raises `InvalidFile`, with line and column where one is at fault, also where the log moves too little.
    """
    measured = in_time(read_columns(path, _WANTED, (), columns, skip_rows=skip_rows, drop_missing=drop_spikes))
    if drop_spikes:
        measured = without_spikes(measured)
    else:
        refuse_spikes(measured)
    measured = longest_stretch(measured)
    refuse_turns(measured)
    t, theta, P1, P2 = (measured.values[quantity] for (quantity,) in _WANTED)
    try:
        MotionLog.checked(t, theta, P1, P2)
    except InvalidInput as error:
        raise InvalidFile(path, "; ".join((str(error), *measured.notes))) from None
    return MotionLog(t, theta, P1, P2, notes=measured.notes)
