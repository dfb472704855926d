"""Friction that builds up over a small travel."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from spool_core.kernels.compiled import compiled

from spool_gap.effect import Array, Effect, Motion, scan

#: m of travel before sliding below which no record of an accelerometer shows any.
SHORTEST = 1e-7


class PreslidingFriction(Effect):
    """Dahl's hysteresis: the jump at a reversal is spread over some travel."""

    id = "presliding_friction"
    terms = ("presliding_friction",)
    replaces = ("coulomb_friction",)
    fitted = ("dahl_force", "dahl_stiffness")
    amplitudes = ("dahl_force",)
    picture = "displacement"
    confusable_with = ("coulomb_friction", "spring_backlash")
    distinguished_by = "motion with amplitudes of the order of the pre-sliding travel"

    def shapes(self, motion: Motion) -> list[dict[str, float]]:
        """Return the shapes to try."""
        largest = motion.largest_displacement
        return [{"travel": travel} for travel in scan(2e-3 * largest, 0.5 * largest, 9)]

    def signature(self, motion: Motion, shape: Mapping[str, float]) -> Array:
        """Return Dahl's state for a row of travels."""
        return dahl_state(motion.displacement, shape["travel"])[np.newaxis]

    def values(
        self,
        coefficients: Array,
        shape: Mapping[str, float],
        motion: Motion,  # noqa: ARG002
    ) -> dict[str, float] | None:
        """Return force and stiffness."""
        force = float(coefficients[0])
        if force <= 0.0:
            return None
        return {"dahl_force": force, "dahl_stiffness": force / shape["travel"]}

    def sensible(self, values: Mapping[str, float], deviations: Mapping[str, float]) -> str:
        """Return why ``values`` make no sense: a contact gives by some travel before it slides."""
        if values["dahl_force"] < SHORTEST * values["dahl_stiffness"]:
            return "it slides after no travel: that is Coulomb friction"
        return super().sensible(values, deviations)


@compiled
def dahl_state(displacement: Array, travel: float) -> Array:
    """Return Dahl's state, -1 to 1, along ``displacement`` (m) for the ``travel`` (m) it builds up over."""
    state = np.zeros(displacement.size)
    for index in range(1, displacement.size):
        moved = displacement[index] - displacement[index - 1]
        side = math.copysign(1.0, moved)
        state[index] = side + (state[index - 1] - side) * math.exp(-side * moved / travel)
    return state
