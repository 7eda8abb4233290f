"""Measurements of the benchmark: where they come from, under which licence, and the checksums that make scores one."""

import hashlib
from pathlib import Path
from typing import NamedTuple

from allocator.errors import InvalidFile
from benchmarks.real import arm_log, forces, joint


class Source(NamedTuple):
    """A file of measurements."""

    tasks: str
    path: Path  # in the folder of data, or shipped
    sha256: str
    origin: str
    licence: str

    def find(self, folder: Path | None) -> Path | None:
        """Return the file, or None if it is not in the folder.

        Raises `InvalidFile` for a file with another checksum: its scores would be those of other data.
        """
        if not self.path.is_absolute() and folder is None:
            return None
        path = self.path if folder is None or self.path.is_absolute() else folder / self.path
        if not path.is_file():
            return None
        if (found := hashlib.sha256(path.read_bytes()).hexdigest()) != self.sha256:
            raise InvalidFile(path, f"sha256 {found[:12]}… is not {self.sha256[:12]}…: other data than the benchmark's")
        return path


FORCES = Source(
    "a, b",
    forces.FILE,
    "e2277fab098f4c1de54cf07d179370e5195262372bb03bb4b4e187eafc910dea",
    "Agile-and-Adaptive-Robotics/Muscle_Sensory, BPA_Static_Characterization_Test/10mmData_Nov2022, commit e3a82772, "
    "binned at 10 kPa",
    "none stated: not shipped",
)
JOINT = Source(
    "c",
    joint.FILE,
    "071dd29cbef1f7ac7259c988643f001a7deb754edc0df21b28e6e9eccb20e59b",
    "k-kan0926/paper_graph, the first 220 s of a log of 440 s",
    "none stated: not shipped",
)
ARM = Source(
    "d",
    arm_log.SAMPLE,
    "7ec91fa36dd57c1d1ca92cca7418de04ffb4d4f58cdfaea6dd0601b4d80e2dd5",
    "ALRhub/action-conditional-rkn, data/PAMData/Data2, commit 7a8ae18c, the first 100 episodes",
    "MIT: shipped with its notice",
)
