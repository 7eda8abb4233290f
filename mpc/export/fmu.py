"""Export of plants and controllers as FMUs for Simulink, Modelica and other tools of FMI 3.0, co-simulation in samples.

    export_plant_fmu("plant.fmu", RealPlant.standard(), dt=0.01)
    export_controller_fmu("controller.fmu", TrackingMPC(plant, N=10))

The C is that of `mpc.export` and `mpc.export.plant`. `mpc/export/c/fmu/` wraps it in the functions of FMI, and
`mpc/export/c/fmi3/` holds the unchanged headers of the standard (2-clause BSD). One list of variables
gives modelDescription.xml and the table in C.
"""

import hashlib
import platform
import sys
import tempfile
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from importlib import metadata
from os import PathLike
from pathlib import Path, PurePosixPath
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array
from allocator.compilation.printer import number
from allocator.errors import InvalidInput
from allocator.files.atomic import replacing
from mpc.export import text
from mpc.export.building import compile_c, write
from mpc.export.entry import controller_files, pair
from mpc.export.parts import Files, copied, names_of
from mpc.export.plant import plant_files, real_machine, start_of
from mpc.model.machine import Machine
from mpc.model.plant import Plant
from mpc.model.real_experiment import RealMachine
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.controller import TrackingMPC

_SET = {"input": 2, "parameter": 1, "output": 0}


class Variable(NamedTuple):
    """Variable of an FMU: a number, or a row of numbers."""

    name: str
    causality: str  # "input", "parameter" or "output"
    unit: str | None  # one of `UNITS`; None: an integer
    about: str
    start: float | Sequence[float] = 0.0  # ignored for outputs, which are computed
    finite: bool = False  # NaN and infinity are refused; otherwise the unit handles them

    @property
    def starts(self) -> tuple[float, ...]:
        """Start values."""
        return tuple(float(value) for value in np.atleast_1d(self.start))

    @property
    def is_row(self) -> bool:
        """Whether the variable is a row of numbers."""
        return np.ndim(self.start) == 1


UNITS: dict[str, dict[str, int]] = {  # exponents of the base units
    "rad": {"rad": 1},
    "rad/s": {"rad": 1, "s": -1},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "N": {"kg": 1, "m": 1, "s": -2},
    "N.m": {"kg": 1, "m": 2, "s": -2},
    "N.m/rad": {"kg": 1, "m": 2, "s": -2, "rad": -1},
    "s": {"s": 1},
}


def plant_variables(real: RealMachine, x0: Array) -> list[Variable]:
    """Return the variables of a plant that begins in `x0` (2n + m,), in the order of plant_unit.c."""
    n = real.nominal.n
    joints, muscles = _labels(real.nominal)
    theta, omega, P = (values.tolist() for values in np.split(np.asarray(x0, float), [n, 2 * n]))
    at_joints = [(i, name, *start) for (i, name), *start in zip(joints, theta, omega, strict=True)]
    at_muscles = [(j, name, start) for (j, name), start in zip(muscles, P, strict=True)]
    step = f"as an encoder of {real.encoder:g} rad a step reads it"
    entries = [f"{a}{b}" for a, b in zip(*(1 + np.array(np.triu_indices(n))), strict=True)] if n > 1 else [""]
    variables = [
        *(Variable(f"u{j}", "input", "Pa", f"commanded pressure of {name}", start) for j, name, start in at_muscles),
        *(Variable(f"d{i}", "input", "N.m", f"torque from outside on {name}") for i, name in joints),
        *(Variable(f"theta{i}_start", "parameter", "rad", f"angle of {name}", q) for i, name, q, _ in at_joints),
        *(Variable(f"omega{i}_start", "parameter", "rad/s", f"rate of {name}", rate) for i, name, _, rate in at_joints),
        *(
            Variable(f"P{j}_start", "parameter", "Pa", f"pressure of {name} at the beginning, and its command", start)
            for j, name, start in at_muscles
        ),
        *(Variable(f"theta{i}", "output", "rad", f"angle of {name}") for i, name in joints),
        *(Variable(f"omega{i}", "output", "rad/s", f"rate of {name}") for i, name in joints),
        *(Variable(f"P{j}", "output", "Pa", f"pressure of {name}, gauge") for j, name in muscles),
        *(Variable(f"theta{i}_measured", "output", "rad", f"angle of {name} {step}") for i, name in joints),
        *(Variable(f"K{entry}", "output", "N.m/rad", "stiffness of the joint" + "s" * (n > 1)) for entry in entries),
        *(Variable(f"T{i}", "output", "N.m", f"torque of the muscles about {name}") for i, name in joints),
        *(Variable(f"F{j}", "output", "N", f"force of {name}; negative: slack") for j, name in muscles),
    ]
    return [variable._replace(finite=variable.causality != "output") for variable in variables]


