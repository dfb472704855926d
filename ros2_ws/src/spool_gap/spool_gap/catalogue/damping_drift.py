"""Viscous drag that changes with time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from spool_estimator.identification.least_squares import Unknown
from spool_sim.terms.damping_drift import LINE

from spool_gap.effect import Array, Effect, Motion

#: Change of the damping over a record below which nothing is wrong: a tenth of a kelvin of the oil does more.
TRIFLE = 5e-3
#: Time constants of oil that warms, over the record's length: longer ones are a line, shorter ones soon over.
COURSES = (0.15, 0.5)


class DampingDrift(Effect):
    """Drag that changes by a line over time, or by the exponential course of oil that warms."""

    id = "damping_drift"
    terms = ("damping_drift",)
    fitted = ("damping_drift_rate", "damping_drift_time")
    amplitudes = ("damping_drift_rate",)
    picture = "time"
    follows_time = True
    confusable_with = ("quadratic_damping",)
    distinguished_by = "the same excitation at the beginning and at the end of the record"

    def shapes(self, motion: Motion) -> list[dict[str, float]]:
        """Return a line, and courses that bend within the record."""
        seconds = float(motion.time.max() - motion.time.min())
        bent = [{"damping_drift_time": max(1.0, share * seconds)} for share in COURSES]
        return [{"damping_drift_time": LINE}, *bent]

    def signature(self, motion: Motion, shape: Mapping[str, float]) -> Array:
        """Return the velocity times the course over time."""
        constant = shape["damping_drift_time"]
        return (-constant * np.expm1(-motion.time / constant) * motion.velocity)[np.newaxis]

    def values(
        self,
        coefficients: Array,
        shape: Mapping[str, float],
        motion: Motion,
    ) -> dict[str, float] | None:
        """Return the relative rate, and the time constant."""
        rate = float(coefficients[0]) / max(motion.damping, 1e-9)
        return {**shape, "damping_drift_rate": rate}

    def unknowns(self, values: Mapping[str, float], seconds: float) -> list[Unknown]:
        """Return the rate, and the time constant where the course is no line over ``seconds``."""
        rate, constant = super().unknowns(values, seconds)
        if values.get("damping_drift_time", LINE) >= LINE:
            return [rate]
        return [rate, replace(constant, low=1.0, high=3.0 * seconds, scale=0.3 * seconds)]

    def trifling(self, values: Mapping[str, float], seconds: float) -> bool:
        """Whether the drag changes by less than any oil's temperature does to it."""
        constant = values.get("damping_drift_time", LINE)
        course = -constant * np.expm1(-seconds / constant)
        return bool(abs(values["damping_drift_rate"]) * course < TRIFLE)
