"""`./spool export --fmu`: Functional Mock-up Unit (FMI 2.0 or 3.0, Co-Simulation) of a model with its values.

The archive holds the description, a shared library for this machine, and its C sources for others. Neither
needs Python.
"""

from __future__ import annotations

import hashlib
import io
import os
import re
import shlex
import shutil
import subprocess
import sysconfig
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from spool_core.errors import InputError
from spool_core.system import expanded
from spool_report.outputs import check_output, write_file
from spool_sim.integration.composed_motion import substeps_for
from spool_sim.integration.composition import unique_parameters
from spool_sim.lubrication import STEP, OilTable
from spool_sim.model import MODELS, Model, load_model
from spool_sim.terms import Parameter, Term
from spool_sim.valve import (
    HIGHEST_TEMPERATURE,
    LOWEST_TEMPERATURE,
    Valve,
    find_valve,
    read_mapping,
    shipped_valves,
)

from spool_design.c_source import model_source

VERSIONS = (2, 3)
#: Model of a valve where none is named: that of ``simulate``.
DEFAULT_MODEL = "coulomb"
#: A line that ``save_model`` writes: name, value, unit, and what is known about the value.
_NOTED = re.compile(r"  (\w+): \S+  # [^,]+, (.+)")
#: Internal steps in one that the stiffest rate allows: the error of the motion falls by 4^4, below 1e-8 where
#: nothing bends sharply, and parameters may become 100 times stiffer.
FINER = 4
#: s, of which the internal step is a fraction: the sample period of a usual record, 2 kHz.
LONGEST_STEP = 5e-4
#: Attribute of a valve that follows from the oil's viscosity.
_DRAG = "likely_viscous_coefficient"
_OPTIONS = ("-std=c99", "-O2", "-fPIC", "-shared", "-ffp-contract=off", "-fvisibility=hidden")
#: s, which the compiler may take.
_PATIENCE = 300.0
#: System and processor as ``sysconfig`` names them: folder of the binary by version, its ending.
_PLATFORMS = (
    (r"linux-x86_64", {2: "linux64", 3: "x86_64-linux"}, ".so"),
    (r"linux-aarch64", {2: "linux64", 3: "aarch64-linux"}, ".so"),
    (r"macosx-.*x86_64", {2: "darwin64", 3: "x86_64-darwin"}, ".dylib"),
    (r"macosx-.*(arm64|universal2)", {2: "darwin64", 3: "aarch64-darwin"}, ".dylib"),
    (r"win-amd64|mingw.*", {2: "win64", 3: "x86_64-windows"}, ".dll"),
)
#: Exponents of kg, m, s of what the units of parameters are made of.
_BASE = {
    "1": (0, 0, 0), "kg": (1, 0, 0), "m": (0, 1, 0), "s": (0, 0, 1),
    "N": (1, 1, -2), "Pa": (1, -1, -2), "Hz": (0, 0, -1), "rad": (0, 0, 0),
}  # fmt: skip
CELSIUS = "degC"


@dataclass(frozen=True, slots=True)
class Variable:
    """Variable of the unit, as both versions of the description write it."""

    name: str
    reference: int
    causality: str
    unit: str
    description: str
    start: float | None = None
    low: float | None = None
    high: float | None = None


def export_fmu(source: str, out: Path, model: str | None = None, fmi: int = 3) -> str:
    """Write the FMU ``out`` and return what it holds, in a line.

    Args:
        source: valve (name or YAML file), or model (YAML file) that states all values.
        out: file to write.
        model: of a valve, name or YAML file; default: ``DEFAULT_MODEL``.
        fmi: version of the standard, 2 or 3.

    Raises:
        InputError: valve or model cannot be used, the file exists, or no C compiler works here.
    """
    if out.suffix != ".fmu":
        raise InputError(f"--fmu {out}: an FMU is a file .fmu: change the ending")
    check_output(out, "--fmu")
    valve: Valve | None = None
    if source not in shipped_valves() and (
        source in MODELS or (expanded(source).is_file() and "terms" in read_mapping(source, "valve"))
    ):
        if model is not None:
            raise InputError(f"--model {model}: {source} is a model itself: name a valve in its place")
        acting = source
    else:
        valve, acting = find_valve(source), model or DEFAULT_MODEL
    found = load_model(acting)
    write_file(out, fmu_content(found, valve, fmi, _notes(found, acting)), "--fmu")
    named = found.name if valve is None else f"{valve.id} with the model {found.name}"
    missing = "; no input oil_temperature, as no oil is named"
    oil = "" if valve is not None and valve.oil_ratio_known else missing
    return f"{out}: FMI {fmi}.0 Co-Simulation of {named}, {len(found.parameters)} parameters{oil}"


