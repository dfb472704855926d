"""Play of the springs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from spool_gap.effect import Array, Effect, Motion, scan


class SpringBacklash(Effect):
    """The spring force is missing within a dead zone."""

    id = "spring_backlash"
    terms = ("spring_backlash",)
    fitted = ("backlash",)
    amplitudes = ("backlash",)
    picture = "displacement"
    local_minima = True
    confusable_with = ("cubic_stiffness", "spring_preload", "presliding_friction")
    distinguished_by = "amplitudes from below the dead zone to the stroke"

    def shapes(self, motion: Motion) -> list[dict[str, float]]:
        """Return the shapes to try."""
        largest = motion.largest_displacement
        return [{"backlash": play} for play in scan(3e-3 * largest, 0.7 * largest, 12)]

    def signature(self, motion: Motion, shape: Mapping[str, float]) -> Array:
        """Return the missing spring force for a row of dead zones."""
        return np.clip(motion.displacement, -shape["backlash"], shape["backlash"])[np.newaxis]

    def values(
        self,
        coefficients: Array,
        shape: Mapping[str, float],
        motion: Motion,
    ) -> dict[str, float] | None:
        """Return the play; the force within it must be the spring's, with the opposite sign."""
        share = -float(coefficients[0]) / motion.stiffness
        if share <= 0.1:
            return None
        return {"backlash": shape["backlash"] * min(share, 1.5)}
