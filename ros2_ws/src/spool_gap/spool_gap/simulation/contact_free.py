"""Contact-free segments of a record: the spool touches no stop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from spool_estimator.identification.free_run import Window
from spool_estimator.identification.record import Record
from spool_estimator.identification.spectra import ZeroPhase

from .contacts import Contacts, Mask
from .segments import Stretch
from .shooting import RUN_IN

Array = NDArray[np.float64]

#: s that count in one contact-free window, longest first.
LENGTHS = (0.6, 0.3, 0.15)
#: s of contact-free segments, run-in not counted, with which a length is content, and least of any length.
PLENTY, LEAST = 12.0, 3.0


def without_hits(stretches: Sequence[Stretch], contacts: Contacts) -> list[Stretch]:
    """Return ``stretches`` with the noise that their spool's channel shows between the hits."""
    found = []
    for stretch, touching in zip(stretches, contacts.touching, strict=True):
        density = min(_noise(stretch.record, touching), stretch.noise.spool)
        found.append(replace(stretch, noise=replace(stretch.noise, spool=density)))
    return found


def _noise(record: Record, touching: Mask) -> float:
    """Return the density (unit^2/Hz) of the spool's noise from the median between the hits.

    Means over the whole record hold what the bridges leave out, and friction's jumps.
    """
    lines = fft.rfft(bridged(record.spool, touching))
    lines[: lines.size // 2] = 0.0
    upper = fft.irfft(lines, record.spool.size)[~touching]
    rms = 1.4826 * float(np.median(np.abs(upper))) if upper.size else 0.0
    return max(rms**2 / (0.25 * record.sample_rate), 1e-30)


def contact_free_segments(stretches: Sequence[Stretch], contacts: Contacts) -> list[Stretch]:
    """Return ``stretches`` with windows that hold no hit, run-in included; none where there is too little.

    Every other one is held out.
    """
    found: list[Stretch] = []
    for length in LENGTHS:
        found = [
            _cut(stretch, touching, length)
            for stretch, touching in zip(stretches, contacts.touching, strict=True)
        ]
        found = [stretch for stretch in found if stretch.windows]
        seconds = sum(
            (window.stop - window.start) * stretch.record.sample_period
            for stretch in found
            for window in stretch.windows
        )
        if seconds >= PLENTY:
            return found
    return found if seconds >= LEAST else []


def _cut(stretch: Stretch, touching: Mask, length: float) -> Stretch:
    record = stretch.record
    period = record.sample_period
    size, lead = round(length / period), max(2, round(RUN_IN / period))
    ends = stretch.motion.settling
    blocked = touching.copy()
    blocked[:ends] = blocked[blocked.size - max(2, ends) :] = True
    edges = np.diff(np.concatenate([[1], blocked.astype(np.int8), [1]]))
    spool = bridged(record.spool, touching)
    means = ZeroPhase(period, 0.0).apply(spool, interval_means=True)
    windows: list[Window] = []
    for begin, end in zip(
        np.flatnonzero(edges == -1).tolist(), np.flatnonzero(edges == 1).tolist(), strict=True
    ):
        for number in range((end - begin - lead) // size):
            start = begin + lead + number * size
            stop = start + size
            windows.append(
                replace(
                    stretch.windows[0], first=start - lead, start=start, stop=stop, viscosity=None,
                    measured=spool[start:stop], measured_means=means[start:stop],
                )
            )  # fmt: skip
    training = tuple(number % 2 == 0 for number in range(len(windows)))
    return replace(stretch, record=replace(record, spool=spool), windows=tuple(windows), training=training)


def bridged(row: Array, gone: Mask) -> Array:
    """Return ``row`` with straight lines in place of the samples ``gone``.

    A hit lasts about a sample and rings, band-limited, through what is between the samples next to it.
    """
    places = np.arange(row.size)
    filled = row.copy()
    if gone.any() and not gone.all():
        filled[gone] = np.interp(places[gone], places[~gone], row[~gone])
    return filled
