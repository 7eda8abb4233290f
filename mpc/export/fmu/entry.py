"""Functions `export_plant_fmu` and `export_controller_fmu`: FMUs for Simulink, Modelica and other FMI 3.0 tools.

Platforms of an FMU's binaries by their names in FMI 3.0, and the compilation of a library for each.
"""

import hashlib
import platform
import sys
import tempfile
import zipfile
from collections.abc import Iterable, Sequence
from importlib import metadata
from os import PathLike
from pathlib import Path, PurePosixPath
from typing import NamedTuple
from xml.etree import ElementTree

from numpy.typing import ArrayLike

from allocator import checks
from allocator.errors import InvalidInput
from allocator.files.atomic import replacing
from mpc.export.building import compile_c, write
from mpc.export.entry import controller_files, pair
from mpc.export.fmu.variables import UNITS, Variable, controller_variables, plant_variables, variables_header
from mpc.export.parts import Files, copied
from mpc.export.plant import plant_files, real_machine, start_of
from mpc.model.machine import Machine
from mpc.model.plant import Plant
from mpc.model.real_experiment import RealMachine
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.controller import TrackingMPC

_TARGETS = {  # of Zig's C compiler
    "x86_64-linux": "x86_64-linux-gnu.2.17",
    "aarch64-linux": "aarch64-linux-gnu.2.17",
    "x86_64-windows": "x86_64-windows-gnu",
    "x86_64-darwin": "x86_64-macos",
    "aarch64-darwin": "aarch64-macos",
}
PLATFORMS = tuple(_TARGETS)
_SUFFIXES = {"linux": ".so", "darwin": ".dylib", "windows": ".dll"}
_SYSTEMS = {"win32": "windows"}
_MACHINES = {"AMD64": "x86_64", "arm64": "aarch64", "ARM64": "aarch64"}


def this_machine() -> str:
    """Return the platform of this machine."""
    machine = platform.machine()
    return f"{_MACHINES.get(machine, machine)}-{_SYSTEMS.get(sys.platform, sys.platform)}"


def checked(platforms: Sequence[str] | None) -> tuple[str, ...]:
    """Return the platforms, by default that of this machine. Raises `InvalidInput` for unknown ones."""
    if platforms is None:
        return (this_machine(),)
    known = {*PLATFORMS, this_machine()}
    if isinstance(platforms, str) or not known.issuperset(platforms):
        raise InvalidInput(f"platforms = {platforms!r} has to be a sequence of {', '.join(sorted(known))}")
    return tuple(dict.fromkeys(platforms))


def binary(
    identifier: str, sources: Files, units: Sequence[str], includes: Sequence[str], on: str
) -> tuple[str, bytes]:
    """Return the name in the archive and the content of the library for the platform `on`.

    The C compiler of Linux and macOS serves this machine, the package ziglang all other platforms. Raises
    `AntagonistError`, `MissingBackend` without a compiler, and `MissingPackage` without ziglang.
    """
    system = on.rpartition("-")[2]
    if system not in _SUFFIXES:
        raise InvalidInput(f"FMUs have binaries for {', '.join(PLATFORMS)}, not for {on}: write the sources only")
    name = identifier + _SUFFIXES[system]
    own = on == this_machine() and system != "windows"  # Windows has no compiler of a usual name
    flags = ["-O2", "-fPIC", "-shared", "-s", "-fvisibility=hidden", *(f"-I{directory}" for directory in includes)]
    with tempfile.TemporaryDirectory(prefix="antagonist-fmu-") as made:
        directory = write(sources, Path(made) / "c")
        compile_c("the FMU", directory, *flags, *units, "-lm", "-o", name, target=None if own else _TARGETS[on])
        return f"binaries/{on}/{name}", (directory / name).read_bytes()


_TIME = "0"  # reference of the time; variables are numbered from 1


class Model(NamedTuple):
    """Description of an FMU."""

    identifier: str  # of its functions and files
    about: str
    dt: float  # [s]
    variables: Sequence[Variable]


def model_description(model: Model, token: str) -> str:
    """Return modelDescription.xml."""
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=model.identifier,
        instantiationToken=token,
        description=model.about,
        license="BSD-3-Clause",
        generationTool=f"antagonist {metadata.version('antagonist')}",
    )
    ElementTree.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=model.identifier,
        canGetAndSetFMUState="true",
        canSerializeFMUState="true",
        fixedInternalStepSize=repr(model.dt),
    )
    _units(ElementTree.SubElement(root, "UnitDefinitions"))
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0", stepSize=repr(model.dt))
    listed = ElementTree.SubElement(root, "ModelVariables")
    time = {"name": "time", "valueReference": _TIME, "causality": "independent", "variability": "continuous"}
    ElementTree.SubElement(listed, "Float64", time, unit="s")
    for reference, variable in enumerate(model.variables, start=1):
        _variable(listed, reference, variable)
    structure = ElementTree.SubElement(root, "ModelStructure")
    outputs = [str(k) for k, variable in enumerate(model.variables, start=1) if variable.causality == "output"]
    for kind in ("Output", "InitialUnknown"):
        for output in outputs:
            ElementTree.SubElement(structure, kind, valueReference=output)
    return _written(root)


def _units(parent: ElementTree.Element) -> None:
    for name, exponents in UNITS.items():
        unit = ElementTree.SubElement(parent, "Unit", name=name)
        ElementTree.SubElement(unit, "BaseUnit", {base: str(power) for base, power in exponents.items()})


