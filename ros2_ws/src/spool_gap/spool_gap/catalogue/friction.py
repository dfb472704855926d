"""Laws of dry friction: a machine has one of them."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from spool_core.kernels.compiled import compiled
from spool_core.numbers import Array
from spool_sim.terms import term

from spool_gap.effect import SHARES, Effect, Motion, Scale, scan

#: Share of the force at speed by which the force at rest exceeds it at least: less is Coulomb friction.
LEAST_EXCESS = 0.1
#: m/s, speed that a spool hardly exceeds.
FASTEST = 0.3
#: m/s, choices of gamma_m.
VELOCITIES = (0.003, 0.006, 0.012, 0.025, 0.05)
#: Stribeck velocities over the motion's speed, m/s at which contacts fall, and travels before sliding over
#: the motion's that are tried.
SLOW, CONTACTS, TRAVELS = (0.05, 0.2, 0.6), (0.01, 0.05, 0.2), (0.01, 0.06, 0.25)
#: m of travel before sliding below which no record of an accelerometer shows any.
SHORTEST = 1e-7


class CoulombFriction(Effect):
    """A jump of the force wherever the velocity changes its sign."""

    id = "coulomb_friction"
    group = "dry friction"
    terms = ("coulomb_friction",)
    fitted = ("coulomb_force",)
    amplitudes = ("coulomb_force",)
    positive = True
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


class AsymmetricFriction(Effect):
    """Two jumps of different height: to a moving spool their difference is a constant push."""

    id = "asymmetric_friction"
    group = "dry friction"
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

    def sensible(self, values: Mapping[str, float], deviations: Mapping[str, float]) -> str:
        """Return why ``values`` make no sense: the two forces must differ."""
        difference = abs(values["forward_force"] - values["backward_force"])
        if difference < 4.0 * max(deviations.get(name, 0.0) for name in self.fitted):
            return "the two forces do not differ significantly"
        return ""


class StribeckFriction(Effect):
    """A jump at reversals that is larger at low speed."""

    id = "stribeck_friction"
    group = "dry friction"
    terms = ("stribeck_friction",)
    replaces = ("coulomb_friction",)
    fitted = ("coulomb_force", "static_force", "stribeck_velocity", "stribeck_exponent")
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

    def guesses(self, scale: Scale) -> list[dict[str, float]]:
        """Return forces at speed and at rest, and Stribeck velocities."""
        return [
            {
                "coulomb_force": 0.7 * share * scale.force,
                "static_force": 1.3 * share * scale.force,
                "stribeck_velocity": slow * scale.speed,
                "stribeck_exponent": 2.0,
            }
            for share in SHARES
            for slow in SLOW
        ]

    def sensible(self, values: Mapping[str, float], deviations: Mapping[str, float]) -> str:
        """Return why ``values`` make no sense: friction at rest must exceed friction at speed."""
        excess = values["static_force"] - values["coulomb_force"]
        least = max(3.0 * deviations.get("static_force", 0.0), LEAST_EXCESS * values["coulomb_force"])
        if excess < least:
            return "the force at rest does not significantly exceed the force at speed"
        return ""


class MixedFriction(Effect):
    """The paper's model 2: sqrt(abs(v)) and 1/(abs(v) + gamma_m), each with the sign of v."""

    id = "mixed_friction"
    group = "dry friction"
    terms = ("mixed_friction",)
    replaces = ("coulomb_friction",)
    fitted = ("mixed_root_coefficient", "mixed_inverse_coefficient", "mixed_velocity")
    amplitudes = ("mixed_inverse_coefficient",)
    confusable_with = ("stribeck_friction", "coulomb_friction")
    distinguished_by = "a wide range of speeds: several amplitudes, from sticking to fast slip"

    def shapes(self, motion: Motion) -> list[dict[str, float]]:  # noqa: ARG002
        """Return the shapes to try."""
        return [{"mixed_velocity": velocity} for velocity in VELOCITIES]

    def guesses(self, scale: Scale) -> list[dict[str, float]]:
        """Return contacts that fall at some speed, with and without a film's part."""
        load = next(p.start for p in term("mixed_friction").parameters if p.name == "normal_load")
        return [
            {
                "mixed_root_coefficient": film * share * scale.force / load / math.sqrt(scale.speed),
                "mixed_inverse_coefficient": share * scale.force * slow / load,
                "mixed_velocity": slow,
            }
            for share in SHARES
            for slow in CONTACTS
            for film in (0.0, 0.5)
        ]

    def signature(self, motion: Motion, shape: Mapping[str, float]) -> Array:
        """Return both parts for a few velocities gamma_m."""
        speed = np.abs(motion.velocity)
        contact = motion.sign / (speed + shape["mixed_velocity"])
        return np.array([motion.sign * np.sqrt(speed), contact])

    def values(
        self,
        coefficients: Array,
        shape: Mapping[str, float],
        motion: Motion,  # noqa: ARG002
    ) -> dict[str, float] | None:
        """Return C1 and C2 for the normal load of the term."""
        root, inverse = coefficients.tolist()
        if inverse <= 0.0 or root < -0.5 * inverse / 0.01:
            return None
        load = next(p.start for p in term("mixed_friction").parameters if p.name == "normal_load")
        return {
            "mixed_root_coefficient": max(root, 0.0) / load,
            "mixed_inverse_coefficient": inverse / load,
            **shape,
        }

    def sensible(self, values: Mapping[str, float], deviations: Mapping[str, float]) -> str:
        """Return why ``values`` make no sense: contacts must fall with speed at the speeds of a spool."""
        if values["mixed_velocity"] > FASTEST:
            return "the contact part hardly falls with speed: that is Coulomb friction"
        return super().sensible(values, deviations)


