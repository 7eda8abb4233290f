"""`export`: a joint's allocation and controller as a directory of C files."""

from os import PathLike
from pathlib import Path

from allocator.errors import MissingBackend
from allocator.joint import AntagonistJoint, report_joint
from mpc.export import text
from mpc.export.demonstration import allocation_lines, allocation_table
from mpc.export.joint import law_of
from mpc.export.parts import allocation_files, copied
from mpc.export.readme import readme
from mpc.export.writing import check, write

WHAT = ("allocate", "mpc", "all")
PRECISIONS = ("double", "single")


def export(
    out: str | PathLike[str],
    *,
    joint: AntagonistJoint | None = None,
    what: str = "all",
    precision: str = "double",
) -> Path:
    """Write C files to the directory `out`, and return it.

    Raises InvalidInput for a joint without a closed-form allocation, and for a directory that is not empty.
    """
    if what not in WHAT:
        raise MissingBackend("export", what, WHAT)
    if precision not in PRECISIONS:
        raise MissingBackend("precision", precision, PRECISIONS)
    check(Path(out))
    joint = report_joint() if joint is None else joint
    single = precision == "single"
    files = allocation_files(joint, single) | dict(copied(".", ""))
    files["antagonist_config.h"] = _config(single, {})
    files["src/demonstration.h"] = allocation_table(joint, single)
    files["README.md"] = readme(joint, law_of(joint).directory, single, list(allocation_lines(joint)))
    return write(files, out)


def _config(single: bool, sizes: dict[str, tuple[int, str]]) -> str:
    lines = ["#define ANT_SINGLE /* numbers are float */"] if single else []
    lines += [text.defines(sizes, single)] if sizes else []
    return text.header("ANTAGONIST_CONFIG_H", "What was chosen at export.", "\n".join(lines))


__all__ = ["PRECISIONS", "WHAT", "export"]
