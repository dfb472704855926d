"""Newton's viscous drag in the gap."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .base import Array, Parameter, Term


class ViscousFriction(Term):
    """Drag in proportion to the relative velocity."""

    name = "viscous_friction"
    parameters = (
        Parameter("viscous_coefficient", "N s/m", 0.0, 1e5, 8.2, "pi d l mu / h", "viscous_coefficient"),
    )
    law = "F = c z'"
    source = "equations (7), (10) to (12) and (29), second term"
    meaning = "oil sheared in the annular gap; follows viscosity and temperature"

    def force(
        self,
        displacement: Array,  # noqa: ARG002
        velocity: Array,
        acceleration: Array,  # noqa: ARG002
        values: Mapping[str, float],
    ) -> Array:
        """Return the force, N, shape (n,)."""
        return np.asarray(values["viscous_coefficient"] * velocity)
