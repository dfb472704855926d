"""Preload of the springs against shoulders."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from spool_gap.effect import Array, Effect, Motion, scan


class SpringPreload(Effect):
    """A force towards the centre that is there as soon as the spool leaves it."""

    id = "spring_preload"
    terms = ("spring_preload",)
    may_vanish = ("preload_travel",)
    fitted = ("preload_force", "preload_travel")
    amplitudes = ("preload_force",)
    positive = True
    picture = "displacement"
    local_minima = True
    confusable_with = ("cubic_stiffness", "spring_backlash")
    distinguished_by = "amplitudes from below the give of the seats to the stroke"

    def shapes(self, motion: Motion) -> list[dict[str, float]]:
        """Return the shapes to try."""
        largest = motion.largest_displacement
        return [{"preload_travel": travel} for travel in scan(1e-3 * largest, 0.3 * largest, 9)]

    def signature(self, motion: Motion, shape: Mapping[str, float]) -> Array:
        """Return the force for a row of travels over which it builds up."""
        return np.clip(motion.displacement / shape["preload_travel"], -1.0, 1.0)[np.newaxis]
