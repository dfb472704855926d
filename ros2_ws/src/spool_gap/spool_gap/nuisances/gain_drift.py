"""Gain drift of a channel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from spool_estimator.identification.record import Record
from spool_sim.terms import Parameter

from spool_gap.chain_effect import ChainEffect
from spool_gap.effect import Array


class GainDrift(ChainEffect):
    """Gain drift: the ratio of both channels' gains changes in proportion to time."""

    id = "gain_drift"
    parameters = (Parameter("gain_drift_rate", "1/s", -0.05, 0.05, 1e-3, "relative change of the gain"),)
    size = "gain_drift_rate"
    frees_gain = True
    follows_time = True
    picture = "time"
    equation = "reading = (1 + r t) acceleration"
    meaning = "the sensitivity of a sensor or amplifier drifts, as while it warms"
    check = (
        "warm-up time and temperature of sensors and amplifiers, cable and mounting that come loose; the "
        "body's channel may be the one that drifts, the other way"
    )
    confusable_with = ("damping_drift",)
    distinguished_by = "excitation well below the resonance at the beginning and the end of the record"

    def channel(self, values: Mapping[str, float]) -> str:  # noqa: ARG002
        """Return the spool's: two channels show their ratio alone."""
        return "spool"

    def reading(
        self,
        acceleration: Array,
        period: float,  # noqa: ARG002
        values: Mapping[str, float],
        time: Array,
    ) -> Array:
        """Return the reading with its gain."""
        return acceleration * (1.0 + values["gain_drift_rate"] * time)

    def corrected(self, record: Record, values: Mapping[str, float]) -> Record:
        """Return ``record`` with the gain of its origin throughout."""
        time = (record.first_sample + np.arange(record.body.size)) * record.sample_period
        return replace(record, spool=record.spool / (1.0 + values["gain_drift_rate"] * time))
