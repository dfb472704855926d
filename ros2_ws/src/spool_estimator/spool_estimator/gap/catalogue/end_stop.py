"""Contact at the ends of the stroke."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..effect import Array, Effect, Motion


class EndStop(Effect):
    """A stiff force beyond a clearance, near the largest displacement only."""

    id = "end_stop"
    terms = ("end_stop",)
    fitted = ("stop_gap", "stop_stiffness", "stop_dissipation")
    picture = "displacement"
    confused_with = ("cubic_stiffness",)
    told_by = "an amplitude that reaches the stop, and one that does not"

    def shapes(self, motion: Motion) -> list[dict[str, float]]:
        """Return the shapes to try."""
        largest = motion.largest_displacement
        shares = (0.55, 0.65, 0.75, 0.82, 0.88, 0.92, 0.95, 0.97, 0.985)
        return [{"stop_gap": share * largest} for share in shares]

    def signature(self, motion: Motion, shape: Mapping[str, float]) -> Array:
        """Return the depth beyond a row of clearances, and the loss in the contact."""
        depth = np.maximum(np.abs(motion.displacement) - shape["stop_gap"], 0.0)
        return np.asarray((np.sign(motion.displacement) * depth)[np.newaxis])

    def values(
        self,
        coefficients: Array,
        shape: Mapping[str, float],
        motion: Motion,  # noqa: ARG002
    ) -> dict[str, float] | None:
        """Return clearance and contact stiffness."""
        if coefficients[0] <= 0.0:
            return None
        return {**shape, "stop_stiffness": float(coefficients[0]), "stop_dissipation": 0.3}

    def starts(self, values: Mapping[str, float]) -> list[dict[str, float]]:
        """Return several contact laws: the regression smooths a contact that lasts few samples."""
        gap, stiffness = values["stop_gap"], values["stop_stiffness"]
        return [
            {"stop_gap": share * gap, "stop_stiffness": factor * stiffness, "stop_dissipation": loss}
            for share, factor, loss in (
                (1.0, 1.0, 0.3), (1.0, 5.0, 0.3), (1.0, 30.0, 0.3), (1.02, 30.0, 2.0), (1.03, 100.0, 2.0),
                (0.98, 5.0, 1.0), (1.05, 300.0, 1.0), (0.99, 100.0, 1.0), (0.97, 30.0, 0.3),
            )
        ]  # fmt: skip

    @property
    def amplitudes(self) -> tuple[str, ...]:
        """Parameters that are 0 where the effect is absent."""
        return ("stop_stiffness",)