def _notes(model: Model, path: str) -> dict[str, str]:
    """Return what a model file notes about the values, by parameter: the 95 % interval, or held."""
    if path in MODELS:
        return {}
    lines = expanded(path).read_text(encoding="utf-8").splitlines()
    noted = {match[1]: match[2] for match in map(_NOTED.fullmatch, lines) if match is not None}
    return {one.name: noted[one.name] for one in model.parameters if one.name in noted}


def fmu_content(model: Model, valve: Valve | None, fmi: int, notes: Mapping[str, str]) -> bytes:
    """Return the file of an FMU; see docs/fmu.md for its variables.

    Args:
        model: its terms and values.
        valve: gives the name, the values that the model does not state and, where it names its oil, the drag
            over the oil's temperature.
        fmi: version of the standard, 2 or 3.
        notes: by parameter, what is known about its value, for the description.

    Raises:
        InputError: values are missing without a valve, unknown version, a law that has no translation to C,
            or no compiler.
    """
    if valve is None:
        missing = [
            one.name for one in model.parameters if one.valve_attribute and one.name not in model.values
        ]
        if missing:
            raise InputError(
                f"model '{model.name}': {', '.join(missing)}: not stated; export a valve with this model: "
                f"./spool export VALVE --model MODEL --fmu FILE.fmu"
            )
        values = {one.name: float(model.values.get(one.name, one.start)) for one in model.parameters}
    else:
        values = model.true_values_for(valve)
    if fmi not in VERSIONS:
        raise InputError(f"--fmi {fmi}: use 2 or 3")
    oil = valve if valve is not None and valve.oil_ratio_known else None
    variables = _variables(model.terms, values, oil, notes)
    name = f"{valve.id}, {model.name}" if valve is not None else model.name
    identifier = re.sub(r"\W", "_", f"valve_{name}", flags=re.ASCII)[:80]
    source = _model_header(model.terms, variables, oil)
    token = hashlib.sha256(f"{source}{variables}".encode()).hexdigest()[:32]
    folder = Path(__file__).parent / "sources"
    main = f"fmi{fmi}.c"
    files: dict[str, str | bytes] = {
        "sources/model.h": f'#define TOKEN "{token}"\n{source}',
        **{f"sources/{one}": (folder / one).read_text(encoding="utf-8") for one in ("unit.h", main)},
        "modelDescription.xml": _description(fmi, name, identifier, token, variables),
    }
    if fmi == 3:
        root = ElementTree.Element("fmiBuildDescription", fmiVersion="3.0")
        configuration = ElementTree.SubElement(root, "BuildConfiguration", modelIdentifier=identifier)
        options = {"language": "C99", "compilerOptions": "-O2 -ffp-contract=off"}
        sources = ElementTree.SubElement(configuration, "SourceFileSet", options)
        ElementTree.SubElement(sources, "SourceFile", name="fmi3.c")
        files["sources/buildDescription.xml"] = _xml(root)
    files |= _compiled(files, main, identifier, fmi)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for path, content in files.items():
            # The time is fixed: the same model gives the same file.
            archive.writestr(zipfile.ZipInfo(path, (2020, 1, 1, 0, 0, 0)), content, zipfile.ZIP_DEFLATED)
    return stream.getvalue()


def _variables(
    terms: Sequence[Term], values: Mapping[str, float], oil: Valve | None, notes: Mapping[str, str]
) -> list[Variable]:
    """Return all variables; the references are those of ``sources/unit.h``."""
    step = LONGEST_STEP / (FINER * substeps_for(terms, values, LONGEST_STEP))
    found = [
        Variable("body_acceleration", 1, "input", "m/s^2", "acceleration of the valve body", 0.0, -1e6, 1e6)
    ]
    if oil is not None:
        found.append(
            Variable(
                "oil_temperature", 2, "input", CELSIUS, f"temperature of the oil, {oil.oil}; sets the drag",
                oil.oil_temperature, -60.0, 250.0,
            )
        )  # fmt: skip
    outputs = (
        ("spool_position", "m", "displacement of the spool relative to the body"),
        ("spool_velocity", "m/s", "velocity of the spool relative to the body"),
        ("spool_acceleration", "m/s^2", "acceleration of the spool relative to the body"),
        ("spool_acceleration_absolute", "m/s^2", "acceleration of the spool itself"),
        (
            "friction_force",
            "N",
            "dry friction, friction with memory and drag; positive against positive velocity",
        ),
        ("sticking", "", "friction holds the spool on the body"),
    )
    found += [
        Variable(name, 10 + place, "output", unit, text) for place, (name, unit, text) in enumerate(outputs)
    ]
    found.append(
        Variable("internal_step", 20, "parameter", "s", "longest step of the integration", step, 1e-8, 1e-2)
    )
    for place, one in enumerate(unique_parameters(terms)):
        said = [one.meaning, notes.get(one.name, "")]
        if oil is not None and one.valve_attribute == _DRAG:
            said.append(f"with the oil at {oil.oil_temperature:g} deg C")
        text = "; ".join(filter(None, said))
        start = float(values[one.name])
        found.append(Variable(one.name, 100 + place, "parameter", one.unit, text, start, one.low, one.high))
    return found


