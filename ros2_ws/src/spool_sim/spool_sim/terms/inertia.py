"""Inertia of the moving mass."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from spool_core.numbers import Array

from spool_sim.terms.base import Parameter, Term


class InertiaTerm(Term):
    """The moving mass times the spool's own acceleration."""

    name = "inertia"
    parameters = (
        Parameter("mass", "kg", 1e-4, 1e3, 0.18, "spool + oil + 1/3 of the springs", "moving_mass"),
    )
    law = "F = m (z'' + w'')"
    source = "equations (10) and (29), first term"
    meaning = "the spool with the oil and the part of the springs that move with it"
    check = "the weight of the spool, and that nothing but it moves"

    def force(
        self,
        displacement: Array,  # noqa: ARG002
        velocity: Array,  # noqa: ARG002
        acceleration: Array,
        values: Mapping[str, float],
        time: Array | None = None,  # noqa: ARG002
    ) -> Array:
        """Return the force, N, shape (n,)."""
        return np.asarray(values["mass"] * acceleration)
