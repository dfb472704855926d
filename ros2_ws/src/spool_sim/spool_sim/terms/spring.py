"""Centring springs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .base import Array, Parameter, Term


class Spring(Term):
    """A linear spring between spool and body."""

    name = "spring"
    parameters = (
        Parameter(
            "spring_stiffness",
            "N/m",
            1.0,
            1e8,
            1632.0,
            "equivalent of both centring springs",
            "spring_stiffness",
        ),
    )
    law = "F = k z"
    source = "equation (29), third term: c_sz (x_su - w)"
    meaning = "both centring springs; a lower value is a tired or broken spring"

    def force(
        self,
        displacement: Array,
        velocity: Array,  # noqa: ARG002
        acceleration: Array,  # noqa: ARG002
        values: Mapping[str, float],
    ) -> Array:
        """Return the force, N, shape (n,)."""
        return np.asarray(values["spring_stiffness"] * displacement)
