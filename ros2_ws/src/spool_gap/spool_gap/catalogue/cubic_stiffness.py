"""A spring that hardens or softens."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from spool_gap.effect import Array, Effect, Motion


class CubicStiffness(Effect):
    """A force that grows with the cube of the displacement."""

    id = "cubic_stiffness"
    terms = ("cubic_stiffness",)
    fitted = ("cubic_coefficient",)
    amplitudes = ("cubic_coefficient",)
    picture = "displacement"
    confusable_with = ("end_stop", "spring_backlash", "spring_preload")
    distinguished_by = "amplitudes from small to the whole stroke"

    def signature(self, motion: Motion, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return z^3."""
        return (motion.displacement**3)[np.newaxis]
