"""Spectral line: the strongest one of the excitation, and what the spool makes of it."""

from __future__ import annotations

import math
from typing import NamedTuple

from spool_core.kernels.compiled import compiled

from .window import Complex, SignalWindow

#: Hz, below lies drift, above no spring of a directional valve resonates.
BAND = (4.0, 250.0)


class Line(NamedTuple):
    """Line of the spectrum: the dominant one at ``stamp`` (ns, newest sample).

    ``frequency`` in Hz, ``body`` and ``spool`` peak accelerations in m/s^2, ``amplification`` spool over
    body, ``relative_displacement`` peak in m of the spool in the body, ``share`` of the body's power in the
    band that the line holds.
    """

    stamp: int
    frequency: float
    body: float
    spool: float
    amplification: float
    relative_displacement: float
    share: float


def find_line(window: SignalWindow) -> Line | None:
    """Return the dominant line, ``None`` where nothing shakes."""
    step, size = window.step, window.samples.shape[1]
    low = max(3, math.ceil(BAND[0] / step))
    high = min(size // 2 - 2, math.floor(BAND[1] / step))
    if high <= low:
        return None
    place, body, spool, relative, whole = strongest(window.spectrum, low, high)
    if body <= 0.0 or not math.isfinite(body):
        return None
    frequency = place * step
    # A sine of amplitude A under the taper holds A^2 / 4 times the taper's energy times n.
    scale = 4.0 / (window.energy * size)
    return Line(
        stamp=window.stamp,
        frequency=frequency,
        body=math.sqrt(body * scale),
        spool=math.sqrt(spool * scale),
        amplification=math.sqrt(spool / body),
        relative_displacement=math.sqrt(relative * scale) / (2.0 * math.pi * frequency) ** 2,
        share=body / whole,
    )


@compiled
def strongest(spectrum: Complex, low: int, high: int) -> tuple[float, float, float, float, float]:
    """Return the place (in lines) of the body's strongest line from ``low`` to ``high``, and powers.

    Those are of the body, the spool and the difference of both in it, and of the body in the band; two lines
    beyond the band on either side belong to it: a tapered line at its edge spreads so far.
    """
    peak, most, whole = low, -1.0, 0.0
    for i in range(low - 2, high + 3):
        power = spectrum[0, i].real ** 2 + spectrum[0, i].imag ** 2
        whole += power
        if low <= i <= high and power > most:
            peak, most = i, power
    body = spool = relative = moment = 0.0
    for i in range(peak - 2, peak + 3):
        one, other = spectrum[0, i], spectrum[1, i]
        power = one.real**2 + one.imag**2
        body += power
        spool += other.real**2 + other.imag**2
        relative += (other.real - one.real) ** 2 + (other.imag - one.imag) ** 2
        moment += (i - peak) * power
    # The centre of gravity of a Hann-tapered line lies on its frequency.
    place = peak + moment / body if body > 0.0 else float(peak)
    return place, body, spool, relative, whole
