"""Response to a sine once it is periodic: motion of :mod:`.composed_motion` from rest until it settles."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from spool_core.numbers import Array, Complex

from spool_sim.excitation import SteadySine
from spool_sim.integration import composed_motion

#: Samples of a period: the reading of a peak between two of them is at most 0.12 % low.
SAMPLES = 64
#: Periods of one look.
LOOK = 4
#: Relative change by which twice the time may move a settled response. What decays to this over the first
#: half decays to its square over both.
TOLERANCE = 1e-3
#: m, below which two strokes are equal: a thousandth of what roughness of a bore measures.
SAME_STROKE = 1e-9


@dataclass(frozen=True, slots=True)
class SineResponse:
    """Response of s parameter sets to a sine of the body.

    Attributes:
        ratio: first harmonic of the spool's acceleration over the body's, shape (s,).
        stroke: largest distance of the spool from the centre, m, shape (s,).
        settled: False where the motion is not periodic within ``LATEST_TIME``; ratio and stroke are NaN then.
    """

    ratio: Complex
    stroke: Array
    settled: NDArray[np.bool_]


def sine_response(
    motion: composed_motion.ComposedMotion,
    values: Mapping[str, float],
    sets: Array,
    frequency: float,
    amplitude: float,
    displaced: float = 0.0,
) -> SineResponse:
    """Return the response to a sine of the body that rises from zero, until the motion repeats itself.

    Subharmonics of a half and a quarter of the frequency count as periodic. Where several motions are
    possible, as with a hardening spring, it is the one that the valve reaches from its start.

    Args:
        motion: the composition.
        values: parameters by name, for which the step is chosen.
        sets: parameters as columns of ``motion.names``, shape (s, p).
        frequency: of the body, Hz.
        amplitude: of the body's acceleration, peak, m/s^2.
        displaced: displacement of the spool at the start, m; where it is not 0 the sine begins at once.

    Raises:
        InputError: the parameters are too stiff for any step.
    """
    rising = SteadySine(frequency=frequency, amplitude=amplitude)
    excitation = rising.model_copy(update={"soft_start": 0.0})
    rate = SAMPLES * frequency
    substeps, _ = composed_motion.checked_substeps(
        motion, values, excitation.acceleration,
        seconds=2 * LOOK / frequency, sample_rate=rate, highest_frequency=frequency,
    )  # fmt: skip
    # Every period is the first one: the forcing repeats, and no law depends on time.
    one = excitation.acceleration(composed_motion.half_step_times(0, SAMPLES, rate, substeps))[:-1]
    look = np.append(np.tile(one, LOOK), one[0])[np.newaxis]
    wave = np.exp(-2j * np.pi * np.arange(SAMPLES * LOOK) / SAMPLES) * 2.0 / (SAMPLES * LOOK)
    count = len(sets)
    ratio = np.full(count, complex(math.nan, math.nan))
    stroke, settled = np.full(count, math.nan), np.zeros(count, dtype=np.bool_)
    states = [composed_motion.MotionState(displaced)] * count
    if displaced == 0.0:
        samples = SAMPLES * LOOK * math.ceil(rising.soft_start * frequency / LOOK)
        forcing = rising.acceleration(composed_motion.half_step_times(0, samples, rate, substeps))[np.newaxis]
        _, states = motion.advance_batch(
            states, forcing, sets[:, np.newaxis, :], sample_period=1.0 / rate, substeps=substeps
        )
    left = np.arange(count)
    before = np.full(count, np.inf, dtype=np.complex128), np.full(count, np.inf)
    pieces, done = 1, 0
    while left.size and done * LOOK < composed_motion.LATEST_TIME * frequency:
        for _ in range(pieces):
            trajectory, states = motion.advance_batch(
                states, look, sets[left][:, np.newaxis, :], sample_period=1.0 / rate, substeps=substeps
            )
        done += pieces
        pieces = done  # the next look is at twice the time
        # z is smooth where the acceleration jumps; z'' = -w^2 z for the first harmonic of a periodic motion.
        relative = -((2.0 * np.pi * frequency) ** 2) * (trajectory.displacement @ wave)
        body = -1j * amplitude
        now = 1.0 + relative / body, np.abs(trajectory.displacement).max(axis=1)
        same = np.abs(now[0] - before[0]) <= TOLERANCE * np.abs(now[0])
        same &= np.abs(now[1] - before[1]) <= TOLERANCE * now[1] + SAME_STROKE
        ratio[left[same]], stroke[left[same]], settled[left[same]] = now[0][same], now[1][same], True
        before = now[0][~same], now[1][~same]
        states = [state for state, kept in zip(states, ~same, strict=True) if kept]
        left = left[~same]
    return SineResponse(ratio, stroke, settled)