def _model_header(terms: Sequence[Term], variables: Sequence[Variable], oil: Valve | None) -> str:
    """Return ``model.h``: laws and step in C, and the tables of numbers."""
    rows, parameters = {one.name: one for one in variables}, unique_parameters(terms)

    def row(one: Parameter) -> str:
        variable, viscous = rows[one.name], int(oil is not None and one.valve_attribute == _DRAG)
        return f'    {{"{one.name}", {variable.start!r}, {one.low!r}, {one.high!r}, {viscous}}},'

    ratios: list[float] = []
    if oil is not None:
        count = round((HIGHEST_TEMPERATURE - LOWEST_TEMPERATURE) / STEP) + 1
        points = np.asarray(np.linspace(LOWEST_TEMPERATURE, HIGHEST_TEMPERATURE, count), dtype=np.float64)
        ratios = OilTable(oil).ratio(points).tolist()
    lines = [
        "/* Laws and time step of one model, translated from Python, and its numbers (SI units, deg C). */",
        model_source(terms),
        f"#define PARAMETER_COUNT {len(parameters)}",
        f"#define INTERNAL_STEP_START {rows['internal_step'].start!r}",
        f"#define OIL_START {float(oil.oil_temperature) if oil is not None else 0.0!r}",
        f"#define OIL_LOWEST {LOWEST_TEMPERATURE!r}",
        f"#define OIL_STEP {STEP!r}",
        f"#define OIL_POINTS {len(ratios)}",
        "typedef struct { const char *name; double start, low, high; int viscous; } spool_parameter;",
        "static const spool_parameter parameters[PARAMETER_COUNT] = {",
        *map(row, parameters),
        "};",
    ]
    if ratios:
        numbers = [repr(ratio) for ratio in ratios]
        table = ",\n".join(", ".join(numbers[first : first + 6]) for first in range(0, len(numbers), 6))
        lines.append(f"static const double oil_ratios[OIL_POINTS] = {{\n{table}\n}};")
    return "\n".join(lines) + "\n"


def _description(fmi: int, name: str, identifier: str, token: str, variables: Sequence[Variable]) -> str:
    """Return ``modelDescription.xml``."""
    newer = fmi == 3
    head = {
        "fmiVersion": f"{fmi}.0",
        "modelName": name,
        "description": "Spool of a hydraulic valve whose body vibrates",
        "generationTool": "spool suite",
        "variableNamingConvention": "flat",
        "instantiationToken" if newer else "guid": token,
    }
    root = ElementTree.Element("fmiModelDescription", head)
    abilities = {"modelIdentifier": identifier, "canHandleVariableCommunicationStepSize": "true"}
    if newer:
        abilities |= {"canGetAndSetFMUState": "true", "canSerializeFMUState": "true"}
        abilities |= {"providesIntermediateUpdate": "true"}
    else:
        abilities |= {"canGetAndSetFMUstate": "true", "canSerializeFMUstate": "true"}
        abilities |= {"canInterpolateInputs": "true", "canNotUseMemoryManagementFunctions": "true"}
    slave = ElementTree.SubElement(root, "CoSimulation", abilities)
    if not newer:
        files = ElementTree.SubElement(slave, "SourceFiles")
        ElementTree.SubElement(files, "File", name="fmi2.c")
    units = ElementTree.SubElement(root, "UnitDefinitions")
    for unit in sorted({one.unit for one in variables} - {""} | {"s"}):
        _add_unit(units, unit)
    categories = ElementTree.SubElement(root, "LogCategories")
    for category in ("logStatusError", "logStatusWarning"):
        ElementTree.SubElement(categories, "Category", name=category)
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0", stopTime="10", stepSize="0.0001")
    listed = ElementTree.SubElement(root, "ModelVariables")
    if newer:
        time = {
            "name": "time",
            "valueReference": "0",
            "causality": "independent",
            "variability": "continuous",
        }
        ElementTree.SubElement(listed, "Float64", time, unit="s", description="time")
    structure = ElementTree.SubElement(root, "ModelStructure")
    outputs = structure if newer else ElementTree.SubElement(structure, "Outputs")
    unknowns = []
    for index, one in enumerate(variables, 1):
        _add_variable(listed, one, newer=newer)
        if one.causality == "output":
            key = {"valueReference": str(one.reference)} if newer else {"index": str(index)}
            # Where the spool is and how fast does not jump with the input.
            follows = {"dependencies": ""} if one.name in ("spool_position", "spool_velocity") else {}
            ElementTree.SubElement(outputs, "Output" if newer else "Unknown", key | follows)
            unknowns.append(key)
    initial = structure if newer else ElementTree.SubElement(structure, "InitialUnknowns")
    for key in unknowns:
        ElementTree.SubElement(initial, "InitialUnknown" if newer else "Unknown", key)
    return _xml(root)


