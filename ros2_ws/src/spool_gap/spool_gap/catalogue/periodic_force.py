"""A sine from outside."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from spool_estimator.identification.least_squares import Unknown

from spool_gap.effect import Array, Effect, Motion

#: Hz, lowest frequency that is fitted: slower ones are drift.
LOWEST = 0.1


class PeriodicForce(Effect):
    """A line in the residual's spectrum that the excitation does not have."""

    id = "periodic_force"
    terms = ("periodic_force",)
    fitted = ("force_frequency", "force_amplitude", "force_phase")
    amplitudes = ("force_amplitude",)
    scanned = ("force_frequency",)
    picture = "time"
    confusable_with = ()
    distinguished_by = "a record long enough to tell its frequency from the excitation's"

    def unknowns(self, values: Mapping[str, float], seconds: float) -> list[Unknown]:
        """Return its numbers; a line of a record of ``seconds`` is as wide as steps of its frequency."""
        found = {unknown.name: unknown for unknown in super().unknowns(values, seconds)}
        scales = {"force_frequency": 0.05 / seconds, "force_phase": 0.5}
        found |= {name: replace(found[name], scale=size, absolute=True) for name, size in scales.items()}
        found["force_frequency"] = replace(found["force_frequency"], low=LOWEST)
        return list(found.values())

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
