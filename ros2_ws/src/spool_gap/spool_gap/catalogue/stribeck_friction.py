"""Dry friction that falls with speed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from spool_gap.effect import Array, Effect, Motion, scan

#: Share of the force at speed by which the force at rest exceeds it at least: less is Coulomb friction.
LEAST_EXCESS = 0.1


class StribeckFriction(Effect):
    """A jump at reversals that is larger at low speed."""

    id = "stribeck_friction"
    terms = ("stribeck_friction",)
    replaces = ("coulomb_friction",)
    fitted = ("coulomb_force", "static_force", "stribeck_velocity", "stribeck_exponent")
    may_vanish = ("coulomb_force", "stribeck_exponent")
    confusable_with = ("coulomb_friction", "mixed_friction")
    distinguished_by = "low speeds and sticking: small amplitudes, low frequencies"

    def shapes(self, motion: Motion) -> list[dict[str, float]]:
        """Return the shapes to try."""
        largest = motion.largest_velocity
        return [
            {"stribeck_velocity": velocity, "stribeck_exponent": exponent}
            for velocity in scan(0.02 * largest, 0.6 * largest, 10)
            for exponent in (1.0, 2.0)
        ]

    def signature(self, motion: Motion, shape: Mapping[str, float]) -> Array:
        """Return the sign, and the sign at low speed for a row of Stribeck velocities."""
        ratio = np.abs(motion.velocity) / shape["stribeck_velocity"]
        low = np.exp(-(ratio ** shape["stribeck_exponent"]))
        return np.array([motion.sign, motion.sign * low])

    def values(
        self,
        coefficients: Array,
        shape: Mapping[str, float],
        motion: Motion,  # noqa: ARG002
    ) -> dict[str, float] | None:
        """Return both forces and the velocity."""
        coulomb, excess = coefficients.tolist()
        if excess <= 0.0 or coulomb + excess <= 0.0:
            return None
        return {
            "coulomb_force": max(coulomb, 0.02 * excess),
            "static_force": max(coulomb, 0.02 * excess) + excess,
            **shape,
        }

    def speeds_to_try(self, fastest: float) -> list[dict[str, float]]:
        """Return choices of the Stribeck velocity."""
        return [{"stribeck_velocity": velocity} for velocity in scan(0.02 * fastest, 0.6 * fastest, 6)]

    def acting_like(self, contained: Mapping[str, float]) -> dict[str, float]:
        """Return a static force that exceeds Coulomb friction a little."""
        force = contained["coulomb_force"]
        return {"coulomb_force": 0.9 * force, "static_force": 1.2 * force, "stribeck_exponent": 1.0}

    def sensible(self, values: Mapping[str, float], deviations: Mapping[str, float]) -> str:
        """Return why ``values`` make no sense: friction at rest must exceed friction at speed."""
        excess = values["static_force"] - values["coulomb_force"]
        least = max(3.0 * deviations.get("static_force", 0.0), LEAST_EXCESS * values["coulomb_force"])
        if excess < least:
            return "the force at rest does not significantly exceed the force at speed"
        return ""
