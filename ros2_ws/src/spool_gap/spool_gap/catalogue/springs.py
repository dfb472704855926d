"""Springs that harden, have play or preload, and stops at the ends of the stroke."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from spool_core.numbers import Array
from spool_estimator.identification.least_squares import Unknown

from spool_gap.effect import Effect, Motion, Scale, scan

#: Stiffness of a contact over that of the spring, at least.
STIFFER = 8.0
#: Dead zones and clearances over the largest travel that are tried.
PLAYS, GAPS = (0.01, 0.04, 0.12, 0.3, 0.6), (0.7, 0.8, 0.86, 0.9, 0.93, 0.95, 0.97, 0.985, 1.0, 1.03)


class CubicStiffness(Effect):
    """A force that grows with the cube of the displacement."""

    id = "cubic_stiffness"
    group = "spring and play"
    terms = ("cubic_stiffness",)
    fitted = ("cubic_coefficient",)
    amplitudes = ("cubic_coefficient",)
    picture = "displacement"
    confusable_with = ("end_stop", "spring_backlash", "spring_preload")
    distinguished_by = "amplitudes from small to the whole stroke"

    def unit(self, scale: Scale) -> float:
        """Return the coefficient whose force is that of ``scale``."""
        return scale.force / scale.travel**3

    def signature(self, motion: Motion, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return z^3."""
        return (motion.displacement**3)[np.newaxis]


class SpringBacklash(Effect):
    """The spring force is missing within a dead zone."""

    id = "spring_backlash"
    group = "spring and play"
    terms = ("spring_backlash",)
    fitted = ("backlash",)
    amplitudes = ("backlash",)
    picture = "displacement"
    local_minima = True
    confusable_with = ("cubic_stiffness", "spring_preload", "presliding_friction")
    distinguished_by = "amplitudes from below the dead zone to the stroke"

    def guesses(self, scale: Scale) -> list[dict[str, float]]:
        """Return dead zones."""
        return [{"backlash": share * scale.travel} for share in PLAYS]

    def shapes(self, motion: Motion) -> list[dict[str, float]]:
        """Return the shapes to try."""
        largest = motion.largest_displacement
        return [{"backlash": play} for play in scan(3e-3 * largest, 0.7 * largest, 12)]

    def signature(self, motion: Motion, shape: Mapping[str, float]) -> Array:
        """Return the missing spring force for a row of dead zones."""
        return np.clip(motion.displacement, -shape["backlash"], shape["backlash"])[np.newaxis]

    def values(
        self, coefficients: Array, shape: Mapping[str, float], motion: Motion
    ) -> dict[str, float] | None:
        """Return the play; the force within it must be the spring's, with the opposite sign."""
        share = -float(coefficients[0]) / motion.stiffness
        if share <= 0.1:
            return None
        return {"backlash": shape["backlash"] * min(share, 1.5)}


class SpringPreload(Effect):
    """A force towards the centre that is there as soon as the spool leaves it."""

    id = "spring_preload"
    group = "spring and play"
    terms = ("spring_preload",)
    fitted = ("preload_force", "preload_travel")
    amplitudes = ("preload_force",)
    positive = True
    picture = "displacement"
    local_minima = True
    confusable_with = ("cubic_stiffness", "spring_backlash")
    distinguished_by = "amplitudes from below the give of the seats to the stroke"

    def guesses(self, scale: Scale) -> list[dict[str, float]]:
        """Return forces, and travels over which they build up."""
        return [
            {"preload_force": share * scale.force, "preload_travel": travel * scale.travel}
            for share in (0.05, 0.2, 0.6)
            for travel in (0.01, 0.06, 0.2)
        ]

    def shapes(self, motion: Motion) -> list[dict[str, float]]:
        """Return the shapes to try."""
        largest = motion.largest_displacement
        return [{"preload_travel": travel} for travel in scan(1e-3 * largest, 0.3 * largest, 9)]

    def signature(self, motion: Motion, shape: Mapping[str, float]) -> Array:
        """Return the force for a row of travels over which it builds up."""
        return np.clip(motion.displacement / shape["preload_travel"], -1.0, 1.0)[np.newaxis]


class EndStop(Effect):
    """A stiff force beyond a clearance, near the largest displacement only."""

    id = "end_stop"
    group = "stop"
    terms = ("end_stop",)
    fitted = ("stop_gap", "stop_stiffness", "stop_dissipation", "stop_damping")
    amplitudes = ("stop_stiffness",)
    localised = True
    picture = "displacement"
    confusable_with = ("cubic_stiffness",)
    distinguished_by = "an amplitude that reaches the stop, and one that does not"

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
        return {
            **shape,
            "stop_stiffness": float(coefficients[0]),
            "stop_dissipation": 0.3,
            "stop_damping": 1.0,
        }

    def guesses(self, scale: Scale) -> list[dict[str, float]]:
        """Return clearances and contact laws: a contact lasts few samples."""
        return [
            {
                "stop_gap": share * scale.travel,
                "stop_stiffness": stiffness,
                "stop_dissipation": loss,
                "stop_damping": 1.0,
            }
            for share in GAPS
            for stiffness in (6e4, 3e5)
            for loss in (0.5, 4.0)
        ]

    def unknowns(self, values: Mapping[str, float], seconds: float) -> list[Unknown]:
        """Return its numbers; what gives way like a spring is no stop."""
        least = STIFFER * values.get("spring_stiffness", 0.0)
        found = super().unknowns(values, seconds)
        return [
            replace(one, low=min(least, one.high)) if one.name == "stop_stiffness" else one for one in found
        ]

    def sensible(self, values: Mapping[str, float], deviations: Mapping[str, float]) -> str:
        """Return why ``values`` make no sense: what gives way like a spring is no stop."""
        if values["stop_stiffness"] <= 1.001 * STIFFER * values.get("spring_stiffness", 0.0):
            return f"stop_stiffness is not even {STIFFER:g} times the spring's"
        return super().sensible(values, deviations)
