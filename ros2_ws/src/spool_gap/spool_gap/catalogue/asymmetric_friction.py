"""One constant friction force for each direction."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from spool_gap.effect import Array, Effect, Motion


class AsymmetricFriction(Effect):
    """Two jumps of different height: to a moving spool their difference is a constant push."""

    id = "asymmetric_friction"
    terms = ("asymmetric_friction",)
    replaces = ("coulomb_friction",)
    fitted = ("forward_force", "backward_force")
    searched = False
    load_cell_zero = True
    confusable_with = ("coulomb_friction",)
    distinguished_by = "the start of the motion from rest: two accelerometers see the difference only there"

    def signature(self, motion: Motion, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return the sign of the velocity, and 1 for the difference."""
        return np.array([motion.sign, np.abs(motion.sign)])

    def values(
        self,
        coefficients: Array,
        shape: Mapping[str, float],  # noqa: ARG002
        motion: Motion,  # noqa: ARG002
    ) -> dict[str, float] | None:
        """Return both forces."""
        mean, half = coefficients.tolist()
        if mean <= 0.0:
            return None
        half = float(np.clip(half, -0.9 * mean, 0.9 * mean))
        return {"forward_force": mean + half, "backward_force": mean - half}

    def starts(self, values: Mapping[str, float], reach: float) -> list[dict[str, float]]:  # noqa: ARG002
        """Return a start to both sides: the regression does not see the difference."""
        mean = 0.5 * (values["forward_force"] + values["backward_force"])
        return [
            {"forward_force": (1.0 + side) * mean, "backward_force": (1.0 - side) * mean}
            for side in (0.3, -0.3)
        ]

    def sensible(self, values: Mapping[str, float], deviations: Mapping[str, float]) -> str:
        """Return why ``values`` make no sense: the two forces must differ."""
        difference = abs(values["forward_force"] - values["backward_force"])
        if difference < 4.0 * max(deviations.get(name, 0.0) for name in self.fitted):
            return "the two forces do not differ significantly"
        return ""
