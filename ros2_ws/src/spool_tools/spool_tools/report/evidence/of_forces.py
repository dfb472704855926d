"""Evidence of force records: displacement and force, no acceleration."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_gap.force.force_record import ForceRecord
from spool_gap.result import Curves

from spool_tools.report.estimates.bands import bands_of
from spool_tools.report.estimates.cross_spectra import cross_spectra
from spool_tools.report.estimates.loops import loops_from
from spool_tools.report.estimates.spectrogram import spectrogram
from spool_tools.report.estimates.whiteness import whiteness

from . import campbell as campbell_picture
from . import force_loops as loops_picture
from . import information_bands as bands_picture
from . import residual_whiteness as whiteness_picture
from . import transmissibility as transmissibility_picture
from .exhibit import Exhibit, LeftOut, made

Array = NDArray[np.float64]

#: Names of both sides.
BASE, FOUND = "base model", "with what was found"
#: Times the highest frequency with motion that a spectrum over time shows.
BEYOND = 4.0
#: Share of the motion's power that lies below that frequency.
MOST = 0.999


def force_exhibits(records: Sequence[ForceRecord], curves: Curves) -> list[Exhibit | LeftOut]:
    """Return every picture that ``records`` of force allow; ``curves`` are those of the analysis."""
    wanted: tuple[tuple[str, Callable[[], Exhibit]], ...] = (
        (bands_picture.TITLE_FORCE, lambda: _bands(records)),
        (campbell_picture.TITLE, lambda: _over_time(records)),
        (transmissibility_picture.TITLE, _no_body),
        (loops_picture.TITLE, lambda: _loops(records, curves)),
        (whiteness_picture.TITLE, lambda: _whiteness(curves)),
    )
    return [made(title, build) for title, build in wanted]


def _no_body() -> Exhibit:
    raise InputError("a record of force and displacement holds no acceleration of the body")


def _bands(records: Sequence[ForceRecord]) -> Exhibit:
    period = records[0].period
    rows = [entry for entry in records if entry.period == period]
    spectra = cross_spectra([entry.displacement for entry in rows], [entry.force for entry in rows], period)
    return bands_picture.information_bands(bands_of(spectra), "displacement, m rms")


def _over_time(records: Sequence[ForceRecord]) -> Exhibit:
    period, first = records[0].period, min(entry.start for entry in records)
    rows = sorted((entry for entry in records if entry.period == period), key=lambda entry: entry.start)
    highest = BEYOND * max(_reaches(entry.displacement, period) for entry in rows)
    parts = [(entry.start - first, entry.displacement, entry.force) for entry in rows]
    return campbell_picture.campbell(spectrogram(parts, period, highest), {}, "N²/Hz")


def _reaches(row: Array, period: float) -> float:
    """Return the frequency, Hz, below which nearly all of the power of ``row`` lies."""
    power = np.abs(np.fft.rfft((row - row.mean()) * np.hanning(row.size))) ** 2
    share = np.cumsum(power) / max(float(power.sum()), 1e-300)
    return max(
        float(np.fft.rfftfreq(row.size, period)[int(np.searchsorted(share, MOST))]), 5.0 / (row.size * period)
    )


def _loops(records: Sequence[ForceRecord], curves: Curves) -> Exhibit:
    """Return the loops of the stretch that the curves show."""
    for entry in records:
        if entry.time[0] <= curves.time[0] and curves.time[-1] <= entry.time[-1] + 0.5 * entry.period:
            displacement = np.interp(curves.time, entry.time, entry.displacement)
            centred = displacement - displacement.mean()
            velocity = np.gradient(centred, entry.period)
            models = {BASE: curves.before, FOUND: curves.after}
            part = (float(curves.time[0]), centred, velocity, curves.measured, models)
            return loops_picture.force_loops(loops_from([part], entry.period))
    raise InputError("the stretch that the analysis shows is not among the records")


def _whiteness(curves: Curves) -> Exhibit:
    period = float(np.median(np.diff(curves.time)))
    sides = {BASE: curves.before, FOUND: curves.after}
    found = {name: whiteness([curves.measured - row], period) for name, row in sides.items()}
    return whiteness_picture.residual_whiteness(found, "N")
