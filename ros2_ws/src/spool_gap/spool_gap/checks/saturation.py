"""Channels that clip: readings pile up at a rail."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from spool_identification.record import Record

Array = NDArray[np.float64]

#: Samples at a rail from which a channel clips, and how many times as many as at levels below it.
COUNT, PILED = 12, 10.0
#: Levels below: those of a sine read by a coarse converter are filled up to five times less than its top.
BELOW = 12


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
            at_rail = clipped(row)
            if at_rail is None:
                continue
            own = float(np.median(np.abs(row[at_rail])))
            limit, channel, share = own, name, max(share, float(at_rail.mean()))
            wide = np.convolve(at_rail.astype(float), np.ones(3), mode="same") > 0.0
            kept[number] = kept[number] * (~wide)
            whole = restored(row, wide)
            own_record = repaired[number]
            repaired[number] = (
                replace(own_record, spool=whole) if name == "spool" else replace(own_record, body=whole)
            )
        if channel == name:
            warnings.append(f"{name} clips at {limit:.4g} m/s^2 in {100.0 * share:.2g} % of the samples")
    return Saturation(kept, repaired, limit, channel, share, warnings)


def clipped(row: Array) -> NDArray[np.bool_] | None:
    """Return which samples sit at a rail: equal to the extreme, often, and in runs; ``None`` for none."""
    found = np.zeros(row.size, dtype=np.bool_)
    for side in (1.0, -1.0):
        values = side * row
        top = float(values.max())
        at_top = values >= top - 1e-6 * abs(top)
        count = int(np.count_nonzero(at_top))
        if top > 0.0 and count >= max(COUNT, PILED * _usual_count(values[~at_top])) and _in_runs(at_top):
            found |= at_top
    return found if found.any() else None


def _usual_count(values: Array) -> float:
    """Return how many of ``values`` share one of their highest levels."""
    some = values[values > np.quantile(values, 0.9)]
    _, counts = np.unique(some, return_counts=True)
    return float(counts[-BELOW:].mean()) if counts.size else 0.0


def _in_runs(pile: NDArray[np.bool_]) -> bool:
    beside = pile[1:] & pile[:-1]
    return float(np.count_nonzero(beside)) > 0.25 * float(np.count_nonzero(pile))


def restored(row: Array, gone: NDArray[np.bool_], rounds: int = 60) -> Array:
    """Return ``row`` with the samples ``gone`` filled by the band below a tenth of the sample rate.

    Papoulis and Gerchberg: the band-limited part of the whole replaces the gaps, again and again.
    """
    places = np.arange(row.size)
    filled = row.copy()
    filled[gone] = np.interp(places[gone], places[~gone], row[~gone])
    extreme = np.sign(row[gone]) * np.abs(row[gone])
    lines = row.size // 2 + 1
    keep = np.arange(lines) < 0.12 * lines
    for _ in range(rounds):
        spectrum = fft.rfft(filled)
        spectrum[~keep] = 0.0
        smooth = fft.irfft(spectrum, row.size)
        guess = smooth[gone]
        # Beyond the rail, on its side: that much is known.
        filled[gone] = np.where(extreme > 0.0, np.maximum(guess, extreme), np.minimum(guess, extreme))
    return filled
