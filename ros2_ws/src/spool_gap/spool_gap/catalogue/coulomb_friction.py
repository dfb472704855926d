"""Constant dry friction."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from spool_gap.effect import Array, Effect, Motion


class CoulombFriction(Effect):
    """A jump of the force wherever the velocity changes its sign."""

    id = "coulomb_friction"
    terms = ("coulomb_friction",)
    fitted = ("coulomb_force",)
    amplitudes = ("coulomb_force",)
    positive = True
    may_vanish = ("coulomb_force",)
    confusable_with = (
        "stribeck_friction",
        "mixed_friction",
        "presliding_friction",
        "asymmetric_friction",
        "quadratic_damping",
    )
    distinguished_by = "low speeds and sticking in the record; several amplitudes"

    def signature(self, motion: Motion, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return the sign of the velocity."""
        return motion.sign[np.newaxis]
