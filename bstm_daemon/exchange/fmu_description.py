"""The ``modelDescription.xml`` of an exported model, FMI 2.0 and 3.0."""

from collections.abc import Sequence
from math import isnan
from typing import Final
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from bstm_daemon import __version__
from bstm_daemon.estimator.estimator import STEP_US
from bstm_daemon.exchange.fmu_model import FmuModel, Variable

BASE_UNITS: Final = {
    "K": {"K": 1},
    "s": {"s": 1},
    "m": {"m": 1},
    "kg": {"kg": 1},
    "rad": {"rad": 1},
    "m/s": {"m": 1, "s": -1},
    "m/s2": {"m": 1, "s": -2},
    "rad/s": {"rad": 1, "s": -1},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "N": {"kg": 1, "m": 1, "s": -2},
    "N.m": {"kg": 1, "m": 2, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
    "J/K": {"kg": 1, "m": 2, "s": -2, "K": -1},
    "W/K": {"kg": 1, "m": 2, "s": -3, "K": -1},
    "m2K/W": {"kg": -1, "s": 3, "K": 1},
    "Ws/(m K)": {"kg": 1, "m": 1, "s": -2, "K": -1},
    "Ws/(m3 K)": {"kg": 1, "m": -1, "s": -2, "K": -1},
    "W/(m2 K)": {"kg": 1, "s": -3, "K": -1},
    "1": {},
}
"""Exponents of the base units, by unit."""

CATEGORIES: Final = ("logStatusWarning", "logStatusError")


def description(
    model: FmuModel, token: str, fmi: int, sources: Sequence[str]
) -> bytes:
    """Return the description of *model*.

    Args:
        model: the exported model.
        token: by which an importer and the binary know each other.
        fmi: 2 or 3.
        sources: names of the C files to compile.
    """
    root = Element(
        "fmiModelDescription",
        fmiVersion=f"{fmi}.0",
        modelName=model.name,
        description=f"{model.text}; an estimate, not a safety function",
        generationTool=f"bstm_daemon {__version__}",
        variableNamingConvention="flat",
    )
    root.set("guid" if fmi == 2 else "instantiationToken", token)
    state = "FMUstate" if fmi == 2 else "FMUState"
    kind = SubElement(
        root,
        "CoSimulation",
        {
            "modelIdentifier": model.name,
            "canHandleVariableCommunicationStepSize": "true",
            f"canGetAndSet{state}": "true",
            f"canSerialize{state}": "true",
        },
    )
    if fmi == 2:
        files = SubElement(kind, "SourceFiles")
        for name in sources:
            SubElement(files, "File", name=name)
    else:
        kind.set("fixedInternalStepSize", _number(STEP_US * 1e-6))
    _units(root, {one.unit for one in model.variables} | {"s"})
    categories = SubElement(root, "LogCategories")
    for name in CATEGORIES:
        SubElement(categories, "Category", name=name)
    SubElement(root, "DefaultExperiment", stepSize=_number(STEP_US * 1e-6))
    variables = SubElement(root, "ModelVariables")
    if fmi == 3:
        time = {"name": "time", "valueReference": "0"}
        time |= {"causality": "independent", "variability": "continuous"}
        SubElement(variables, "Float64", time | {"unit": "s"})
    for reference, one in enumerate(model.variables, start=1):
        _variable(variables, reference, one, fmi)
    _structure(root, model, fmi)
    return _written(root)


def build_description(identifier: str, sources: Sequence[str]) -> bytes:
    """Return the ``buildDescription.xml`` of FMI 3.0."""
    root = Element("fmiBuildDescription", fmiVersion="3.0")
    kind = SubElement(root, "BuildConfiguration", modelIdentifier=identifier)
    files = SubElement(
        kind,
        "SourceFileSet",
        language="C99",
        compilerOptions="-O3 -ffp-contract=off",
    )
    for name in sources:
        SubElement(files, "SourceFile", name=name)
    return _written(root)


def _structure(root: Element, model: FmuModel, fmi: int) -> None:
    outputs = [
        reference
        for reference, one in enumerate(model.variables, start=1)
        if one.causality == "output"
    ]
    unknown = [r for r in outputs if model.variables[r - 1].start is None]
    structure = SubElement(root, "ModelStructure")
    for tag, found in (("Output", outputs), ("InitialUnknown", unknown)):
        part = structure if fmi == 3 else SubElement(structure, f"{tag}s")
        for reference in map(str, found):
            if fmi == 3:
                SubElement(part, tag, valueReference=reference)
            else:
                # FMI 2 counts variables from 1 in the order of the file
                SubElement(part, "Unknown", index=reference)


def _variable(
    variables: Element, reference: int, one: Variable, fmi: int
) -> None:
    of = {
        "name": one.name,
        "valueReference": str(reference),
        "causality": one.causality,
        "variability": "continuous",
        "description": one.description,
    }
    if one.causality == "parameter":
        of["variability"] = "tunable"
    if one.causality != "input":
        of["initial"] = "calculated" if one.start is None else "exact"
    number = {"unit": one.unit}
    if one.bounds is not None:
        lower, upper = one.bounds
        number |= {"min": _number(lower), "max": _number(upper)}
    if one.start is not None:
        number["start"] = _number(one.start)
    if fmi == 3:
        SubElement(variables, "Float64", of | number)
    else:
        SubElement(SubElement(variables, "ScalarVariable", of), "Real", number)


def _units(root: Element, used: set[str]) -> None:
    units = SubElement(root, "UnitDefinitions")
    for name in sorted(used):
        unit = SubElement(units, "Unit", name=name)
        exponents = BASE_UNITS[name]
        SubElement(unit, "BaseUnit", {k: str(n) for k, n in exponents.items()})
        if name == "K":
            # T in degC is T in K less 273.15
            SubElement(unit, "DisplayUnit", name="degC", offset="-273.15")


def _number(value: float) -> str:
    return "NaN" if isnan(value) else repr(float(value))


def _written(root: Element) -> bytes:
    indent(root)
    text = tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()
