"""Anti-alias filter that one channel has and the other has not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from spool_estimator.identification.record import Record
from spool_sim.terms import Parameter

from spool_gap.chain_effect import ChainEffect, Spectrum, filtered, lines_of
from spool_gap.effect import Array

#: Amplification of the inverse filter at most: beyond, the reading holds noise alone.
MOST = 10.0


class AntiAlias(ChainEffect):
    """Anti-alias filter: a low-pass of second order (Butterworth) in one channel alone.

    Its delay is part of the delay between the channels, which is fitted next to it.
    """

    id = "anti_alias"
    parameters = (
        Parameter("filter_time", "s", -8e-3, 8e-3, 1e-3, "1 over the corner frequency; of the body's if < 0"),
    )
    size = "filter_time"
    equation = "reading = low-pass of second order"
    meaning = "the channels have different anti-alias filters"
    check = "filter settings of both channels in logger and amplifier: same type, order and corner"
    confusable_with = ("spool_delay", "spool_gain_error")
    distinguished_by = "excitation up to the corner"

    def reading(
        self,
        acceleration: Array,
        period: float,
        values: Mapping[str, float],
        time: Array,  # noqa: ARG002
    ) -> Array:
        """Return the reading through the filter of the spool's channel over that of the body's."""
        frequency = lines_of(acceleration.shape[-1], period)
        return filtered(acceleration, _response(frequency, values["filter_time"]))

    def corrected(self, record: Record, values: Mapping[str, float]) -> Record:
        """Return ``record`` with the other channel filtered alike, which loses nothing that is known."""
        time = values["filter_time"]
        response = _response(lines_of(record.body.size, record.sample_period), abs(time))
        if time > 0.0:
            return replace(record, body=filtered(record.body, response))
        return replace(record, spool=filtered(record.spool, response))


def _response(frequency: Array, time: float) -> Spectrum:
    """Return the filter's response at ``frequency``, Hz, or its inverse where ``time`` (s) is negative."""
    turn = 1j * frequency * abs(time)
    response = 1.0 / (1.0 + np.sqrt(2.0) * turn + turn**2)
    if time >= 0.0:
        return np.asarray(response)
    inverse = 1.0 / response
    return np.asarray(inverse * np.minimum(1.0, MOST / np.abs(inverse)))