class PreslidingFriction(Effect):
    """Dahl's hysteresis: the jump at a reversal is spread over some travel."""

    id = "presliding_friction"
    group = "dry friction"
    terms = ("presliding_friction",)
    replaces = ("coulomb_friction",)
    fitted = ("dahl_force", "dahl_stiffness")
    amplitudes = ("dahl_force",)
    picture = "displacement"
    confusable_with = ("coulomb_friction", "spring_backlash")
    distinguished_by = "motion with amplitudes of the order of the pre-sliding travel"

    def shapes(self, motion: Motion) -> list[dict[str, float]]:
        """Return the shapes to try."""
        largest = motion.largest_displacement
        return [{"travel": travel} for travel in scan(2e-3 * largest, 0.5 * largest, 9)]

    def guesses(self, scale: Scale) -> list[dict[str, float]]:
        """Return forces, and travels over which they build up."""
        return [
            {
                "dahl_force": share * scale.force,
                "dahl_stiffness": share * scale.force / (travel * scale.travel),
            }
            for share in SHARES
            for travel in TRAVELS
        ]

    def signature(self, motion: Motion, shape: Mapping[str, float]) -> Array:
        """Return Dahl's state for a row of travels."""
        return dahl_state(motion.displacement, shape["travel"])[np.newaxis]

    def values(
        self,
        coefficients: Array,
        shape: Mapping[str, float],
        motion: Motion,  # noqa: ARG002
    ) -> dict[str, float] | None:
        """Return force and stiffness."""
        force = float(coefficients[0])
        if force <= 0.0:
            return None
        return {"dahl_force": force, "dahl_stiffness": force / shape["travel"]}

    def sensible(self, values: Mapping[str, float], deviations: Mapping[str, float]) -> str:
        """Return why ``values`` make no sense: a contact gives by some travel before it slides."""
        if values["dahl_force"] < SHORTEST * values["dahl_stiffness"]:
            return "it slides after no travel: that is Coulomb friction"
        return super().sensible(values, deviations)


@compiled
def dahl_state(displacement: Array, travel: float) -> Array:
    """Return Dahl's state, -1 to 1, along ``displacement`` (m) for the ``travel`` (m) it builds up over."""
    state = np.zeros(displacement.size)
    for index in range(1, displacement.size):
        moved = displacement[index] - displacement[index - 1]
        side = math.copysign(1.0, moved)
        state[index] = side + (state[index - 1] - side) * math.exp(-side * moved / travel)
    return state
