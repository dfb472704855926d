"""Files of a blind case: the record, the valve that is said to have made it, and the truth."""

from __future__ import annotations

import gzip
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .case import BlindCase
from .condition import ExperimentCondition

Array = NDArray[np.float64]

#: m, of the valve's lands; the oil is said to be what its description says, not what is in it.
LAND_DIAMETER, LAND_LENGTH, RADIAL_CLEARANCE, VISCOSITY = 0.020, 0.032, 15.0e-6, 0.0612
SPOOL_SHARE = 0.172 / 0.18


class DescribedCase(Protocol):
    """Case of any family, as far as its valve's description needs it."""

    @property
    def plant(self) -> Mapping[str, float]:
        """Numbers of the plant."""

    @property
    def condition(self) -> ExperimentCondition:
        """Condition of the experiment."""


def valve_text(case: DescribedCase) -> str:
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


def truth_of(case: BlindCase) -> dict[str, Any]:
    """Return what is true of the case, for JSON, SI units."""
    condition, seen = case.condition, case.visibility
    return {
        "seed": case.seed,
        "kind": case.kind,
        "hidden": case.hidden,
        "accepted": list(case.accepted),
        "factor": case.factor,
        "effects": {name: dict(values) for name, values in case.truth.items()},
        "plant": dict(case.plant),
        "channels": {name: getattr(case.channels, name) for name in type(case.channels).__slots__},
        "drive": condition.excitation.kind,
        "amplitude_m_s2": condition.amplitude,
        "levels": list(condition.excitation.levels),
        "band_Hz": [condition.excitation.low, condition.excitation.high],
        "sample_rate_Hz": condition.sample_rate,
        "duration_s": condition.duration,
        "nominal_stiffness_N_m": condition.nominal_stiffness,
        "noise_share": condition.noise_share,
        "visible": None
        if seen is None
        else {
            "nrmse": seen.nrmse,
            "noise_nrmse": seen.noise_nrmse,
            "evidence": seen.evidence,
            "threshold": case.threshold,
        },
    }


def write(case: BlindCase, folder: Path) -> Path:
    """Write ``record.csv.gz``, ``valve.yaml`` and ``truth.json`` into ``folder``; return the record."""
    folder.mkdir(parents=True, exist_ok=True)
    record = folder / "record.csv.gz"
    write_record(record, case.time, case.body, case.spool)
    (folder / "valve.yaml").write_text(valve_text(case))
    (folder / "truth.json").write_text(json.dumps(truth_of(case), indent=1))
    return record


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
        path.write_text(text)