def controller_variables(controller: TrackingMPC, x0: Array) -> list[Variable]:
    """Return the variables of a controller and its observer, with the initial state `x0` (2n + m,), at rest.

    Rows of references have sample after sample; a stiffness matrix is its upper triangle, row after row.
    """
    plant, samples = controller.plant, controller.ahead + 1
    joints, muscles = _labels(plant)
    theta, P = x0[: plant.n], x0[2 * plant.n :]
    K = np.atleast_2d(plant.tracked_stiffness(x0))
    entries = K[np.triu_indices(len(K))]
    of_K = "reference of the stiffness" + ", upper triangles" * (plant.n > 1)
    return [
        *(
            Variable(f"theta{i}", "input", "rad", f"measured angle of {name}; NaN: not measured", start)
            for (i, name), start in zip(joints, theta.tolist(), strict=True)
        ),
        *(
            Variable(f"P{i}", "input", "Pa", f"measured pressure of {name}, gauge; NaN: not measured", start)
            for (i, name), start in zip(muscles, P.tolist(), strict=True)
        ),
        Variable(
            "theta_ref", "input", "rad", "reference of the angles, now and at the samples to come",
            np.tile(theta, samples).tolist(),
        ),
        Variable(
            "K_ref", "input", "N.m/rad", f"{of_K}, now and at the samples to come", np.tile(entries, samples).tolist()
        ),
        *(Variable(f"u{i}", "output", "Pa", f"command for {name}") for i, name in muscles),
        Variable("status", "output", None, "of the plan, as PlanStatus"),
        Variable("rung", "output", None, "of the plan, as Rung"),
    ]  # fmt: skip


def _labels(plant: Machine) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
    """Return suffixes and names of the joints and of the muscles."""
    joints, muscles = (list(enumerate(names, 1)) for names in names_of(plant))
    suffixes = [""] if isinstance(plant, Plant) else [str(i) for i, _ in joints]
    return [(i, name) for i, (_, name) in zip(suffixes, joints, strict=True)], [(str(j), name) for j, name in muscles]


def variables_header(variables: Sequence[Variable], dt: float, token: str) -> str:
    """Return unit_variables.h."""
    lines = [
        f'#define UNIT_TOKEN "{token}"',
        f"#define UNIT_DT {number(dt, single=False)} /* sample time [s] */",
        f"#define UNIT_VARIABLES {len(variables)}",
        f"#define UNIT_VALUES {sum(len(variable.starts) for variable in variables)}",
        "enum {",
        *(f"    UNIT_{v.name.upper()} = {first}, /* [{v.unit or '-'}] {v.about} */" for v, first in _placed(variables)),
        "};",
        "#define UNIT_STARTS {" + ", ".join(number(x, single=False) for v in variables for x in v.starts) + "}",
        "#define UNIT_TABLE {" + ", ".join(_row(v, first) for v, first in _placed(variables)) + "}",
    ]
    return text.header(
        "ANT_UNIT_VARIABLES_H", "The variables of this FMU, as in modelDescription.xml.", "\n".join(lines)
    )


def _placed(variables: Sequence[Variable]) -> Iterator[tuple[Variable, int]]:
    """Yield the variables and the positions of their first values."""
    first = 0
    for variable in variables:
        yield variable, first
        first += len(variable.starts)


def _row(variable: Variable, first: int) -> str:
    whole, count = int(variable.unit is None), len(variable.starts)
    return f"{{{whole}, {first}, {count}, {_SET[variable.causality]}, {int(variable.finite)}}}"


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