def _add_variable(listed: ElementTree.Element, one: Variable, *, newer: bool) -> None:
    truth = one.name == "sticking"
    variability = "tunable" if one.causality == "parameter" else "discrete" if truth else "continuous"
    shared = {
        "name": one.name,
        "valueReference": str(one.reference),
        "description": one.description,
        "causality": one.causality,
        "variability": variability,
    }
    if one.causality == "output":
        shared["initial"] = "calculated"
    typed = {} if truth else {"unit": one.unit}
    given = (("min", one.low), ("max", one.high), ("start", one.start))
    typed |= {key: repr(float(value)) for key, value in given if value is not None}
    if not newer:
        variable = ElementTree.SubElement(listed, "ScalarVariable", shared)
        ElementTree.SubElement(variable, "Boolean" if truth else "Real", typed)
        return
    if one.name == "body_acceleration":
        shared["intermediateUpdate"] = "true"
    ElementTree.SubElement(listed, "Boolean" if truth else "Float64", shared | typed)


def _add_unit(units: ElementTree.Element, name: str) -> None:
    unit = ElementTree.SubElement(units, "Unit", name=name)
    if name == CELSIUS:
        ElementTree.SubElement(unit, "BaseUnit", K="1", offset="273.15")
        return
    exponents = [0, 0, 0]
    for sign, part in zip((1, -1), name.partition("/")[::2], strict=True):
        for factor in part.split():
            base, _, power = factor.partition("^")
            if base not in _BASE:
                return  # a root of units, for which FMI has no exponents
            for place, exponent in enumerate(_BASE[base]):
                exponents[place] += sign * exponent * int(power or 1)
    powers = {key: str(power) for key, power in zip(("kg", "m", "s"), exponents, strict=True) if power}
    ElementTree.SubElement(unit, "BaseUnit", powers | ({"rad": "1"} if name == "rad" else {}))


def _xml(root: ElementTree.Element) -> str:
    ElementTree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _compiled(files: Mapping[str, str | bytes], main: str, identifier: str, fmi: int) -> dict[str, bytes]:
    """Return place and content of the shared library for this machine.

    Raises:
        InputError: no compiler, one that fails, or a machine for which FMI has no name.
    """
    here = sysconfig.get_platform()
    known = next((one for one in _PLATFORMS if re.fullmatch(one[0], here)), None)
    if known is None:
        raise InputError(
            f"--fmu: FMI has no name for a machine of the kind '{here}': export on x86-64 or ARM"
        )
    named = shlex.split(os.environ.get("CC", ""))
    compiler = named or next(([one] for one in ("cc", "gcc", "clang") if shutil.which(one)), [])
    if not compiler:
        raise InputError("--fmu: an FMU holds a compiled library: install a C compiler, e.g. the package gcc")
    with tempfile.TemporaryDirectory(prefix="spool_fmu_") as folder:
        for path, content in files.items():
            if isinstance(content, str):
                (Path(folder) / Path(path).name).write_text(content, encoding="utf-8")
        target = Path(folder) / f"{identifier}{known[2]}"
        command = [*compiler, *_OPTIONS, main, "-o", target.name, "-lm"]
        try:
            done = subprocess.run(
                command, cwd=folder, capture_output=True, text=True, timeout=_PATIENCE, check=False
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise InputError(f"--fmu: the C compiler '{compiler[0]}' does not run: {error}") from None
        if done.returncode != 0:
            said = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr)
            raise InputError(f"--fmu: the C compiler '{compiler[0]}' failed: {said[:200]}")
        return {f"binaries/{known[1][fmi]}/{target.name}": target.read_bytes()}
