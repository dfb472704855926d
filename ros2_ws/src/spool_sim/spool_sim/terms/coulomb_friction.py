"""Coulomb's dry friction."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .base import Array, Parameter, Term


class CoulombFriction(Term):
    """A constant force against the motion; any force up to it at rest."""

    name = "coulomb_friction"
    parameters = (
        Parameter(
            "coulomb_force", "N", 0.0, 1e4, 0.5, "friction force while slipping, largest force at rest"
        ),
    )
    law = "F = F_c Sgn(z'), Sgn(0) = [-1, 1]"
    source = "set-valued form of Coulomb's law; the constant part of equations (24) to (28)"
    meaning = "solid contact of spool and bore: wear, dirt, side load"

    def force(
        self,
        displacement: Array,  # noqa: ARG002
        velocity: Array,
        acceleration: Array,  # noqa: ARG002
        values: Mapping[str, float],
    ) -> Array:
        """Return the force, N, shape (n,)."""
        return np.asarray(values["coulomb_force"] * np.sign(velocity))
