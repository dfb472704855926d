"""Multiple shooting: short pieces that start from the measured motion.

A free run over seconds has many local minima, since a small error of stiffness turns the phase; over half a
second it has not. What the start's error makes of a piece is taken out by projection, see
:meth:`Simulation.weigh`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from spool_estimator.identification.free_run import Window, limited
from spool_estimator.identification.spectra import ZeroPhase

from .segments import Stretch, thinned

Array = NDArray[np.float64]
Spectrum = NDArray[np.complex128]

#: s that count in a piece, s in front of it in which memories of friction build up, and s of excitation on
#: both sides.
PIECE, RUN_IN, MARGIN = 0.6, 0.25, 0.1
#: Upper end of the band in which a damper synchronises over that of the excitation.
SYNCHRONISED = 3.0


@dataclass(frozen=True, slots=True)
class Piece(Window):
    """A window whose start follows the gain and delay that a hypothesis gives the spool's channel.

    Attributes:
        gain, delay: with which ``state`` was worked out, relative and s.
        by_gain, by_delay: change of ``state`` with them, (m, m/s) per 1 and per s.
        wander: how far ``state`` may be off, (m, m/s), rms.
        pull: spectra of the velocities of body and spool as read, times the rate of the damper that ties
            it to the measured motion, m/s^2; ``None`` where runs are free.
    """

    gain: float
    delay: float
    by_gain: tuple[float, float]
    by_delay: tuple[float, float]
    wander: tuple[float, float] = (0.0, 0.0)
    pull: tuple[Spectrum, Spectrum] | None = None

    def state_at(self, gain: float, delay: float) -> tuple[float, float]:
        """Return the start for another gain and delay."""
        more, later = gain - self.gain, delay - self.delay
        return (
            self.state[0] + self.by_gain[0] * more + self.by_delay[0] * later,
            self.state[1] + self.by_gain[1] * more + self.by_delay[1] * later,
        )


def pieces_of(
    stretches: Sequence[Stretch], longest: int, gain: float = 0.0, delay: float = 0.0, rate: float = 0.0
) -> list[Stretch]:
    """Return ``stretches`` with their windows cut into pieces, at most ``longest`` samples to fit.

    As many samples are held out; what was held out of the windows is held out of the pieces. ``gain`` and
    ``delay`` of the spool's channel are those with which the motion was worked out; ``rate`` is that of a
    damper between model and measured motion: its coefficient over the mass, 1/s.
    """
    return thinned([_cut(stretch, gain, delay, rate) for stretch in stretches], longest)


def _cut(stretch: Stretch, gain: float, delay: float, rate: float) -> Stretch:
    record = stretch.record
    period = record.sample_period
    conditioning = ZeroPhase(period, stretch.low_cut)
    spool, speed, travel = (conditioning.apply(stretch.motion.spool, order) for order in (0, 1, 2))
    lead, margin = max(2, round(RUN_IN / period)), max(4, round(MARGIN / period))
    body = limited(stretch.quiet.apply(record.body), period, stretch.highest_frequency)
    reach = min(body.size - 1, margin + lead + 4)
    rows = [body]
    if rate:
        high = SYNCHRONISED * stretch.highest_frequency
        rows += [
            limited(rate * conditioning.apply(read, 1), period, high) for read in (record.body, record.spool)
        ]
    padded = np.pad(np.array(rows), ((0, 0), (reach, reach)), mode="reflect", reflect_type="odd")
    rise = 0.5 - 0.5 * np.cos(np.pi * (np.arange(margin // 2) + 0.5) / (margin // 2))
    windows: list[Window] = []
    training: list[bool] = []
    for window, trains in zip(stretch.windows, stretch.training, strict=True):
        size = window.stop - window.start
        count = max(1, round(size * period / PIECE))
        edges = window.start + (size * np.arange(count + 1)) // count
        for start, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            first = start - lead
            excitation = padded[:, reach + first - margin : reach + stop + 2 + margin].copy()
            excitation[:, : rise.size] *= rise
            excitation[:, excitation.shape[1] - rise.size :] *= rise[::-1]
            spectra = fft.rfft(excitation)
            part = slice(start - window.start, stop - window.start)
            own = replace(
                window, first=first, start=start, stop=stop, excitation=spectra[0], margin=margin,
                length=excitation.shape[1],
                state=(float(stretch.motion.displacement[first]), float(stretch.motion.velocity[first])),
                measured=window.measured[part], measured_means=window.measured_means[part],
            )  # fmt: skip
            windows.append(
                Piece(
                    **{entry.name: getattr(own, entry.name) for entry in fields(Window)},
                    gain=gain,
                    delay=delay,
                    by_gain=(-float(travel[first]) / (1.0 + gain), -float(speed[first]) / (1.0 + gain)),
                    by_delay=(float(speed[first]), float(spool[first])),
                    pull=(spectra[1], spectra[2]) if rate else None,
                )
            )
            training.append(trains)
    return replace(stretch, windows=tuple(windows), training=tuple(training))


def ringing(length: int, lead: int, period: float, mass: float, stiffness: float, damping: float) -> Array:
    """Return the two accelerations in which the spool of the linear base rings, shape (2, length)."""
    time = (lead + np.arange(length)) * period
    roots = np.roots([mass, damping, stiffness]).astype(np.complex128)
    if abs(roots[0] - roots[1]) < 1e-6 * abs(roots[0]):
        rows = np.array([np.exp(roots[0] * time), time * np.exp(roots[0] * time)])
        return np.asarray(rows.real)
    if roots[0].imag != 0.0:
        wave = np.exp(roots[0] * time)
        return np.array([wave.real, wave.imag])
    return np.asarray(np.exp(roots[:, np.newaxis] * time).real)
