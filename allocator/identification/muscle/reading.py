"""Tables of measured forces: CSV files, and those of the package, with their sources in the first lines.

One line of column names, then one sample per line (`allocator.files.csv_table`). Columns, in any order; others are
listed in the notes:

    contraction [%] or as a ratio without a unit, or length or shortening [mm, cm, m, in]   (these need the rest length)
    pressure [bar, mbar, kPa, MPa, Pa, psi], gauge
    force [N, kN, mN, lbf, kgf, gf]
    direction +1, up, inflating, … where the varied quantity rises; -1, down, deflating, … where it falls
    time [s, ms, us, ns, min] of rows at most 0.5 s apart makes the file a raw log, whose spikes are left out

in the words of `headers`: `eps [%]`, `Pressure (kPa)`, `force_N`, `Kraft [N]`, …; for other names see `columns`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.resources import as_file, files

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput, MissingBackend
from allocator.files.text import FilePath
from allocator.identification.columns import Measured, read_columns
from allocator.identification.muscle.samples import Samples, find_mistake
from allocator.identification.recording import is_raw, without_spikes

_CONTRACTION = ("contraction", "length", "shortening")
_WANTED = (_CONTRACTION, ("pressure",), ("force",))


def read_samples(
    path: FilePath,
    rest_length: float | None = None,
    columns: Mapping[str, str] | None = None,
    *,
    skip_rows: int = 0,
    topics: str | None = None,
) -> Samples:
    """Read measured forces; `rest_length` [m] is needed for a length or a shortening.

    `columns` assigns columns with unclear names: ``{"pressure": "p:bar", "force": "F:-N"}``, name and unit; a minus
    reverses the sign, ``bar(abs)`` subtracts the atmosphere. `skip_rows` lines are skipped at the beginning of the
    file. Rows of a raw log with a missing reading, a spike, or a drop-out of a pressure are left out. `topics` maps
    quantities to numbers of a ROS bag or an MCAP file, see `read_motion_log`. `Samples.notes` lists the unused rows.

    Raises `InvalidFile`, with line and column, for unreadable or implausible contents.
    """
    measured = read_columns(path, _WANTED, ("direction", "time"), columns, skip_rows=skip_rows, topics=topics)
    if is_raw(measured):
        measured = without_spikes(measured)
    P, F = measured.values["pressure"], measured.values["force"]
    eps = _contraction(measured, rest_length)
    if mistake := find_mistake(eps, P, F):
        held = next(quantity for quantity in _CONTRACTION if quantity in measured.values)
        quantity = held if mistake.quantity == "contraction" else mistake.quantity
        raise measured.mistake(quantity, mistake.sentence, mistake.place)
    return replace(Samples.checked(eps, P, F), direction=measured.values.get("direction"), notes=measured.notes)


def _contraction(measured: Measured, rest_length: float | None) -> Array:
    if "contraction" in measured.values:
        return measured.values["contraction"]
    held = "length" if "length" in measured.values else "shortening"
    length = measured.values[held]
    if rest_length is None:
        raise measured.mistake(held, "lengths need the rest length of the muscle (--rest-length, in mm)")
    if not (np.isfinite(rest_length) and rest_length > 0):
        raise InvalidInput(f"rest_length = {rest_length!r} m has to be positive")
    if held == "shortening":
        return np.asarray(length / rest_length)
    if not 0.3 < np.median(length) / rest_length < 1.3:
        what = f"lengths around {np.median(length):.4g} m do not belong to a muscle of {rest_length:.4g} m"
        raise measured.mistake("length", f"{what}; mm for m?")
    return np.asarray((rest_length - length) / rest_length)


@dataclass(frozen=True)
class Dataset:
    """Table of measured forces in the package."""

    file: str
    about: str
    rest_length: float | None = None  # l0 [m], if the table gives lengths

    def samples(self) -> Samples:
        """Read the table."""
        with as_file(files("allocator") / "data" / self.file) as path:
            return read_samples(path, self.rest_length)


DATASETS = {
    "dmsp-20-300-map": Dataset(
        "force_map_dmsp_20_300.csv", "Festo DMSP-20-300, measured (Martens & Boblan 2017)", rest_length=0.300
    ),
    "dmsp-20-sheet": Dataset("force_sheet_dmsp_20.csv", "Festo DMSP-20, read off the manufacturer's data sheet"),
}
"""Every table, by the name that the command line takes."""


def load_dataset(name: str) -> Samples:
    """Load the measured forces of the table `name` (see `DATASETS`)."""
    if name not in DATASETS:
        raise MissingBackend("data set", name, DATASETS)
    return DATASETS[name].samples()
