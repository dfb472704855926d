"""Extra mode of the body or of a sensor's mounting."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from scipy import fft
from spool_estimator.identification.least_squares import Unknown
from spool_estimator.identification.record import Record
from spool_estimator.identification.spectra import ZeroPhase
from spool_sim.terms import Parameter

from spool_gap.chain_effect import ChainEffect, Spectrum, filtered, lines_of
from spool_gap.effect import Array, Motion, Trial

#: Frequencies that are tried in each octave, and the damping ratio that they are tried with: steps of 6 %, at
#: which a mode of that damping has half of its power.
IN_OCTAVE, TRIED_DAMPING = 12, 0.05
#: Step of the frequency, as a share of itself: that between those which are tried.
STEP = 0.06
#: Share of the reading's power that its band holds, and how far beyond that modes are tried.
IN_BAND, BEYOND = 0.99, 2.0


class ExtraMode(ChainEffect):
    """Extra mode: one channel moves on a bracket, or with a part of the body, that has a resonance."""

    id = "extra_mode"
    parameters = (
        Parameter("mode_share", "1", -2.0, 2.0, 0.1, "motion of the mode over that of what it stands on"),
        Parameter("mode_frequency", "Hz", 1.0, 1e4, 100.0, "natural frequency"),
        Parameter("mode_damping", "1", 2e-3, 0.5, TRIED_DAMPING, "damping ratio"),
    )
    size = "mode_share"
    equation = "reading = (1 + r f^2 / (f0^2 - f^2 + 2 i zeta f0 f)) acceleration"
    meaning = "a sensor's bracket, or the body between the sensors, has a resonance of its own"
    check = "mounting of both sensors (stud, not magnet or wax), stiffness of brackets, a tap test"
    distinguished_by = "an excitation that reaches past its frequency"

    def reading(
        self,
        acceleration: Array,
        period: float,
        values: Mapping[str, float],
        time: Array,  # noqa: ARG002
    ) -> Array:
        """Return the reading with the mode."""
        frequency = lines_of(acceleration.shape[-1], period)
        return filtered(acceleration, _response(frequency, values))

    def unknowns(self, values: Mapping[str, float], seconds: float) -> list[Unknown]:
        """Return its numbers; frequency and damping move by shares of themselves."""
        share, *others = super().unknowns(values, seconds)
        sizes = (STEP * values.get("mode_frequency", 100.0), TRIED_DAMPING)
        scaled = [replace(own, scale=size) for own, size in zip(others, sizes, strict=True)]
        return [share, *scaled]

    def trials(self, motion: Motion) -> Iterator[Trial]:
        """Yield the force of a mode of each frequency that may be in the record."""
        if not motion.reading.size:
            return
        size = motion.reading.size
        length = fft.next_fast_len(size, real=True)
        frequency = np.asarray(fft.rfftfreq(length, motion.period))
        turn = 2j * np.pi * np.maximum(frequency, frequency[1])
        balance = motion.mass + motion.damping / turn + motion.stiffness / turn**2
        passed = fft.rfft(motion.reading, length) * ZeroPhase(motion.period, motion.low_cut).gain(frequency)
        power = np.cumsum(np.abs(passed) ** 2)
        passed *= -balance
        # Of a mode above the band its tail alone is seen, which is that of any mode still further up.
        reach = float(frequency[np.searchsorted(power, IN_BAND * power[-1])])
        low, high = 4.0 * motion.low_cut, min(0.4 / motion.period, BEYOND * reach)
        count = max(2, round(IN_OCTAVE * np.log2(high / low)))
        for place in np.geomspace(low, high, count).tolist():
            mode = _response(
                frequency, {"mode_share": 1.0, "mode_frequency": place, "mode_damping": TRIED_DAMPING}
            )
            column = fft.irfft(passed * (mode - 1.0), length)[:size]
            yield Trial(column[np.newaxis], {"mode_frequency": place, "mode_damping": TRIED_DAMPING})

    def values(
        self,
        coefficients: Array,
        shape: Mapping[str, float],
        motion: Motion,  # noqa: ARG002
    ) -> dict[str, float] | None:
        """Return the share at the frequency that was tried."""
        return {**shape, "mode_share": float(np.clip(coefficients[0], -1.9, 1.9))}

    def sensible(self, values: Mapping[str, float], deviations: Mapping[str, float]) -> str:
        """Return why the values make no sense: the share is not significant."""
        spread = deviations.get(self.size, 0.0)
        return "mode_share is not significant" if abs(values[self.size]) < 3.0 * spread else ""

    def corrected(self, record: Record, values: Mapping[str, float]) -> Record:
        """Return ``record`` with the mode taken out of the spool's channel."""
        frequency = lines_of(record.spool.size, record.sample_period)
        response = _response(frequency, values)
        return replace(record, spool=filtered(record.spool, 1.0 / response))


def _response(frequency: Array, values: Mapping[str, float]) -> Spectrum:
    """Return the reading over the acceleration at ``frequency``, Hz; never less than a tenth of it."""
    place, damping = values["mode_frequency"], values["mode_damping"]
    mode = frequency**2 / (place**2 - frequency**2 + 2j * damping * place * frequency)
    response = 1.0 + values["mode_share"] * mode
    size = np.abs(response)
    return np.asarray(np.where(size < 0.1, 0.1 * response / np.maximum(size, 1e-12), response))
