"""Parts of the measuring chain beyond gain, delay and the logger's low-pass.

A part is a factor on the spectrum of one channel, or on its samples: a gain that drifts or depends on the
reading. All are 1 where their size is 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from spool_core.numbers import Array
from spool_sim.observation import Spectrum
from spool_sim.terms import Parameter

#: Hz, below which a response is taken to be that of this frequency.
LOWEST = 0.3
#: m/s^2: data sheets state nonlinearity by the acceleration of gravity. Readings beyond ``FAR`` times it are
#: those of a simulation that diverges.
GRAVITY, FAR = 9.80665, 1e3


@dataclass(frozen=True, slots=True)
class ChainPart:
    """A part of one channel.

    Attributes:
        id: as in results; ``channel`` is "body" or "spool".
        parameters: the first one is its size.
        response: factor on the spectrum at frequencies (Hz, > 0) for its numbers, if it is a filter.
        meaning: what it is; ``check``: what to look at.
        factor: on samples, by the reading (m/s^2, shape (n,)), the time (s, shape (n,)) and its numbers.
    """

    id: str
    channel: str
    parameters: tuple[Parameter, ...]
    response: Callable[[Array, tuple[float, ...]], Spectrum] | None
    meaning: str
    check: str
    factor: Callable[[Array, Array, tuple[float, ...]], Array] | None = None

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


def bent(reading: Array, numbers: tuple[float, ...]) -> Array:
    """Return the relative sensitivity at ``reading`` (m/s^2) for its changes over g and over its square."""
    size = np.clip(reading / GRAVITY, -FAR, FAR)
    return np.asarray(1.0 + size * (numbers[0] + size * numbers[1]))


def _coupling(channel: str) -> ChainPart:
    return ChainPart(
        "ac_coupling",
        channel,
        (Parameter(f"{channel}_corner", "Hz", 0.0, 6.0, 0.3, "corner of the channel's high-pass"),),
        lambda frequency, numbers: high_pass(frequency, *numbers),
        "the channel is AC-coupled: slow motion is shifted in phase and lost",
        "coupling of the channel (AC or DC), lower limit of an IEPE or charge amplifier, the logger",
    )


def _filter(channel: str) -> ChainPart:
    return ChainPart(
        "anti_alias",
        channel,
        (Parameter(f"{channel}_filter_time", "s", 0.0, 8e-3, 1e-3, "1 over the corner of the low-pass"),),
        lambda frequency, numbers: low_pass(frequency, *numbers),
        "this channel has a lower anti-alias filter than the other one",
        "filter settings of both channels in logger and amplifier: same type, order and corner",
    )


def _mode(channel: str) -> ChainPart:
    return ChainPart(
        "extra_mode",
        channel,
        (
            Parameter(
                f"{channel}_mode_share", "1", 0.0, 1.0, 0.1, "share of the reading that passes the mode"
            ),
            Parameter(f"{channel}_mode_frequency", "Hz", 20.0, 2e3, 150.0, "natural frequency"),
            Parameter(f"{channel}_mode_damping", "1", 2e-3, 0.2, 0.05, "damping ratio"),
        ),
        lambda frequency, numbers: mode(frequency, *numbers),
        "the sensor's bracket, or the body between the sensors, has its own resonance",
        "mounting of both sensors (stud, not magnet or wax), stiffness of brackets, a tap test; if the mode "
        "stays when you move the sensor, it belongs to the valve (spring surge or oil column)",
    )


#: Every part, by its key.
CHAIN_PARTS: dict[str, ChainPart] = {
    part.key: part
    for part in (
        *(kind(channel) for kind in (_coupling, _filter, _mode) for channel in ("body", "spool")),
        ChainPart(
            "gain_drift",
            "spool",
            (Parameter("gain_drift_rate", "1/s", -0.05, 0.05, 2e-4, "relative change of the spool's gain"),),
            None,
            "the sensitivity of a sensor or amplifier drifts, for example while it warms up",
            "warm-up time and temperature of sensors and amplifiers, cables and mountings that come loose",
            lambda _, time, numbers: 1.0 + numbers[0] * time,
        ),
        ChainPart(
            "nonlinearity",
            "spool",
            (
                Parameter("spool_square", "1/g", -0.05, 0.05, 5e-4, "change of the sensitivity over g"),
                Parameter(
                    "spool_cube", "1/g^2", -0.01, 0.01, 5e-5, "change of the sensitivity over g squared"
                ),
            ),
            None,
            "the sensitivity of the spool's sensor depends on the reading",
            "calibration of the spool's sensor at several amplitudes, its range, strain at its base",
            lambda reading, _, numbers: bent(reading, numbers),
        ),
    )
}
