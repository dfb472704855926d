"""Spectrogram of a channel over the time of a record, with the drive's strongest line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_estimator.identification.record import Record

Array = NDArray[np.float64]

#: Columns and lines at most: what a page shows of them, within its size.
COLUMNS, LINES = 320, 220
#: s of a piece, and columns at least.
PIECE, LEAST = 1.0, 6


@dataclass(frozen=True, slots=True)
class Spectrogram:
    """Spectrogram.

    Attributes:
        time: s since the record's start, middle of each column, shape (t,); rising.
        frequency: Hz, shape (f,).
        density: of the answer, unit^2/Hz, shape (f, t).
        line: frequency of the drive's strongest line in each column, Hz, shape (t,).
        length: s of a column's piece.
    """

    time: Array
    frequency: Array
    density: Array
    line: Array
    length: float


def spectrogram(rows: Sequence[tuple[float, Array, Array]], period: float, highest: float) -> Spectrogram:
    """Return the spectrogram of ``rows``: start (s), drive and answer, samples ``period`` s apart.

    Args:
        rows: stretches without gaps in order of time.
        period: s.
        highest: Hz, that is shown.

    Raises:
        InputError: they are too short for some columns.
    """
    total = sum(answer.size for _, _, answer in rows) * period
    seconds = min(PIECE, total / LEAST)
    piece = round(seconds / period)
    if piece < 32:
        raise InputError(f"{total:.2f} s are too short for a spectrum over time")
    hop = max(piece // 2, round(total / COLUMNS / period))
    taper = np.hanning(piece + 2)[1:-1]
    scale = 2.0 * period / float(np.sum(taper**2))
    frequency = np.fft.rfftfreq(piece, period)
    shown = frequency <= highest
    shown[0] = False
    times, columns, lines = [], [], []
    for start, drive, answer in rows:
        for first in range(0, answer.size - piece + 1, hop):
            driving, power = (
                scale * np.abs(np.fft.rfft((row - row.mean()) * taper)) ** 2
                for row in (drive[first : first + piece], answer[first : first + piece])
            )
            times.append(start + (first + 0.5 * piece) * period)
            columns.append(power[shown])
            lines.append(float(frequency[shown][int(np.argmax(driving[shown]))]))
    if len(times) < LEAST // 2:
        raise InputError("its stretches without gaps are too short for a spectrum over time")
    density = np.array(columns).T
    group = -(-density.shape[0] // LINES)
    if group > 1:
        count = density.shape[0] // group
        density = density[: count * group].reshape(count, group, -1).mean(axis=1)
        frequencies = frequency[shown][: count * group].reshape(count, group).mean(axis=1)
    else:
        frequencies = frequency[shown]
    return Spectrogram(np.array(times), np.asarray(frequencies), density, np.array(lines), seconds)


def rows_of(records: Sequence[Record]) -> list[tuple[float, Array, Array]]:
    """Return start (s since the first sample of all), body and spool of each of ``records``."""
    begin = min(entry.start for entry in records)
    ordered = sorted(records, key=lambda entry: entry.start)
    return [((entry.start - begin) * 1e-9, entry.body, entry.spool) for entry in ordered]
