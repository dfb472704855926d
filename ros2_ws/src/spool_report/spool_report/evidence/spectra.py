"""Spectra as evidence: a frequency response with its error, and the Campbell diagram.

Welch, P. D.: The use of fast Fourier transform for the estimation of power spectra, IEEE Trans. Audio
Electroacoust. 15 (1967), for averages of pieces that overlap; Bendat, J. S., Piersol, A. G.: Random Data, 4th
edition (2010), section 9.2, for errors of frequency responses and coherence.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.numbers import Array, Complex
from spool_core.uncertainty import number
from spool_estimator.identification.record import Record
from spool_report.evidence.exhibit import AFTER, BEFORE, DASHED, Exhibit, plain, subplots
from spool_report.terminal import captions

#: s of a piece at most: lines of 0.5 Hz, finer than the resonance of any spool is wide.
LONGEST_PIECE = 2.0
#: s of a piece at least, and pieces at least: fewer averages make any coherence look high.
SHORTEST_PIECE, LEAST_PIECES = 0.25, 6
#: Squared correlation of the powers of neighbouring Hann pieces that overlap by half (Welch 1967).
OVERLAP = 1.0 / 36.0
#: Share of the largest power density of the drive below which a frequency is not judged.
EXCITED = 1e-4
#: Hz, below which accelerometers show their drift.
LOWEST = 1.0

#: Columns and lines at most: what a page shows of them, within its size.
COLUMNS, LINES = 320, 220
#: s of a piece, and columns at least.
PIECE, LEAST = 1.0, 6

CAMPBELL_TITLE = "Spectrum over time (Campbell)"
#: Decades of power shown below the largest.
DECADES = 6.0
#: Relative distance at which the machine's line counts as at the natural frequency.
NEAR = 0.1


@dataclass(frozen=True, slots=True)
class CrossSpectra:
    """Averaged one-sided densities of a drive x and an answer y; every array has shape (f,).

    Attributes:
        frequency: Hz.
        drive: power density of x, unit(x)^2/Hz.
        answer: of y, unit(y)^2/Hz.
        cross: of both, conj(X) Y.
        averages: independent averages that the overlapping pieces are worth.
        seconds: of data.
    """

    frequency: Array
    drive: Array
    answer: Array
    cross: Complex
    averages: float
    seconds: float

    @property
    def response(self) -> Complex:
        """H1 estimate of the frequency response, y over x: noise of the answer averages out of it."""
        return np.asarray(self.cross / np.maximum(self.drive, 1e-300))

    @property
    def coherence(self) -> Array:
        """Share of the answer's power that follows linearly from the drive, 0 to 1."""
        power = np.maximum(self.drive * self.answer, 1e-300)
        return np.asarray(np.clip(np.abs(self.cross) ** 2 / power, 0.0, 1.0))

    @property
    def relative_error(self) -> Array:
        """Standard deviation of the response's magnitude over it, and of its phase in rad.

        Bendat and Piersol (2010), table 9.6: sqrt(1 - coherence) / sqrt(2 averages coherence).
        """
        coherence = np.maximum(self.coherence, 1e-12)
        return np.asarray(np.sqrt((1.0 - coherence) / (2.0 * self.averages * coherence)))

    @property
    def excited(self) -> NDArray[np.bool_]:
        """Where the drive has power enough to say something."""
        inside = self.frequency >= LOWEST
        return np.asarray(inside & (self.drive > EXCITED * float(self.drive[inside].max(initial=0.0))))


