"""Spikes: single samples far off what their neighbours allow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from spool_sim.valve.description import Valve

from spool_identification.record import Record
from spool_identification.signals.zero_phase import ZeroPhase

from .nuisance import Nuisance
from .record_nuisance import Cleaned, RecordNuisance

Array = NDArray[np.float64]

#: Weights by which the four neighbours of a sample predict it: a cubic through them.
NEIGHBOURS = np.array([-1.0, 4.0, 0.0, 4.0, -1.0]) / 6.0
#: Deviations from which a sample is far off: noise of any band exceeds it in one of 1e15 samples, sharp
#: changes of a force are shared by the neighbours.
FAR, NEAR = 8.0, 4.0
#: s over which the deviation is taken.
AROUND = 0.25
#: Samples that may be spikes, as a share: more are another disease.
MOST = 0.02
#: Standard deviations of the mean rank of travel or speed from which they are of the motion, and how few of
#: the spool's could show that.
AS_HITS, FEWEST = 3.0, 5
#: Hz, from which on travel is looked at for that.
TRAVEL = 2.0


class Spikes(RecordNuisance):
    """Spikes in either or both channels: replaced by what their neighbours predict."""

    id = "spikes"
    check = "plugs and cables (contact), electromagnetic interference by switched valves, the logger's link"

    def clean(self, records: Sequence[Record], valve: Valve) -> Cleaned:  # noqa: ARG002
        """Return ``records`` without spikes, and how many a second each channel has."""
        rate: dict[str, float] = {}
        cleaned = []
        seconds = sum(record.duration for record in records)
        for record in records:
            rows = {"body": record.body, "spool": record.spool}
            band = ZeroPhase(record.sample_period, TRAVEL)
            motion = [np.abs(band.apply(record.spool - record.body, order)) for order in (1, 2)]
            for name in ("body", "spool"):
                row = getattr(record, name)
                places = spikes_of(row, record.sample_rate)
                if 0 < places.size < MOST * row.size and not (name == "spool" and _of_motion(places, motion)):
                    rows[name] = _without(row, places)
                    rate[name] = rate.get(name, 0.0) + places.size / seconds
            cleaned.append(replace(record, body=rows["body"], spool=rows["spool"]))
        found = tuple(
            Nuisance(self.id, name, value, "1/s", self.check, float(np.sqrt(value / seconds)), corrected=True)
            for name, value in sorted(rate.items())
        )
        return Cleaned(tuple(cleaned) if found else tuple(records), found)


def spikes_of(row: Array, rate: float) -> NDArray[np.int64]:
    """Return which samples of ``row`` (n,), which come at ``rate`` (Hz), are spikes."""
    off = row - np.convolve(row, NEIGHBOURS, mode="same")
    off[:2] = off[-2:] = 0.0
    width = max(16, round(AROUND * rate))
    blocks = -(-off.size // width)
    padded = np.concatenate([off, off[::-1][: blocks * width - off.size]])
    middle = np.median(np.abs(padded.reshape(blocks, -1)), axis=1) / 0.6745
    # Calm stretches next to lively ones: the larger deviation counts.
    deviation = np.repeat(ndimage.maximum_filter1d(middle, 3), width)[: off.size]
    deviation = np.maximum(deviation, 1e-9 * float(np.abs(row).max(initial=0.0)) + 1e-30)
    found = []
    size = np.abs(off)
    for place in np.flatnonzero(size > FAR * deviation).tolist():
        if size[place] < size[max(0, place - 2) : place + 3].max():
            continue
        mended = row[max(0, place - 4) : place + 5].copy()
        centre = place - max(0, place - 4)
        mended[centre] -= off[place]
        rest = mended - np.convolve(mended, NEIGHBOURS, mode="same")
        if np.abs(rest[2:-2]).max(initial=0.0) < NEAR * deviation[place]:
            found.append(place)
    return np.array(found, dtype=np.int64)


def _without(row: Array, places: NDArray[np.int64]) -> Array:
    cleaned = row.copy()
    cleaned[places] = np.convolve(row, NEIGHBOURS, mode="same")[places]
    return cleaned


def _of_motion(places: NDArray[np.int64], motion: Sequence[Array]) -> bool:
    """Whether spikes may be hits, or jumps of friction, which come at places or speeds of the motion.

    Args:
        places: of the spikes.
        motion: abs(z') and abs(z), shape (n,) each.
    """
    if places.size < FEWEST:
        return True
    ranks = [float(np.mean(np.searchsorted(np.sort(row), row[places]) / row.size)) for row in motion]
    return any(abs(rank - 0.5) > AS_HITS / np.sqrt(12.0 * places.size) for rank in ranks)
