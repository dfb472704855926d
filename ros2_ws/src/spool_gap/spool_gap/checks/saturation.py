"""Saturation: which samples of the channels clip, and the records with their tops restored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from spool_identification.record import Record
from spool_identification.signals.clipping import at_rail, restored

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Saturation:
    """What was found.

    Attributes:
        kept: weight 0 or 1 of each sample of each record.
        repaired: records with the clipped tops restored, for the integration; those are never compared.
        limit: m/s^2, NaN where nothing clips.
        channel: ``body``, ``spool`` or nothing.
        share: of the samples.
        warnings: one line each.
    """

    kept: list[Array]
    repaired: list[Record]
    limit: float
    channel: str
    share: float
    warnings: list[str]


def find_saturation(records: Sequence[Record]) -> Saturation:
    """Return which samples of ``records`` sit at a rail."""
    kept: list[Array] = [np.ones(record.body.size) for record in records]
    repaired = list(records)
    limit, channel, share = np.nan, "", 0.0
    warnings = []
    for name in ("spool", "body"):
        for number, record in enumerate(records):
            row = getattr(record, name)
            rail = at_rail(row)
            if rail is None:
                continue
            own = float(np.median(np.abs(row[rail])))
            limit, channel, share = own, name, max(share, float(rail.mean()))
            wide = np.convolve(rail.astype(float), np.ones(3), mode="same") > 0.0
            kept[number] = kept[number] * (~wide)
            whole = restored(row, wide)
            own_record = repaired[number]
            repaired[number] = (
                replace(own_record, spool=whole) if name == "spool" else replace(own_record, body=whole)
            )
        if channel == name:
            warnings.append(f"{name} clips at {limit:.4g} m/s^2 in {100.0 * share:.2g} % of the samples")
    return Saturation(kept, repaired, limit, channel, share, warnings)
