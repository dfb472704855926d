"""Whether a channel's unit is off by 9.81: no valve has the transfer that such a record shows.

Dry friction and strong springs make a spool follow its body, play and soft springs make it lag: each bends
the transfer by as much as a wrong unit does, but at some frequencies. So the record is held against all
valves whose spring and drag are anywhere between, with and without the factor.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from spool_sim.valve import Valve

from spool_gap.thresholds import THRESHOLDS

Array = NDArray[np.float64]

GRAVITY = 9.80665
#: Spring and drag over those of the valve's description: of any valve that may be met, a stuck one included,
#: and of one whose units alone are wrong.
ANY_SPRING: Array = np.geomspace(0.3, 64.0, 36, dtype=np.float64)
SAME_SPRING: Array = np.geomspace(0.7, 1.5, 9, dtype=np.float64)
ANY_DRAG: Array = np.geomspace(0.1, 6.0, 14, dtype=np.float64)
#: The same where the spool floats in the play of its springs: hardly a spring, but the drag that it has.
NO_SPRING: Array = np.geomspace(1e-3, 0.3, 9, dtype=np.float64)
SAME_DRAG: Array = np.geomspace(0.5, 2.0, 7, dtype=np.float64)
#: Frequencies that are looked at, and a distance (natural logarithm) beyond which more says nothing.
LOOKED_AT, FAR = 150, 1.5
#: Share of the frequencies that are the slow ones.
SLOW = 0.1


def expected_transfer(frequency: Array, valve: Valve) -> Array:
    """Return spool over body by the valve's description, complex, shape of ``frequency`` (Hz)."""
    return np.asarray(_transfer(frequency, valve, np.ones((1, 1)), np.ones((1, 1)))[0, 0])


def _transfer(frequency: Array, valve: Valve, spring: Array, drag: Array) -> Array:
    angular = 2j * np.pi * frequency
    force = valve.spring_stiffness * spring[..., np.newaxis] + (
        angular * valve.likely_viscous_coefficient * drag[..., np.newaxis]
    )
    return np.asarray(force / (force + valve.moving_mass * angular**2))


def difference(size: Array, frequency: Array, valve: Valve, factor: float, springs: Array) -> float:
    """Return how far ``size`` is from ``factor`` times the nearest valve: mean difference of logarithms.

    Args:
        size: amplitude of the transfer, shape (n,).
        frequency: Hz, shape (n,).
        valve: the description.
        factor: on its transfer.
        springs: that are tried, over the description's.
    """
    apart, _ = _nearest(size, frequency, valve, factor, springs, ANY_DRAG)
    if springs is not ANY_SPRING:
        return apart
    floating, _ = _nearest(size, frequency, valve, factor, NO_SPRING, SAME_DRAG)
    return min(apart, floating, _floating_above(size, frequency, valve, factor))


def _floating_above(size: Array, frequency: Array, valve: Valve, factor: float) -> float:
    """Return the difference from the nearest valve whose spool floats in its play above some frequency."""
    swings = _apart(size, frequency, valve, factor, ANY_SPRING, ANY_DRAG)
    floats = _apart(size, frequency, valve, factor, NO_SPRING[:1], ANY_DRAG)
    below = np.cumsum(swings, axis=-1)
    above = np.cumsum(floats[..., ::-1], axis=-1)[..., ::-1]
    return float((below[..., :-1] + above[..., 1:]).min()) / swings.shape[-1]


def opposite(ratio: Array, frequency: Array, valve: Valve) -> bool:
    """Whether ``ratio`` (complex) has the sign of no valve: one sensor is turned round."""
    apart, (spring, drag) = _nearest(np.abs(ratio), frequency, valve, 1.0, ANY_SPRING, ANY_DRAG)
    nearest = _transfer(frequency, valve, np.array([[spring]]), np.array([[drag]]))[0, 0]
    described = expected_transfer(frequency, valve)
    # Exchanged channels have no valve's amplitude, and their angle says nothing.
    tried = (described, nearest) if apart < THRESHOLDS.unlike_described else (described,)
    # A channel that lags, as behind a low-pass, has the right sign where the excitation is slow.
    slow = frequency <= np.quantile(frequency, SLOW)
    alike = [np.cos(np.angle(ratio / one)) for one in tried]
    return any(
        np.median(row) < THRESHOLDS.opposite and np.median(row[slow]) < THRESHOLDS.opposite_slow
        for row in alike
    )


def _nearest(
    size: Array, frequency: Array, valve: Valve, factor: float, springs: Array, drags: Array
) -> tuple[float, tuple[float, float]]:
    apart = _apart(size, frequency, valve, factor, springs, drags).mean(axis=-1)
    spring, drag = np.unravel_index(int(np.argmin(apart)), apart.shape)
    return float(apart[spring, drag]), (float(springs[spring]), float(drags[drag]))


def _apart(size: Array, frequency: Array, valve: Valve, factor: float, springs: Array, drags: Array) -> Array:
    """Return how far ``size`` is from valves at each frequency, shape (springs, drags, frequencies)."""
    some = np.unique(np.linspace(0, frequency.size - 1, min(frequency.size, LOOKED_AT)).astype(int))
    spring, drag = np.meshgrid(springs, drags, indexing="ij")
    tried = np.log(factor * np.abs(_transfer(frequency[some], valve, spring, drag)))
    return np.asarray(np.minimum(np.abs(np.log(np.maximum(size[some], 1e-9)) - tried), FAR))


def wrong_unit(ratio: Array, frequency: Array, valve: Valve) -> float:
    """Return the factor by which the spool's channel reads too much (9.81), too little (1/9.81), or 1."""
    size = np.abs(ratio)
    unscaled = difference(size, frequency, valve, 1.0, ANY_SPRING)
    # Everywhere alike, next to the description as it stands.
    powers = np.log(np.maximum(size, 1e-9) / np.abs(expected_transfer(frequency, valve))) / math.log(GRAVITY)
    for sign in (1.0, -1.0):
        factor = GRAVITY**sign
        left = difference(size, frequency, valve, factor, SAME_SPRING)
        shifted = np.median(np.abs(powers - sign)) < 0.35 * np.median(np.abs(powers))
        everywhere = float(np.quantile(sign * powers, 0.25)) > 0.5 and bool(shifted)
        clearly = left < THRESHOLDS.wrong_unit * unscaled and unscaled > THRESHOLDS.unlike_described
        if clearly or (everywhere and left < THRESHOLDS.wrong_unit_everywhere * unscaled):
            return float(factor)
    return 1.0


def like_no_valve(ratio: Array, frequency: Array, valve: Valve) -> bool:
    """Whether ``ratio`` is the transfer of no valve with this mass, whatever its spring and drag."""
    return difference(np.abs(ratio), frequency, valve, 1.0, ANY_SPRING) > THRESHOLDS.like_no_valve
