"""The measured force tables come with the package; their sources stand at the top of each file."""

from dataclasses import dataclass
from importlib.resources import as_file, files

from allocator.errors import MissingBackend
from allocator.identification.muscle.reading import read_samples
from allocator.identification.muscle.samples import Samples


@dataclass(frozen=True)
class Dataset:
    """A data set is a table of measured forces in the package."""

    file: str
    about: str
    rest_length: float | None = None  # l0 [m], where the table gives lengths

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
