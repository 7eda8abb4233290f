"""The descriptions in an FMU are written here: modelDescription.xml and buildDescription.xml of FMI 3.0."""

from collections.abc import Iterable, Sequence
from importlib import metadata
from typing import NamedTuple
from xml.etree import ElementTree

from mpc.export.fmu.variables import UNITS, Variable

_TIME = "0"  # the reference of the time; the variables are counted from 1 on


class Model(NamedTuple):
    """A model is what an FMU says of itself."""

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
