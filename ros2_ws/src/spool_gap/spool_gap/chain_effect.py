"""Measuring-chain effects: nuisances that compete with the effects of the catalogue for what a model lacks.

Each is a linear operation on one channel. A model that may explain a difference by a filter as well as by a
force takes the one that held-out data prefers; what wins as a nuisance is taken out of the record, which is
then analysed afresh.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from spool_estimator.identification.nuisances.record_nuisance import Nuisance
from spool_estimator.identification.record import Record

from spool_gap.effect import Array
from spool_gap.sensor_effect import SensorEffect

Spectrum = NDArray[np.complex128]


class ChainEffect(SensorEffect):
    """Measuring-chain effect: its law as of any sensor effect, how it is told and taken out of a record.

    Attributes:
        size: name of the parameter that says how large it is.
        frees_gain: a fit leaves the gain of the spool's channel free, of which it is a part.
    """

    size: ClassVar[str] = ""
    frees_gain: ClassVar[bool] = False
    nuisance = True

    @abstractmethod
    def corrected(self, record: Record, values: Mapping[str, float]) -> Record:
        """Return ``record`` without it."""

    def channel(self, values: Mapping[str, float]) -> str:
        """Return the channel that it is in: a negative size means the body's, in reverse."""
        return "spool" if values[self.size] >= 0.0 else "body"

    def found(self, values: Mapping[str, float], deviations: Mapping[str, float]) -> Nuisance:
        """Return what is told of it, with its fitted ``values`` and their standard ``deviations``."""
        unit = next(p.unit for p in self.parameters if p.name == self.size)
        return Nuisance(
            self.id,
            self.channel(values),
            abs(values[self.size]),
            unit,
            self.check,
            deviations.get(self.size, float("nan")),
            corrected=True,
        )


def filtered(rows: Array, response: Spectrum) -> Array:
    """Return ``rows`` (..., n) through ``response`` at the frequencies of :func:`lines_of`."""
    count = rows.shape[-1]
    reach, length = _lengths(count)
    padding = [(0, 0)] * (rows.ndim - 1) + [(reach, reach)]
    # The mirror image through an end point would begin with a step, which slow filters make much of.
    padded = np.pad(rows, padding, mode="reflect")
    passed = fft.irfft(fft.rfft(padded, length, axis=-1) * response, length, axis=-1)
    return np.asarray(passed[..., reach : reach + count])


def lines_of(count: int, period: float) -> Array:
    """Return the frequencies (Hz) at which ``count`` samples, a ``period`` (s) apart, are filtered."""
    return np.asarray(fft.rfftfreq(_lengths(count)[1], period))


def _lengths(count: int) -> tuple[int, int]:
    reach = count - 1
    return reach, fft.next_fast_len(count + 2 * reach, real=True)
