"""An FMU is packed here: descriptions, sources, and what this machine's compiler makes of them."""

import hashlib
import platform
import sys
import tempfile
import zipfile
from pathlib import Path, PurePosixPath

from allocator.errors import InvalidInput
from allocator.files.atomic import replacing
from mpc.export.building import compile_c, write
from mpc.export.fmu.description import Model, build_description, model_description
from mpc.export.fmu.variables import variables_header
from mpc.export.parts import Files, copied

_INCLUDES = (".", "src")
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the same FMU of the same model, whenever it is made
_SUFFIXES = {"linux": ".so", "darwin": ".dylib"}


def packed(model: Model, own: Files, path: Path, binary: bool) -> Path:
    """Write the FMU of `model`, whose `own` C files are given, to `path`.

    Raises `InvalidInput` for another suffix than .fmu, `CannotWrite`, and `MissingBackend` without a C compiler unless
    `binary` is false.
    """
    if path.suffix != ".fmu":
        raise InvalidInput(f"out = {path} has to end in .fmu")
    sources = own | dict(copied("fmi3", "")) | dict(copied("fmu", "src/"))
    token = _token(sources, model)
    sources["src/unit_variables.h"] = variables_header(model.variables, model.dt, token)
    units = sorted(name for name in sources if PurePosixPath(name).match("src/*.c") and name.count("/") == 1)
    entries = {f"sources/{name}": content.encode() for name, content in sources.items()}
    entries["sources/buildDescription.xml"] = build_description(model, units, _INCLUDES).encode()
    entries["modelDescription.xml"] = model_description(model, token).encode()
    if binary:
        name, content = _binary(model, sources, units)
        entries[name] = content
    with replacing(path) as draft, zipfile.ZipFile(draft, "w") as archive:
        for name in sorted(entries):
            archive.writestr(zipfile.ZipInfo(name, _EPOCH), entries[name], zipfile.ZIP_DEFLATED)
    return path


def _token(sources: Files, model: Model) -> str:
    """Return what identifies these sources and variables."""
    digest = hashlib.sha256(repr((sorted(sources.items()), model)).encode())
    return digest.hexdigest()


def _binary(model: Model, sources: Files, units: list[str]) -> tuple[str, bytes]:
    """Return the name and the content of the library for this machine."""
    suffix = _SUFFIXES.get(sys.platform)
    if suffix is None:
        raise InvalidInput(f"an FMU is compiled on Linux and macOS only, not on {sys.platform}: say source_only")
    machine = {"AMD64": "x86_64", "arm64": "aarch64"}.get(platform.machine(), platform.machine())
    with tempfile.TemporaryDirectory(prefix="antagonist-fmu-") as made:
        directory = write(sources, Path(made) / "c")
        library = directory / f"{model.identifier}{suffix}"
        flags = ["-O2", "-fPIC", "-shared", "-fvisibility=hidden", *(f"-I{name}" for name in _INCLUDES)]
        compile_c("the FMU", directory, *flags, *units, "-lm", "-o", str(library))
        return f"binaries/{machine}-{sys.platform}/{library.name}", library.read_bytes()
