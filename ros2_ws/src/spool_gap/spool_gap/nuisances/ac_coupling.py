"""AC coupling of a channel: a high-pass of first order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from spool_estimator.identification.record import Record
from spool_estimator.identification.spectra import ZeroPhase
from spool_sim.terms import Parameter

from spool_gap.chain_effect import ChainEffect, Spectrum, filtered, lines_of
from spool_gap.effect import Array, Motion

#: Hz, below which a corrected record holds nothing: half of the lowest frequency that is analysed.
SLOWEST = 0.5


class AcCoupling(ChainEffect):
    """AC coupling: the channels' corners differ, so their low frequencies do.

    Of two corners a linear valve shows the difference; what both have in common shows to second order.
    """

    id = "ac_coupling"
    parameters = (
        Parameter("corner_difference", "Hz", -4.0, 4.0, 0.5, "the spool channel's corner less the body's"),
        Parameter("corner_common", "Hz", 0.0, 4.0, 0.1, "corner that both channels have"),
    )
    size = "corner_difference"
    equation = "reading = high-pass of first order"
    meaning = "a channel is coupled by a capacitor: slow motion is shifted and lost"
    check = "coupling of the channel (AC or DC), lower limit of an IEPE or charge amplifier, the logger"
    may_vanish = ("corner_common",)
    distinguished_by = "excitation well below the resonance"

    def reading(
        self,
        acceleration: Array,
        period: float,
        values: Mapping[str, float],
        time: Array,  # noqa: ARG002
    ) -> Array:
        """Return the reading by the filter of the spool's channel over that of the body's."""
        frequency = lines_of(acceleration.shape[-1], period)
        return filtered(acceleration, _ratio(frequency, *_corners(values)))

    def signature(self, motion: Motion, shape: Mapping[str, float]) -> Array:
        """Return the force of the difference alone, shape (1, n)."""
        return super().signature(motion, shape)[:1]

    def values(
        self,
        coefficients: Array,
        shape: Mapping[str, float],  # noqa: ARG002
        motion: Motion,  # noqa: ARG002
    ) -> dict[str, float] | None:
        """Return the difference, and a small common corner to start from."""
        if not coefficients.size:
            return None
        first, second = self.parameters
        return {
            first.name: float(np.clip(coefficients[0], 0.9 * first.low, 0.9 * first.high)),
            second.name: second.start,
        }

    def sensible(self, values: Mapping[str, float], deviations: Mapping[str, float]) -> str:
        """Return why the values make no sense: the difference is not significant."""
        spread = deviations.get(self.size, 0.0)
        return "corner_difference is not significant" if abs(values[self.size]) < 3.0 * spread else ""

    def corrected(self, record: Record, values: Mapping[str, float]) -> Record:
        """Return ``record`` with each channel through the inverse of its filter, its mean left out."""
        spool, body = _corners(values)
        frequency = lines_of(record.body.size, record.sample_period)
        # What noise the inverse makes of the slowest lines is a drift.
        kept = ZeroPhase(record.sample_period, SLOWEST).gain(frequency)
        rows = [
            filtered(row - row.mean(), kept * _ratio(frequency, 0.0, corner))
            for row, corner in ((record.body, body), (record.spool, spool))
        ]
        return replace(record, body=rows[0], spool=rows[1])


def _corners(values: Mapping[str, float]) -> tuple[float, float]:
    """Return the corners of the spool's and the body's channel, Hz."""
    difference, common = values["corner_difference"], values["corner_common"]
    return common + max(difference, 0.0), common + max(-difference, 0.0)


def _ratio(frequency: Array, spool: float, body: float) -> Spectrum:
    """Return (i f + body) / (i f + spool); 1 at rest, which no accelerometer's motion has."""
    turn = 1j * np.where(frequency > 0.0, frequency, 1.0)
    ratio = (turn + body) / (turn + spool)
    return np.asarray(np.where(frequency > 0.0, ratio, 1.0))
