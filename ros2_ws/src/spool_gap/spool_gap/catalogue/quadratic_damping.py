"""Drag with the square of the velocity."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from spool_gap.effect import Array, Effect, Motion


class QuadraticDamping(Effect):
    """A force that grows with v abs(v)."""

    id = "quadratic_damping"
    terms = ("quadratic_damping",)
    fitted = ("quadratic_coefficient",)
    amplitudes = ("quadratic_coefficient",)
    positive = True
    confusable_with = ("coulomb_friction", "damping_drift")
    distinguished_by = "several amplitudes, in a wide band"

    def signature(self, motion: Motion, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return v abs(v)."""
        return np.asarray((motion.velocity * np.abs(motion.velocity))[np.newaxis])
