"""Files of a field case: the record as it is stored, its valve as it is described, and the truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from spool_blind.writing import valve_text, write_record

from .case import FieldCase

RECORD, VALVE, TRUTH = "record.csv.gz", "valve.yaml", "truth.json"


def field_truth_of(case: FieldCase) -> dict[str, Any]:
    """Return what is true of a field case, for JSON, SI units."""
    condition = case.condition
    return {
        "seed": case.seed,
        "window": case.window,
        "kind": case.kind,
        "hidden": case.hidden,
        "accepted": list(case.accepted),
        "factor": case.factor,
        "effects": {name: dict(values) for name, values in case.truth.items()},
        "importance": {
            name: {
                "with_without": one.with_without,
                "share": one.share,
                "evidence": one.evidence,
                "threshold": one.threshold,
                "matters": one.matters,
            }
            for name, one in case.importance.items()
        },
        "nuisances": [
            {"id": one.id, "channel": one.channel, "size": one.size, "unit": one.unit}
            for one in case.nuisances
        ],
        "plant": dict(case.plant),
        "drive": condition.excitation.kind,
        "amplitude_m_s2": condition.amplitude,
        "band_Hz": [condition.excitation.low, condition.excitation.high],
        "sample_rate_Hz": condition.sample_rate,
        "duration_s": condition.duration,
        "nominal_stiffness_N_m": condition.nominal_stiffness,
        "noise_m_s2": dict(case.chain.noise),
        "gain": case.chain.gain,
        "delay_s": case.chain.delay,
    }


def write_field(case: FieldCase, folder: Path) -> tuple[Path, Path]:
    """Write ``record.csv.gz``, ``valve.yaml`` and ``truth.json`` into ``folder``; return the first two."""
    folder.mkdir(parents=True, exist_ok=True)
    write_record(folder / RECORD, case.time, case.body, case.spool)
    (folder / VALVE).write_text(valve_text(case))
    (folder / TRUTH).write_text(json.dumps(field_truth_of(case), indent=1))
    return folder / RECORD, folder / VALVE
