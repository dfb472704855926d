"""Slow drift of a channel's zero."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from spool_core.numbers import Array
from spool_sim.valve import Valve

from spool_estimator.identification.nuisances.record_nuisance import Nuisance
from spool_estimator.identification.record import Record
from spool_estimator.identification.spectra import noise_of

from .record_nuisance import Cleaned, RecordNuisance

#: s of the means that show a drift, and their number at least.
PIECE, FEWEST = 2.0, 5
#: Standard deviations that the course of the means must exceed: noise does in one of 1e9 records.
SIGNIFICANT = 6.0
#: Share of a channel's rms below which a drift changes nothing that is analysed: the analysis' own band
#: begins above it, and two right simulations differ by half as much.
MATTERS = 1e-3


class BiasDrift(RecordNuisance):
    """Drift of the zero: a straight line through the means of either channel, taken off with the bias."""

    id = "bias_drift"
    order = 2
    check = "temperature of sensor and amplifier, warm-up time, a charge amplifier's reset, cable movement"

    def clean(self, records: Sequence[Record], valve: Valve) -> Cleaned:  # noqa: ARG002
        """Return ``records`` without bias and drift, and how far each zero drifts."""
        found: dict[str, Nuisance] = {}
        cleaned = []
        for record in records:
            rows = {"body": record.body, "spool": record.spool}
            noise = noise_of(record.body, record.spool, record.sample_rate)
            for name, density in (("body", noise.body), ("spool", noise.spool)):
                row = getattr(record, name)
                line, far = drift_of(row, record.sample_period, density)
                if far is None:
                    continue
                rows[name] = row - line
                size = float(abs(line[-1] - line[0]))
                if size > MATTERS * float(row.std()) and (name not in found or size > found[name].size):
                    found[name] = Nuisance(self.id, name, size, "m/s^2", self.check, far, corrected=True)
            cleaned.append(replace(record, body=rows["body"], spool=rows["spool"]))
        ordered = tuple(found[name] for name in sorted(found))
        return Cleaned(tuple(cleaned) if found else tuple(records), ordered)


def drift_of(row: Array, period: float, density: float) -> tuple[Array, float | None]:
    """Return the straight line through ``row`` (n,), and the deviation of its rise; ``None`` without a drift.

    Args:
        row: readings, a sample every ``period`` s.
        density: of the channel's noise at least, unit^2/Hz.
    """
    length = round(PIECE / period)
    count = row.size // length
    if count < FEWEST:
        return np.zeros(row.size), None
    window = np.hanning(length)
    means = row[: count * length].reshape(count, length) @ (window / window.sum())
    time = (np.arange(count) + 0.5) * length
    slope, start = np.polyfit(time, means, 1)
    scatter = float(np.std(means - (start + slope * time), ddof=2))
    white = float(np.sqrt(0.5 * density / period * np.sum((window / window.sum()) ** 2)))
    deviation = max(scatter, white) * row.size / (length * np.sqrt(count**3 / 12.0))
    rise = slope * row.size
    if abs(rise) < SIGNIFICANT * deviation:
        return np.zeros(row.size), None
    return start + slope * np.arange(row.size), deviation