def _variable(parent: ElementTree.Element, reference: int, variable: Variable) -> None:
    given = {"name": variable.name, "valueReference": str(reference), "causality": variable.causality}
    given["description"] = variable.about
    given["variability"] = "fixed" if variable.causality == "parameter" else "discrete"
    if variable.causality == "output":
        given["initial"] = "calculated"
    else:
        given["start"] = " ".join(map(repr, variable.starts))
    if variable.unit is not None:
        given["unit"] = variable.unit
    made = ElementTree.SubElement(parent, "Int32" if variable.unit is None else "Float64", given)
    if variable.is_row:
        ElementTree.SubElement(made, "Dimension", start=str(len(variable.starts)))


def build_description(model: Model, sources: Iterable[str], includes: Iterable[str]) -> str:
    """Return buildDescription.xml: the `sources` to compile and the directories of headers, below sources/."""
    root = ElementTree.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ElementTree.SubElement(root, "BuildConfiguration", modelIdentifier=model.identifier)
    files = ElementTree.SubElement(configuration, "SourceFileSet", language="C99")
    for name in sources:
        ElementTree.SubElement(files, "SourceFile", name=name)
    for name in includes:
        ElementTree.SubElement(files, "IncludeDirectory", name=name)
    return _written(root)


def _written(root: ElementTree.Element) -> str:
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


_INCLUDES = (".", "src")
_EPOCH = (1980, 1, 1, 0, 0, 0)  # fixed, so that the same model gives the same file


def packed(model: Model, own: Files, path: Path, platforms: Sequence[str] | None) -> Path:
    """Write the FMU of `model`, with its `own` C files and binaries for the `platforms`, to `path`.

    Raises `InvalidInput` for a suffix other than .fmu and for unknown platforms, `CannotWrite`, and `MissingBackend`
    without a C compiler.
    """
    platforms = checked(platforms)
    if path.suffix != ".fmu":
        raise InvalidInput(f"out = {path} has to end in .fmu")
    sources = own | dict(copied("fmi3", "")) | dict(copied("fmu", "src/"))
    token = _token(sources, model)
    sources["src/unit_variables.h"] = variables_header(model.variables, model.dt, token)
    units = sorted(name for name in sources if PurePosixPath(name).match("src/*.c") and name.count("/") == 1)
    entries = {f"sources/{name}": content.encode() for name, content in sources.items()}
    entries["sources/buildDescription.xml"] = build_description(model, units, _INCLUDES).encode()
    entries["modelDescription.xml"] = model_description(model, token).encode()
    entries |= dict(binary(model.identifier, sources, units, _INCLUDES, on) for on in platforms)
    with replacing(path) as draft, zipfile.ZipFile(draft, "w") as archive:
        for name in sorted(entries):
            archive.writestr(zipfile.ZipInfo(name, _EPOCH), entries[name], zipfile.ZIP_DEFLATED)
    return path


def _token(sources: Files, model: Model) -> str:
    """Return a token that identifies these sources and variables."""
    digest = hashlib.sha256(repr((sorted(sources.items()), model)).encode())
    return digest.hexdigest()


def export_plant_fmu(
    out: str | PathLike[str],
    process: Machine | RealMachine,
    dt: float = 0.01,
    *,
    x0: ArrayLike | None = None,
    platforms: Sequence[str] | None = None,
) -> Path:
    """Write `process` as the FMU `out`, and return its path.

    A step of `dt` [s] equals that of `simulate`, to the last bit if the compiler follows IEEE 754. Longer steps must be
    multiples of `dt`; commands are held meanwhile. The outputs have no sensor noise. `x0` (2n + m,) is the default
    initial state: angles [rad], rates [rad/s], pressures [Pa]; if None, at rest in the middle of the ranges.
    `platforms` are those of the binaries, by default this machine's. The package ziglang compiles those of `PLATFORMS`
    for others. With none, (), the importing tool compiles the sources. Raises `InvalidInput` (also for faults, a torque
    profile and an arm without formulas), `CannotWrite`, `MissingBackend` without a C compiler, and `MissingPackage`
    without ziglang.
    """
    real, dt = real_machine(process), checks.positive("dt", dt, "s")
    x = start_of(real, x0)
    about = f"pneumatic-muscle {'joint' if isinstance(real.nominal, Plant) else 'arm'}: {real.nominal.summary}"
    model = Model("antagonist_plant", about, dt, plant_variables(real, x))
    own = plant_files(real, dt, "src/") | dict(copied("fmu/plant", "src/"))
    return packed(model, own, Path(out), platforms)


def export_controller_fmu(
    out: str | PathLike[str],
    controller: TrackingMPC | None = None,
    observer: KalmanObserver | None = None,
    *,
    platforms: Sequence[str] | None = None,
) -> Path:
    """Write `controller` behind `observer` as the FMU `out`, and return its path.

    By default they are those of `mpc.export.export`, in double precision. A step uses the readings and references set
    at its beginning, and its commands are for that time. `platforms` and errors are those of `export_plant_fmu`, in
    addition to the errors of `mpc.export.export`.
    """
    controller, observer = pair(None, controller, observer)
    plant = controller.plant
    x0 = start_of(real_machine(plant))
    about = f"model predictive controller and observer of pneumatic muscles: {plant.summary}"
    model = Model("antagonist_controller", about, controller.dt, controller_variables(controller, x0))
    files = controller_files(controller, observer, False, alone=True)
    own = {name: content for name, content in files.items() if name not in _DEMONSTRATION}
    return packed(model, own | dict(copied("fmu/controller", "src/")), Path(out), platforms)


_DEMONSTRATION = ("main.c", "CMakeLists.txt", "README.md", "src/demonstration.h", "src/demonstration_control.h")
