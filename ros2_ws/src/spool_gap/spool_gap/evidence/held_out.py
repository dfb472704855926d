"""Held-out data: what a structure predicts of windows that neither its fit nor its motion has seen."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from spool_core.numbers import Array
from spool_core.record_limits import LIMITS

from spool_gap.likelihood.prediction import Predictions
from spool_gap.likelihood.structure import Structure
from spool_gap.likelihood.structure_fit import StructureFit, fit_structure
from spool_gap.report import Residual, locate, surface
from spool_gap.result import Curves, HeldOutAgreement, Surface, Where

Mask = NDArray[np.bool_]

#: Windows from which their scatter is judged.
FEWEST = 5
#: Steps of a refit on the data that are not held out.
STEPS = 6


@dataclass(frozen=True, slots=True)
class Judged:
    """What a structure leaves of the held-out windows.

    Attributes:
        structure: refitted without them.
        agreement: with the measured acceleration.
        rows: measured, predicted, displacement and velocity of each part, shape (4, n); of all samples.
        floor: rms of what noise alone leaves over that of the measured acceleration.
        bound: whether the noise is only known to be less, as motion covers it at all frequencies.
        windows: power of the error of each held-out window, shape (windows,).
    """

    structure: Structure
    agreement: HeldOutAgreement
    rows: list[Array]
    floor: float
    windows: Array
    bound: bool = False

    @property
    def known_floor(self) -> float:
        """``floor``, NaN where it is a bound."""
        return math.nan if self.bound else self.floor

    def lead(self, other: Judged, *, of_logarithms: bool = False) -> float:
        """Return by how many standard deviations this leaves less than ``other``, window by window.

        Of the windows' powers, or of their logarithms, in which no single loud window decides.

        Source: Diebold and Mariano, Comparing predictive accuracy, 1995.
        """
        gained = other.windows - self.windows
        if of_logarithms:
            there = (self.windows > 0.0) & (other.windows > 0.0)
            gained = np.log(other.windows[there] / self.windows[there])
        if gained.size < FEWEST or not gained.any():
            return 0.0
        return float(gained.mean() / (gained.std(ddof=1) / math.sqrt(gained.size)))


def by_turns(count: int) -> Mask:
    """Return which of ``count`` windows are held out: half of them, by the Thue-Morse sequence.

    It has no period, so that nothing periodic in a record falls into one half.
    """
    return np.array([bin(number).count("1") % 2 == 1 for number in range(count)], dtype=np.bool_)


class HeldOut:
    """Held-out windows of predictions: every other one, or all of the parts that were given for that."""

    def __init__(self, predictions: Predictions, wholly: Sequence[bool]) -> None:
        """Choose the windows; ``wholly``: which parts are held out as a whole, or none of them."""
        self._predictions = predictions
        self._known: dict[tuple[StructureFit, bool], Judged] = {}
        parts = predictions.parts
        self.windows: list[Mask]
        if any(wholly):
            self.windows = [np.full(part.windows, one) for part, one in zip(parts, wholly, strict=True)]
        else:
            self.windows = [by_turns(part.windows) for part in parts]

    @property
    def empty(self) -> bool:
        """Whether no sample of the windows can be compared."""
        parts = zip(self._predictions.parts, self.windows, strict=True)
        return not any(bool(part.samples_of(windows).any()) for part, windows in parts)

    @contextmanager
    def apart(self) -> Iterator[None]:
        """Leave the windows out of fits while this lasts."""
        before = [part.held for part in self._predictions.parts]
        self._predictions.hold_out(self.windows)
        try:
            yield
        finally:
            self._predictions.hold_out(before)

    def judged(self, fit: StructureFit, *, refitted: bool = True) -> Judged:
        """Return what ``fit``, refitted without them, leaves of the windows.

        Fits that are compared with each other need not be ``refitted``: all of them saw the windows. Those
        have no ``rows``.
        """
        key = fit, refitted
        if key not in self._known:
            with self.apart():
                one = fit.structure
                if refitted:
                    one = fit_structure(self._predictions, one, steps=STEPS).structure
                found = self._judged(one)
            self._known[key] = found if refitted else replace(found, rows=[])
        return self._known[key]

    def least(self, fit: StructureFit) -> Judged:
        """Return the least that ``fit`` leaves of the windows, refitted without them by both measures.

        The likelihood gives up loud tiles, which most of the error is in; least squares do not.
        """
        robust = self.judged(fit)
        with self.apart(), self._predictions.by_squares():
            again = fit_structure(self._predictions, robust.structure)
        with self.apart():
            return min(robust, self._judged(again.structure), key=lambda one: one.agreement.nrmse)

    def _judged(self, one: Structure) -> Judged:
        measured = noise = 0.0
        rows, windows = [], []
        ratios: list[tuple[Array, Array, Array]] = []
        for part in self._predictions.parts:
            found = part.responses([one])
            predicted = found.acceleration[0]
            error = part.counted_lines(part.spool - predicted)[part.held]
            reading = part.counted_lines(part.spool)[part.held]
            windows.append(np.sum(np.abs(error) ** 2, axis=1))
            measured += float(np.sum(np.abs(reading) ** 2))
            noise += part.noise_of(one, int(part.held.sum()))
            rows.append(np.array([part.spool, predicted, found.displacement[0], found.velocity[0]]))
            # Samples left out would leak into quiet bands, in one row and not in the other.
            whole = [_power(part.lines_of(row)[part.held]) for row in (part.spool, predicted)]
            ratios.append((part.lines, whole[0], whole[1]))
        size = max(measured, 1e-300)
        left = np.concatenate(windows)
        agreement = HeldOutAgreement(math.sqrt(left.sum() / size), _amplitude_ratio(ratios))
        bound = any(part.readings.noise.spool_is_bound for part in self._predictions.parts)
        # Louder noise is refused, but hits on a stop look like it.
        floor = min(math.sqrt(noise / size), 1.0 / LIMITS.excited)
        return Judged(one, agreement, rows, floor, left, bound)

    def located(self, judged: Judged) -> tuple[Where, Surface]:
        """Return where the gap of ``judged`` sits: the force that is missing along the measured motion."""
        values = judged.structure.values
        parts = []
        for part, rows, windows in zip(self._predictions.parts, judged.rows, self.windows, strict=True):
            inside = part.samples_of(windows)
            time = part.time + np.arange(part.size) * part.period
            error = rows[0] - rows[1]
            parts.append(np.array([time, rows[2], rows[3], values["mass"] * error])[:, inside])
        time, z, v, force = np.concatenate(parts, axis=1)
        rms = float(np.sqrt(np.mean(np.concatenate([rows[0] for rows in judged.rows]) ** 2)))
        floor = values["mass"] * min(judged.floor, judged.agreement.nrmse) * rms  # noise leaves no more
        residual = Residual(time, z, v, force, floor, self._predictions.parts[0].period)
        return locate(residual), surface(residual)

    def curves(self, before: Judged, after: Judged) -> Curves:
        """Return a second of the windows, where the gap was largest, and the spectra."""
        best: tuple[float, int, int] = (-1.0, 0, 0)
        for number, (part, rows, windows) in enumerate(
            zip(self._predictions.parts, before.rows, self.windows, strict=True)
        ):
            error = part.windows_of(rows[0] - rows[1])
            for place in np.flatnonzero(windows).tolist():
                best = max(best, (float(np.sum(error[place] ** 2)), number, place))
        _, number, place = best
        part = self._predictions.parts[number]
        count = part.windows_of(part.spool).shape[1]
        cut = slice(place * count, (place + 1) * count)
        time = part.time + np.arange(cut.start, cut.stop, dtype=np.float64) * part.period
        own, final = before.rows[number], after.rows[number]
        shown = own[0], own[0] - own[1], final[0] - final[1]
        windows = self.windows[number]
        spectra = [part.density_of(_power(part.lines_of(row)[windows])) for row in shown]
        return Curves(
            time=time,
            measured=own[0][cut],
            before=own[1][cut],
            after=final[1][cut],
            frequency=part.lines,
            measured_density=spectra[0],
            before_density=spectra[1],
            after_density=spectra[2],
            floor_density=part.noise_density(after.structure),
            unit="m/s^2",
        )


def _power(lines: NDArray[np.complex128]) -> Array:
    return np.asarray(np.mean(np.abs(lines) ** 2, axis=0)) if lines.shape[0] else np.zeros(lines.shape[1])


def _amplitude_ratio(spectra: Sequence[tuple[Array, Array, Array]]) -> float:
    """Return the paper's a_est/a_pom: the mean ratio of rms values in bands of 5 Hz, 10 to 100 Hz."""
    edges = np.arange(10.0, 101.0, 5.0)
    measured, model = np.zeros(edges.size - 1), np.zeros(edges.size - 1)
    for frequency, one, other in spectra:
        place = np.digitize(frequency, edges) - 1
        good = (place >= 0) & (place < measured.size)
        np.add.at(measured, place[good], one[good])
        np.add.at(model, place[good], other[good])
    there = measured > 1e-3 * measured.max(initial=0.0)
    return float(np.mean(np.sqrt(model[there] / measured[there]))) if there.any() else math.nan
