"""Pictures that force records allow."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_gap.result import Curves
from spool_report.evidence import motion
from spool_report.evidence.collection import BASE, FOUND
from spool_report.evidence.exhibit import Exhibit, LeftOut, made
from spool_report.evidence.spectra import CAMPBELL_TITLE, campbell, spectrogram

from spool_rigs.records import ForceRecord

#: Times the highest frequency with motion that a spectrum over time shows.
BEYOND = 4.0
#: Share of the motion's power that lies below that frequency.
MOST = 0.999


def exhibits(records: Sequence[ForceRecord], curves: Curves) -> list[Exhibit | LeftOut]:
    """Return every picture that ``records`` of force allow; ``curves`` are those of the analysis."""
    no_body = LeftOut(
        motion.TRANSMISSIBILITY_TITLE, "a record of force and displacement holds no acceleration of the body"
    )
    over_time = made(CAMPBELL_TITLE, partial(_over_time, records))
    return [over_time, no_body, made(motion.LOOPS_TITLE, partial(_loops, records, curves))]


def _over_time(records: Sequence[ForceRecord]) -> Exhibit:
    period, first = records[0].period, min(entry.start for entry in records)
    rows = sorted((entry for entry in records if entry.period == period), key=lambda entry: entry.start)
    highest = BEYOND * max(_reaches(entry.displacement, period) for entry in rows)
    parts = [(entry.start - first, entry.displacement, entry.force) for entry in rows]
    return campbell(spectrogram(parts, period, highest), {}, "N²/Hz")


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
            return motion.force_loops(motion.loops_from([part], entry.period))
    raise InputError("the stretch that the analysis shows is not among the records")
