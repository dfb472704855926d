"""`./spool export --fmu`: a valve, or a model that states all its values, as a Functional Mock-up Unit."""

from __future__ import annotations

import re
from pathlib import Path

from spool_core.errors import InputError
from spool_core.system import expanded
from spool_report.outputs import check_output, write_file
from spool_sim.model import MODELS, Model, load_model
from spool_sim.valve import Valve, find_valve, read_mapping, shipped_valves

#: Model of a valve where none is named: that of ``simulate``.
DEFAULT_MODEL = "coulomb"
#: A line that ``save_model`` writes: name, value, unit, and what is known about the value.
_NOTED = re.compile(r"  (\w+): \S+  # [^,]+, (.+)")


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
    write_file(out, found.to_fmu(valve, fmi=fmi, notes=_notes(found, acting)), "--fmu")
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
