"""Viscous drag that changes with time."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from spool_gap.effect import Array, Effect, Motion

#: Change of the damping over a record below which nothing is wrong: a tenth of a kelvin of the oil does more.
TRIFLE = 5e-3


class DampingDrift(Effect):
    """Drag in proportion to time."""

    id = "damping_drift"
    terms = ("damping_drift",)
    fitted = ("damping_drift_rate",)
    amplitudes = ("damping_drift_rate",)
    picture = "time"
    follows_time = True
    confusable_with = ("quadratic_damping",)
    distinguished_by = "the same excitation at the beginning and at the end of the record"

    def signature(self, motion: Motion, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return the velocity times the time."""
        return (motion.time * motion.velocity)[np.newaxis]

    def values(
        self,
        coefficients: Array,
        shape: Mapping[str, float],  # noqa: ARG002
        motion: Motion,
    ) -> dict[str, float] | None:
        """Return the relative rate."""
        rate = float(coefficients[0]) / max(motion.damping, 1e-9)
        return {"damping_drift_rate": rate}

    def trifling(self, values: Mapping[str, float], seconds: float) -> bool:
        """Whether the drag changes by less than any oil's temperature does to it."""
        return abs(values["damping_drift_rate"]) * seconds < TRIFLE
