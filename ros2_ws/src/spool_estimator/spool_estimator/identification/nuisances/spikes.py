"""Spikes: up to three samples in a row far off what their neighbours allow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from spool_core.numbers import Array
from spool_sim.valve import Valve

from spool_estimator.identification.nuisances.record_nuisance import Nuisance
from spool_estimator.identification.record import Record
from spool_estimator.identification.spectra import ZeroPhase

from .record_nuisance import Cleaned, RecordNuisance

#: Samples of a spike at most, and samples on each side that predict those between: a cubic through them.
WIDEST, BESIDE = 3, 2
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
                spikes = spikes_of(row, record.sample_rate)
                places = np.array([place for place, _ in spikes], dtype=np.int64)
                if 0 < places.size < MOST * row.size and not (name == "spool" and _of_motion(places, motion)):
                    rows[name] = _without(row, spikes)
                    rate[name] = rate.get(name, 0.0) + places.size / seconds
            cleaned.append(replace(record, body=rows["body"], spool=rows["spool"]))
        found = tuple(
            Nuisance(self.id, name, value, "1/s", self.check, float(np.sqrt(value / seconds)), corrected=True)
            for name, value in sorted(rate.items())
        )
        return Cleaned(tuple(cleaned) if found else tuple(records), found)


def spikes_of(row: Array, rate: float) -> list[tuple[int, int]]:
    """Return first sample and width of each spike in ``row`` (n,), which comes at ``rate`` (Hz)."""
    found: list[tuple[int, int]] = []
    taken = np.zeros(row.size, dtype=bool)
    off = {width: _off(row, width) for width in range(1, WIDEST + 1)}
    deviation = {width: _deviation(rows, row, rate) for width, rows in off.items()}
    for width in range(1, WIDEST + 1):
        least = np.min(np.abs(off[width]), axis=0)
        aside = np.abs(off[width].sum(axis=0)) >= np.abs(off[width]).sum(axis=0)
        for place in np.flatnonzero((least > FAR * deviation[width]) & aside).tolist():
            part = slice(max(0, place - 4), place + width + 4)
            if taken[part].any() or least[place] < least[part].max():
                continue
            mended = row[part].copy()
            inner = slice(place - part.start, place - part.start + width)
            mended[inner] -= off[width][:, place]
            rest = np.abs(_off(mended, 1)[0])
            if rest[BESIDE:-BESIDE].max(initial=0.0) < NEAR * deviation[1][place]:
                found.append((place, width))
                taken[place : place + width] = True
    return sorted(found)


def _off(row: Array, width: int) -> Array:
    """Return by how much ``width`` samples from each one on are off what is predicted, shape (width, n)."""
    beside = np.array([*range(-BESIDE, 0), *range(width, width + BESIDE)])
    off = np.zeros((width, row.size))
    last = row.size - width - BESIDE
    for place in range(width):
        # Lagrange's polynomial through the samples beside.
        weights = [np.prod([(place - m) / (k - m) for m in beside if m != k]) for k in beside]
        for weight, offset in zip(weights, beside.tolist(), strict=True):
            off[place, BESIDE:last] -= weight * row[BESIDE + offset : last + offset]
        off[place, BESIDE:last] += row[BESIDE + place : last + place]
    return off


def _deviation(off: Array, row: Array, rate: float) -> Array:
    """Return the deviation of ``off`` (w, n) around each sample, shape (n,), of its largest sample."""
    width = max(16, round(AROUND * rate))
    largest = np.abs(off).max(axis=0)
    blocks = -(-largest.size // width)
    padded = np.concatenate([largest, largest[::-1][: blocks * width - largest.size]])
    middle = np.median(padded.reshape(blocks, -1), axis=1) / 0.6745
    # Calm stretches next to lively ones: the larger deviation counts.
    deviation = np.repeat(ndimage.maximum_filter1d(middle, 3), width)[: largest.size]
    return np.asarray(np.maximum(deviation, 1e-9 * float(np.abs(row).max(initial=0.0)) + 1e-30))


def _without(row: Array, spikes: Sequence[tuple[int, int]]) -> Array:
    """Return ``row`` with its ``spikes`` replaced by cubics through the samples beside them."""
    cleaned = row.copy()
    off = {width: _off(row, width) for width in {width for _, width in spikes}}
    for place, width in spikes:
        cleaned[place : place + width] -= off[width][:, place]
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
