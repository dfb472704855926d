"""Lines of a spectrum under a Hann taper: their power, and how likely noise shows them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from spool_core.numbers import Array

#: Probability that noise alone shows a line in a look, over all orders that are looked at.
FALSE_LINE = 1e-6
#: Lines of the spectrum that a sine spreads to on each side under a Hann taper.
LOBE = 2
#: Lines of noise on each side, every other one: a Hann taper correlates neighbours.
NOISE_LINES, NOISE_STEP = 8, 2
_OFFSETS = LOBE + 1 + NOISE_STEP * np.arange(NOISE_LINES)
_AROUND = np.concatenate((-_OFFSETS[::-1], _OFFSETS))
#: Lines from one that a test needs on each side.
REACH = int(_OFFSETS[-1])
#: Lines on each side of an order, and the share of their power that one sine of constant amplitude must hold.
#: The weakest line that noise does not show has 1.5 / (1.5 + 13 / 33) = 0.8: 33 is its contrast under
#: FALSE_LINE, 1.5 the noise bandwidth of the taper in lines, 13 the lines. Of noise through a structure of
#: 0.5 % damping at 29 Hz, 2.3 lines wide, 3 to 4 % of the pieces reach that, and at most 1 % reach 0.9 (study
#: `orders`); a line needs 1.5 times the least amplitude for it.
SKIRT, PURE = 6, 0.9


def line_powers(samples: Array) -> Array:
    """Return the power of each line under a Hann taper; a sine's lines add up to half its amplitude squared.

    Args:
        samples: shape (..., n); the result has (..., n // 2 + 1).
    """
    taper = np.hanning(samples.shape[-1])
    spectrum = np.fft.rfft((samples - samples.mean(axis=-1, keepdims=True)) * taper)
    return np.asarray(2.0 * np.abs(spectrum) ** 2 / (samples.shape[-1] * float(taper @ taper)))


def contrast(powers: Array, places: NDArray[np.int64]) -> Array:
    """Return each line's power over the mean of the noise around it.

    Args:
        powers: shape (..., lines).
        places: of the lines that are asked for, (n,), at least ``REACH`` from both ends.
    """
    line, noise = powers[..., places], powers[..., places[:, np.newaxis] + _AROUND].mean(axis=-1)
    return np.asarray(np.divide(line, noise, out=np.full(line.shape, np.inf), where=noise > 0.0))


def false_probability(contrasts: Array) -> Array:
    """Return the probability that Gaussian noise, flat around a line, shows it as strong: F of 2 and 2 n."""
    # The F distribution of 2 and 2n degrees of freedom in closed form.
    return np.asarray((1.0 + contrasts / _AROUND.size) ** -float(_AROUND.size))


def is_one_sine(samples: Array, powers: Array, peak: int, cycles: float) -> bool:
    """Whether one sine of constant amplitude holds nearly all power around a line (``SKIRT``, ``PURE``).

    Args:
        samples: shape (n,).
        powers: of their lines.
        peak: the line.
        cycles: of the sine in ``samples``.
    """
    around = float(powers[peak - SKIRT : peak + SKIRT + 1].sum())
    taper = np.hanning(samples.size)
    sine = np.exp(-2j * np.pi * cycles / samples.size * np.arange(samples.size))
    power = float(2.0 * np.abs(sine @ ((samples - samples.mean()) * taper)) ** 2 / taper.sum() ** 2)
    return power >= PURE * around
