"""Travel of the spool in the body, and how often it turned: what wears a valve."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from spool_core.block import Block, Samples
from spool_core.kernels.compiled import compiled

#: Hz, below it the displacement is not known from accelerations; at twice that 3 % are missing.
LOW_CUT = 4.0

#: s, what the integrators take to forget their start after a gap.
SETTLING = 0.5

_DAMPING = math.sqrt(0.5)

# Places in the state of the kernel.
_DISPLACEMENT, _VELOCITY, _TURN, _EXTREME, _DIRECTION, _TRAVEL, _REVERSALS, _SETTLING = range(8)


@dataclass(slots=True)
class TravelCounter:
    """Adds up the spool's way in the body, from turn to turn.

    The difference of both accelerations is integrated twice above :data:`LOW_CUT`. A turn counts when the
    spool has come back by ``threshold`` (m), so that noise does not travel: 0.05 m/s^2 rms on both sensors
    make 8 um. Way that is not finished by a turn is not counted yet.
    """

    threshold: float = 50.0e-6
    _state: NDArray[np.float64] = field(default_factory=lambda: np.zeros(8), init=False)
    _law: NDArray[np.float64] = field(default_factory=lambda: np.zeros(6), init=False)
    _period: float = field(default=0.0, init=False)
    _due: int = field(default=0, init=False)

    @property
    def travel(self) -> float:
        """Way since the start, m."""
        return float(self._state[_TRAVEL])

    @property
    def reversals(self) -> int:
        """Turns since the start."""
        return int(self._state[_REVERSALS])

    def update(self, block: Block) -> None:
        """Take an accepted block; after a gap the integrators start again."""
        gap = abs(block.stamp - self._due) > 0.5 * (block.end - block.stamp) + 2e9 * block.sample_period
        if gap or block.sample_period != self._period:
            self._restart(block.sample_period)
        self._due = block.end
        count_travel(block.body, block.spool, self._law, self.threshold, self._state)

    def _restart(self, period: float) -> None:
        self._period = period
        self._state[:_TRAVEL] = 0.0
        self._state[_SETTLING] = max(1.0, round(SETTLING / period))
        self._law = integration_law(period)


def integration_law(period: float) -> NDArray[np.float64]:
    """Return the exact step of displacement and velocity over ``period`` s, shape (6,).

    Of ``z'' + 2 d w z' + w^2 z = a`` with ``a`` held over the step: four factors of the state, two of ``a``.
    """
    cut = 2.0 * math.pi * LOW_CUT
    damped = cut * math.sqrt(1.0 - _DAMPING**2)
    fade = math.exp(-_DAMPING * cut * period)
    cosine, sine = math.cos(damped * period), math.sin(damped * period)
    ratio = _DAMPING * cut / damped
    stay, pass_on = fade * (cosine + ratio * sine), fade * sine / damped
    return np.array(
        [stay, pass_on, -(cut**2) * pass_on, fade * (cosine - ratio * sine), (1.0 - stay) / cut**2, pass_on]
    )


@compiled
def count_travel(
    body: Samples,
    spool: Samples,
    law: NDArray[np.float64],
    threshold: float,
    state: NDArray[np.float64],
) -> None:
    """Integrate the samples (m/s^2, shape (n,)) and add way and turns to ``state``, shape (8,)."""
    for i in range(body.size):
        driving = float(spool[i]) - float(body[i])
        displacement, velocity = state[0], state[1]
        now = law[0] * displacement + law[1] * velocity + law[4] * driving
        state[0] = now
        state[1] = law[2] * displacement + law[3] * velocity + law[5] * driving
        if state[7] > 0.0:
            state[7] -= 1.0
            state[2] = state[3] = now
            continue
        direction = state[4]
        if direction == 0.0:
            if abs(now - state[2]) > threshold:
                state[4] = 1.0 if now > state[2] else -1.0
                state[3] = now
        elif (now - state[3]) * direction > 0.0:
            state[3] = now
        elif (state[3] - now) * direction > threshold:
            state[5] += abs(state[3] - state[2])
            state[6] += 1.0
            state[2] = state[3]
            state[3] = now
            state[4] = -direction
