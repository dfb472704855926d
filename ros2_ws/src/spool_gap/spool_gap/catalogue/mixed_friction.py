"""Contact that falls with speed and drag that rises with its root."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from spool_sim.terms import term

from spool_gap.effect import Array, Effect, Motion

#: m/s, speed that a spool hardly exceeds.
FASTEST = 0.3
#: m/s, choices of gamma_m.
VELOCITIES = (0.003, 0.006, 0.012, 0.025, 0.05)


class MixedFriction(Effect):
    """The paper's model 2: sqrt(abs(v)) and 1/(abs(v) + gamma_m), each with the sign of v."""

    id = "mixed_friction"
    terms = ("mixed_friction",)
    replaces = ("coulomb_friction",)
    fitted = ("mixed_root_coefficient", "mixed_inverse_coefficient", "mixed_velocity")
    amplitudes = ("mixed_inverse_coefficient",)
    may_vanish = ("mixed_root_coefficient", "mixed_velocity")
    confusable_with = ("stribeck_friction", "coulomb_friction")
    distinguished_by = "a wide range of speeds: several amplitudes, from sticking to fast slip"

    def shapes(self, motion: Motion) -> list[dict[str, float]]:  # noqa: ARG002
        """Return the shapes to try."""
        return [{"mixed_velocity": velocity} for velocity in VELOCITIES]

    def speeds_to_try(self, fastest: float) -> list[dict[str, float]]:  # noqa: ARG002
        """Return choices of the velocity."""
        return [{"mixed_velocity": velocity} for velocity in VELOCITIES]

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

    def acting_like(self, contained: Mapping[str, float]) -> dict[str, float]:
        """Return contacts that hardly fall with speed."""
        load = next(p.start for p in term("mixed_friction").parameters if p.name == "normal_load")
        share = 0.2 * contained["coulomb_force"] / load
        return {"mixed_root_coefficient": 0.0, "mixed_inverse_coefficient": share, "mixed_velocity": 0.2}

    def sensible(self, values: Mapping[str, float], deviations: Mapping[str, float]) -> str:
        """Return why ``values`` make no sense: contacts must fall with speed at the speeds of a spool."""
        if values["mixed_velocity"] > FASTEST:
            return "the contact part hardly falls with speed: that is Coulomb friction"
        return super().sensible(values, deviations)
