"""Parts of the measuring chain: what a sensor, an amplifier or a filter makes of a channel's acceleration.

A part is a factor on the spectrum of one channel, a delay of the spool's samples, or a gain that drifts.
All are 1 (or 0 s) where their size is 0. The record is never changed: the likelihood applies the inverse
of the body's parts to the excitation and the inverse of the spool's parts to what the model is corrected
by.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from spool_estimator.identification.nuisances.record_nuisance import Nuisance
from spool_sim.terms import Parameter

Array = NDArray[np.float64]
Spectrum = NDArray[np.complex128]
Values = Mapping[str, float]

GAIN, DELAY = "spool_gain_error", "spool_delay"
#: Smallest factor of a response whose inverse is taken: beyond, the reading holds noise alone.
SMALLEST = 0.1


@dataclass(frozen=True, slots=True)
class ChainPart:
    """A part of one channel.

    Attributes:
        id: as in results; ``channel`` is "body" or "spool".
        parameters: the first one is its size.
        response: factor on the spectrum at frequencies (Hz, > 0), ``None`` for a part that is no filter.
        meaning: what it is; ``check``: what to look at.
    """

    id: str
    channel: str
    parameters: tuple[Parameter, ...]
    response: Callable[[Array, Values], Spectrum] | None
    meaning: str
    check: str

    def told(self, values: Values, deviations: Values) -> Nuisance:
        """Return its nuisance for the result: its corner or natural frequency, or its rate."""
        place = 1 if self.id == "extra_mode" else 0
        own = self.parameters[place]
        size, spread, unit = abs(values[own.name]), deviations.get(own.name, float("nan")), own.unit
        if self.id == "anti_alias" and size > 0.0:
            size, spread, unit = 1.0 / size, spread / size**2, "Hz"
        return Nuisance(self.id, self.channel, size, unit, self.check, spread)

    @property
    def key(self) -> str:
        """Name of this part among those of both channels."""
        return f"{self.channel}_{self.id}"


def high_pass(frequency: Array, corner: float) -> Spectrum:
    """Return the response of a high-pass of first order with its ``corner`` in Hz."""
    return np.asarray(frequency / (frequency - 1j * corner), dtype=np.complex128)


def low_pass(frequency: Array, time: float) -> Spectrum:
    """Return the response of a Butterworth low-pass of second order; ``time`` is 1 over its corner, s."""
    turn = 1j * frequency * time
    return np.asarray(1.0 / (1.0 + np.sqrt(2.0) * turn + turn**2), dtype=np.complex128)


def mode(frequency: Array, share: float, natural: float, damping: float) -> Spectrum:
    """Return 1 plus ``share`` of the motion of a mode at ``natural`` Hz with the ratio ``damping``."""
    own = frequency**2 / (natural**2 - frequency**2 + 2j * damping * natural * frequency)
    return np.asarray(1.0 + share * own, dtype=np.complex128)


def mode_of_other(values: Values, channel: str) -> dict[str, float]:
    """Return the numbers of a mode of the other channel that acts like ``channel``'s mode of ``values``.

    A mode with its share below 1 has an inverse that is a mode, too: poles and zeros change places.
    """
    share, natural, damping = (values[f"{channel}_mode_{name}"] for name in ("share", "frequency", "damping"))
    left = 1.0 - min(share, 0.9)
    other = "spool" if channel == "body" else "body"
    return {
        f"{other}_mode_share": 1.0 - 1.0 / left,
        f"{other}_mode_frequency": natural / np.sqrt(left),
        f"{other}_mode_damping": damping / np.sqrt(left),
    }


def inverse(response: Spectrum) -> Spectrum:
    """Return 1 over ``response``, at most 1 over ``SMALLEST`` in size."""
    size = np.abs(response)
    return np.asarray(np.conj(response) / np.maximum(size, SMALLEST) ** 2)


def _coupling(channel: str) -> ChainPart:
    corner = Parameter(f"{channel}_corner", "Hz", 0.0, 6.0, 0.3, "corner of the channel's high-pass")
    return ChainPart(
        "ac_coupling",
        channel,
        (corner,),
        lambda frequency, values: high_pass(frequency, values[corner.name]),
        "the channel is AC-coupled: slow motion is shifted in phase and lost",
        "coupling of the channel (AC or DC), lower limit of an IEPE or charge amplifier, the logger",
    )


def _filter(channel: str) -> ChainPart:
    time = Parameter(f"{channel}_filter_time", "s", 0.0, 8e-3, 1e-3, "1 over the corner of the low-pass")
    return ChainPart(
        "anti_alias",
        channel,
        (time,),
        lambda frequency, values: low_pass(frequency, values[time.name]),
        "this channel has a lower anti-alias filter than the other one",
        "filter settings of both channels in logger and amplifier: same type, order and corner",
    )


def _mode(channel: str) -> ChainPart:
    share = Parameter(
        f"{channel}_mode_share", "1", -2.0, 3.0, 0.1, "motion of the mode over that of its base"
    )
    natural = Parameter(f"{channel}_mode_frequency", "Hz", 20.0, 2e3, 150.0, "natural frequency")
    damping = Parameter(f"{channel}_mode_damping", "1", 2e-3, 0.6, 0.05, "damping ratio")
    return ChainPart(
        "extra_mode",
        channel,
        (share, natural, damping),
        lambda frequency, values: mode(
            frequency, values[share.name], values[natural.name], values[damping.name]
        ),
        "the sensor's bracket, or the body between the sensors, has a resonance of its own",
        "mounting of both sensors (stud, not magnet or wax), stiffness of brackets, a tap test",
    )


def _spool_gain() -> ChainPart:
    gain = Parameter(GAIN, "1", -0.5, 1.0, 0.02, "relative gain error")
    return ChainPart(
        GAIN,
        "spool",
        (gain,),
        lambda frequency, values: np.full(frequency.size, 1.0 + values[GAIN], dtype=np.complex128),
        "the spool's channel has another gain than the body's",
        "sensitivity of both sensors and settings of both amplifiers",
    )


def _gain_drift() -> ChainPart:
    rate = Parameter("gain_drift_rate", "1/s", -0.05, 0.05, 2e-4, "relative change of the spool's gain")
    return ChainPart(
        "gain_drift",
        "spool",
        (rate,),
        None,
        "the sensitivity of a sensor or amplifier drifts, as while it warms",
        "warm-up time and temperature of sensors and amplifiers, cables and mountings that come loose",
    )


def _delay() -> ChainPart:
    delay = Parameter(DELAY, "s", -5e-3, 5e-3, 2e-4, "time of the spool's reading after the motion")
    return ChainPart(
        DELAY,
        "spool",
        (delay,),
        None,
        "the spool's channel lags behind the body's",
        "filters of both channels, sampling order of the logger, clocks of two loggers",
    )


#: Every part, by its key; gain and delay of the spool's channel belong to each structure.
CHAIN_PARTS: dict[str, ChainPart] = {
    part.key: part
    for part in (
        _coupling("body"),
        _coupling("spool"),
        _filter("body"),
        _filter("spool"),
        _mode("body"),
        _mode("spool"),
        _gain_drift(),
    )
}
SPOOL_GAIN, SPOOL_DELAY = _spool_gain(), _delay()
