"""Files of a case: record, description of the valve, and truth."""

from __future__ import annotations

import gzip
import json
import math
from pathlib import Path

from spool_blind.field.case import Array, FieldCase
from spool_blind.hidden import SPOOL_SHARE

RECORD, VALVE, TRUTH = "record.csv.gz", "valve.yaml", "truth.json"
#: m, of the valve's lands; the description names the nominal oil, which may not be the oil in the valve.
LAND_DIAMETER, LAND_LENGTH, RADIAL_CLEARANCE, VISCOSITY = 0.020, 0.032, 15.0e-6, 0.0612


def valve_text(case: FieldCase) -> str:
    """Return the valve's description, YAML: its mass is true, its spring is the maker's number."""
    mass = case.plant["mass"]
    return (
        "id: blind_valve\n"
        f"moving_mass: {mass!r}\nspool_mass: {SPOOL_SHARE * mass!r}\n"
        f"spring_stiffness: {case.condition.nominal_stiffness!r}\n"
        f"land_diameter: {LAND_DIAMETER}\nland_length: {LAND_LENGTH}\n"
        f"radial_clearance: {RADIAL_CLEARANCE:.7f}\ndynamic_viscosity: {VISCOSITY}\n"
        "oil: HL68\noil_temperature: 20.0\n"
    )


def write(case: FieldCase, folder: Path) -> tuple[Path, Path]:
    """Write ``record.csv.gz``, ``valve.yaml`` and ``truth.json`` into ``folder``; return the first two."""
    folder.mkdir(parents=True, exist_ok=True)
    write_record(folder / RECORD, case.time, case.body, case.spool)
    (folder / VALVE).write_text(valve_text(case), "utf-8")
    (folder / TRUTH).write_text(json.dumps(case.told(), indent=1), "utf-8")
    return folder / RECORD, folder / VALVE


def write_record(path: Path, time: Array, body: Array, spool: Array) -> None:
    """Write a record of two accelerometers as CSV, gzipped where the name says so; NaN is an empty cell."""
    lines = ["time_s,body_m_s2,spool_m_s2\n"]
    for row in zip(time.tolist(), body.tolist(), spool.tolist(), strict=True):
        cells = [f"{row[0]:.9g}"] + ["" if math.isnan(value) else f"{value:.7g}" for value in row[1:]]
        lines.append(",".join(cells) + "\n")
    text = "".join(lines)
    if path.suffix == ".gz":
        with gzip.open(path, "wt", compresslevel=1) as file:
            file.write(text)
    else:
        path.write_text(text, "utf-8")
