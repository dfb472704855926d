"""A sine from outside."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from spool_gap.effect import Array, Effect, Motion


class PeriodicForce(Effect):
    """A line in the residual's spectrum that the drive does not have."""

    id = "periodic_force"
    terms = ("periodic_force",)
    fitted = ("force_frequency", "force_amplitude", "force_phase")
    picture = "time"
    confused_with = ()
    told_by = "a record long enough to tell its frequency from the drive's"

    def shapes(self, motion: Motion) -> list[dict[str, float]]:
        """Return the shapes to try."""
        return [{"force_frequency": frequency} for frequency in motion.peaks]

    def signature(self, motion: Motion, shape: Mapping[str, float]) -> Array:
        """Return sine and cosine at the frequencies that stand out."""
        angle = 2.0 * np.pi * shape["force_frequency"] * motion.time
        return -np.array([np.sin(angle), np.cos(angle)])

    def values(
        self,
        coefficients: Array,
        shape: Mapping[str, float],
        motion: Motion,  # noqa: ARG002
    ) -> dict[str, float] | None:
        """Return amplitude and phase."""
        sine, cosine = coefficients.tolist()
        return {
            **shape,
            "force_amplitude": float(np.hypot(sine, cosine)),
            "force_phase": float(np.arctan2(cosine, sine)),
        }

    @property
    def amplitudes(self) -> tuple[str, ...]:
        """Parameters that are 0 where the effect is absent."""
        return ("force_amplitude",)
