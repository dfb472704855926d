"""Drag that grows or drifts, and pushes from outside."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from spool_core.numbers import Array
from spool_estimator.identification.least_squares import Unknown
from spool_sim.terms.drag_and_pushes import LINE

from spool_gap.effect import Effect, Motion, Scale

#: Time constants of oil that warms, over the record's length: longer ones are a line, shorter ones soon over.
COURSES = (0.15, 0.5)
#: Changes of the drag, relative, that are tried.
CHANGES = (0.2, -0.2, 1.0, -0.6)
#: Change of the drag along a bent course, relative, that no oil makes within a record: 60 K do that.
IMPOSSIBLE = 10.0
#: Hz, lowest frequency that is fitted: slower ones are drift.
LOWEST = 0.1


class QuadraticDamping(Effect):
    """A force that grows with v abs(v)."""

    id = "quadratic_damping"
    group = "drag and oil"
    terms = ("quadratic_damping",)
    fitted = ("quadratic_coefficient",)
    amplitudes = ("quadratic_coefficient",)
    positive = True
    confusable_with = ("coulomb_friction", "damping_drift")
    distinguished_by = "several amplitudes, in a wide band"

    def unit(self, scale: Scale) -> float:
        """Return the coefficient whose force is that of ``scale``."""
        return scale.force / scale.speed**2

    def signature(self, motion: Motion, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return v abs(v)."""
        return np.asarray((motion.velocity * np.abs(motion.velocity))[np.newaxis])


class DampingDrift(Effect):
    """Drag that changes by a line over time, or by the exponential course of oil that warms."""

    id = "damping_drift"
    group = "drag and oil"
    terms = ("damping_drift",)
    fitted = ("damping_drift_rate", "damping_drift_time")
    amplitudes = ("damping_drift_rate",)
    picture = "time"
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
        self, coefficients: Array, shape: Mapping[str, float], motion: Motion
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

    def guesses(self, scale: Scale) -> list[dict[str, float]]:
        """Return lines, and courses that bend within the record, by which the drag changes in it."""
        found = [
            {"damping_drift_rate": change / scale.seconds, "damping_drift_time": LINE} for change in CHANGES
        ]
        for time in (max(1.0, share * scale.seconds) for share in COURSES):
            found += [{"damping_drift_rate": change / time, "damping_drift_time": time} for change in CHANGES]
        return found

    def sensible(self, values: Mapping[str, float], deviations: Mapping[str, float]) -> str:
        """Return why ``values`` make no sense: no oil changes its drag tenfold within a record."""
        constant = values.get("damping_drift_time", LINE)
        if constant < LINE and abs(values["damping_drift_rate"]) * constant > IMPOSSIBLE:
            return f"the drag changes by a factor of more than {IMPOSSIBLE:g}"
        return super().sensible(values, deviations)


class PeriodicForce(Effect):
    """A line in the residual's spectrum that the excitation does not have."""

    id = "periodic_force"
    group = "excitation"
    terms = ("periodic_force",)
    fitted = ("force_frequency", "force_amplitude", "force_phase")
    amplitudes = ("force_amplitude",)
    scanned = ("force_frequency",)
    picture = "time"
    confusable_with = ()
    distinguished_by = "a record long enough to distinguish its frequency from the excitation's"

    def unknowns(self, values: Mapping[str, float], seconds: float) -> list[Unknown]:
        """Return its numbers; a line of a record of ``seconds`` is as wide as steps of its frequency."""
        found = {unknown.name: unknown for unknown in super().unknowns(values, seconds)}
        scales = {"force_frequency": 0.05 / seconds, "force_phase": 0.5}
        found |= {name: replace(found[name], scale=size, absolute=True) for name, size in scales.items()}
        found["force_frequency"] = replace(found["force_frequency"], low=LOWEST)
        return list(found.values())

    def guesses(self, scale: Scale) -> list[dict[str, float]]:
        """Return the lines that stand out of what the base leaves."""
        return [dict(zip(self.fitted, peak, strict=True)) for peak in scale.peaks]

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


class ConstantForce(Effect):
    """A force that is always there; two accelerometers cannot see it."""

    id = "constant_force"
    group = "spring and play"
    kinds = ("driven", "imposed")
    terms = ("constant_force",)
    fitted = ("push",)
    amplitudes = ("push",)
    load_cell_zero = True
    picture = "time"
    confusable_with = ()
    distinguished_by = "a force record"

    def signature(self, motion: Motion, shape: Mapping[str, float]) -> Array:  # noqa: ARG002
        """Return -1 throughout."""
        return -np.ones((1, motion.time.size))