def cross_spectra(drives: Sequence[Array], answers: Sequence[Array], period: float) -> CrossSpectra:
    """Return the spectra of rows of samples, ``period`` s apart, each row without a gap.

    Raises:
        InputError: the rows are too short for enough averages.
    """
    sizes = [row.size for row in drives]
    total, longest = sum(sizes), max(sizes, default=0)
    # Pieces overlap by half: n of them need (n + 1) / 2 of their length.
    seconds = min(LONGEST_PIECE, longest * period, 2.0 * total * period / (LEAST_PIECES + 1))
    piece = round(seconds / period)
    if seconds < SHORTEST_PIECE or piece < 16:
        raise InputError(
            f"{total * period:.2f} s without a gap are too short to average spectra: "
            f"{0.5 * SHORTEST_PIECE * (LEAST_PIECES + 1):.1f} s are needed"
        )
    taper = np.asarray(np.hanning(piece + 2)[1:-1], dtype=np.float64)
    scale = 2.0 * period / float(np.sum(taper**2))
    sums = [np.zeros(piece // 2 + 1, np.complex128) for _ in range(3)]
    count = 0
    for drive, answer in zip(drives, answers, strict=True):
        for first in range(0, drive.size - piece + 1, max(1, piece // 2)):
            pair = (row[first : first + piece] for row in (drive, answer))
            x, y = (np.fft.rfft((row - row.mean()) * taper) for row in pair)
            for place, part in enumerate((np.abs(x) ** 2, np.abs(y) ** 2, np.conj(x) * y)):
                sums[place] += part
            count += 1
    if count < LEAST_PIECES // 2:
        raise InputError(f"only {count} pieces of {seconds:.2f} s hold no gap: too few to average")
    xx, yy, xy = (scale / count * part for part in sums)
    worth = count / (1.0 + 2.0 * OVERLAP * (count - 1) / count)
    frequency = np.asarray(np.fft.rfftfreq(piece, period), dtype=np.float64)
    return CrossSpectra(frequency, xx.real.copy(), yy.real.copy(), xy, worth, total * period)


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


@dataclass(frozen=True, slots=True)
class Frequency:
    """Natural frequency over time: ``value`` (Hz) at ``time`` (s), and half width of its 95 % interval."""

    time: Array
    value: Array
    half_width: Array


def constant(frequency: float, shown: Spectrogram) -> Frequency:
    """Return a natural frequency that does not change, Hz."""
    time = shown.time[[0, -1]]
    return Frequency(time, np.full(2, frequency), np.zeros(2))


def campbell(shown: Spectrogram, natural: Mapping[str, Frequency], unit: str = "(m/s²)²/Hz") -> Exhibit:
    """Return the picture of ``shown`` with the natural frequencies by name, at most two."""
    power = np.log10(np.maximum(shown.density, 1e-30))
    top = float(power.max())
    figure, axis = subplots(4.4)
    # Gaps of a record stay white: each piece of the picture ends where its columns do.
    columns = np.flatnonzero(np.diff(shown.time) > 3.0 * shown.length + 3.0 * np.median(np.diff(shown.time)))
    edges = [0, *(columns + 1).tolist(), shown.time.size]
    half = 0.5 * float(np.median(np.diff(shown.time)))
    image = None
    for first, stop in pairwise(edges):
        extent = (
            float(shown.time[first]) - half, float(shown.time[stop - 1]) + half,
            float(shown.frequency[0]), float(shown.frequency[-1]),
        )  # fmt: skip
        image = axis.imshow(
            power[:, first:stop], origin="lower", aspect="auto", extent=extent, cmap="Greys",
            vmin=top - DECADES, vmax=top, interpolation="none",
        )  # fmt: skip
    axis.plot(
        shown.time,
        shown.line,
        ls="",
        marker=".",
        ms=2.5,
        color="#009E73",
        label="strongest line of the excitation",
    )
    looks = ((BEFORE, DASHED), (AFTER, "-"))[-max(1, len(natural)) :]
    for (name, one), (colour, dash) in zip(natural.items(), looks, strict=False):
        axis.plot(one.time, one.value, color=colour, ls=dash, lw=1.6, label=f"natural frequency, {name}")
        if np.any(one.half_width > 0.0):
            axis.fill_between(
                one.time,
                one.value - one.half_width,
                one.value + one.half_width,
                color=colour,
                alpha=0.3,
                lw=0,
            )
    axis.set_xlim(float(shown.time[0]) - half, float(shown.time[-1]) + half)
    axis.set_ylim(float(shown.frequency[0]), float(shown.frequency[-1]))
    plain(axis, "time since the start of the record, s", "frequency, Hz")
    if image is not None:
        figure.colorbar(image, ax=axis, label=f"log10 of the power density, {unit}", shrink=0.9)
    figure.legend(*axis.get_legend_handles_labels(), fontsize=8, loc="outside lower center", ncols=3)
    caption = captions("evidence")["spectrum over time"]
    return Exhibit(CAMPBELL_TITLE, figure, caption, _campbell_seen(shown, natural))


def _campbell_seen(shown: Spectrogram, natural: Mapping[str, Frequency]) -> str:
    parts = [
        f"Strongest line of the excitation from {number(float(shown.line.min()), 3)} to "
        f"{number(float(shown.line.max()), 3)} Hz over {number(float(shown.time[-1] - shown.time[0]), 3)} s"
    ]
    for name, one in natural.items():
        known = one.value[np.isfinite(one.value)]
        if not known.size:
            parts.append(f"the natural frequency ({name}) is not known")
            continue
        low, high = float(known.min()), float(known.max())
        end = "" if high - low < 5e-3 * high else f" to {number(high, 3)}"
        middle = float(np.median(known))
        share = float(np.mean(np.abs(shown.line / middle - 1.0) < NEAR))
        parts.append(
            f"natural frequency ({name}) {number(low, 3)}{end} Hz; the excitation's strongest line is within "
            f"{100.0 * NEAR:.0f} % of it during {100.0 * share:.0f} % of the time"
        )
    return f"{'; '.join(parts)}."
