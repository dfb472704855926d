"""Recorded excitation: body acceleration at the samples and interpolated between them."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field

from spool_sim.files.validation import Number

from .base import Array, Excitation

#: Samples on each side that one value between samples is made from, and the power of their window.
_REACH = 24
_ORDER = 6
#: Share of the power that may lie above what counts as the highest frequency.
_REST = 1e-4


def _samples(given: object) -> Array:
    values = np.array(given, dtype=np.float64)
    if values.ndim != 1 or values.size < 2:
        raise ValueError("a record needs one row of at least two samples")
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise ValueError(f"sample {bad[0]} is not a number ({bad.size} such in all)")
    values.setflags(write=False)
    return values


class Recorded(Excitation):
    """Recorded body acceleration; the body stands still before and after it.

    Between samples it is band-limited: sinc under a window over 48 samples, within 2e-4 of the truth up to
    0.4 of the sample rate; at the samples it is the samples. Beyond the ends the record goes on as its mirror
    image through the end point, for the interpolation only.

    Attributes:
        samples: m/s^2, shape (n,), evenly spaced.
        sample_rate: Hz.
        source: where the record comes from, for messages.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)

    kind: Literal["recorded"] = "recorded"
    samples: Annotated[Array, BeforeValidator(_samples), Field(repr=False)]
    sample_rate: Annotated[Number, Field(ge=1.0, le=1e6)]
    source: str = "record"

    @property
    def duration(self) -> float:
        """Time from the first sample to the last, s."""
        return (self.samples.size - 1) / self.sample_rate

    @cached_property
    def highest_frequency(self) -> float:
        """Frequency, Hz, below which all but 1e-4 of the power lies; less than half the sample rate."""
        window = np.hanning(self.samples.size + 2)[1:-1]
        power = np.abs(np.fft.rfft(self.samples * window)) ** 2
        if not power.any():
            return 0.0
        share = np.cumsum(power) / power.sum()
        line = int(np.searchsorted(share, 1.0 - _REST))
        highest = 0.5 * self.sample_rate * (1.0 - 1e-6)
        return min(highest, (line + 1) * self.sample_rate / self.samples.size)

    @cached_property
    def _continued(self) -> Array:
        """The record with its mirror images, turned about the end points, shape (n + 2 reach,)."""
        return np.pad(self.samples, _REACH, mode="reflect", reflect_type="odd")

    def _steady(self, t: Array) -> Array:
        inside = (t >= 0.0) & (t <= self.duration)
        place = t[inside] * self.sample_rate
        before = np.minimum(np.floor(place).astype(np.int64), self.samples.size - 1)
        beyond = place - before
        # sin(pi (x - n)) of all nodes is that of one node but for its sign.
        sine = np.sin(np.pi * beyond) / np.pi
        values = np.zeros(place.size)
        for node in range(1 - _REACH, _REACH + 1):
            distance = beyond - node
            at_node = np.abs(distance) < 1e-9
            sinc = np.where(at_node, 1.0, (1 - 2 * (node % 2)) * sine / np.where(at_node, 1.0, distance))
            window = np.maximum(0.0, 1.0 - (distance / _REACH) ** 2)
            values += sinc * window**_ORDER * self._continued[before + (node + _REACH)]
        total = np.zeros(t.shape)
        total[inside] = values
        return total
