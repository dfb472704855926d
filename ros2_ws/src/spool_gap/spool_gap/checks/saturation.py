"""Saturation: which samples of the channels clip, and the records with their tops restored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from spool_estimator.identification.channel_faults import at_rail, restored
from spool_estimator.identification.record import Record

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Saturation:
    """What was found.

    Attributes:
        kept: weight 0 or 1 of each sample of each record.
        repaired: records with the clipped tops restored, for the integration; those are never compared.
        limits: m/s^2, of each channel that clips, by its name.
        warnings: one line each.
    """

    kept: list[Array]
    repaired: list[Record]
    limits: Mapping[str, float]
    warnings: list[str]


def find_saturation(records: Sequence[Record]) -> Saturation:
    """Return which samples of ``records`` sit at a rail."""
    kept: list[Array] = [np.ones(record.body.size) for record in records]
    repaired = list(records)
    limits: dict[str, float] = {}
    warnings = []
    for name in ("spool", "body"):
        share = 0.0
        for number, record in enumerate(records):
            row = getattr(record, name)
            rail = at_rail(row)
            if rail is None:
                continue
            limits[name] = float(np.median(np.abs(row[rail])))
            share = max(share, float(rail.mean()))
            wide = np.convolve(rail.astype(float), np.ones(3), mode="same") > 0.0
            kept[number] = kept[number] * (~wide)
            whole = restored(row, wide)
            own_record = repaired[number]
            repaired[number] = (
                replace(own_record, spool=whole) if name == "spool" else replace(own_record, body=whole)
            )
        if name in limits:
            warnings.append(
                f"{name} clips at {limits[name]:.4g} m/s^2 in {100.0 * share:.2g} % of the samples"
            )
    return Saturation(kept, repaired, limits, warnings)
