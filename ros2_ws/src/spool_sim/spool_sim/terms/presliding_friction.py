"""Dahl pre-sliding friction law."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from spool_core.kernels.compiled import compiled
from spool_core.numbers import Array

from spool_sim.terms.base import Parameter, Term


@compiled
def memory_law(
    force: float, slip: float, direction: float, dahl_force: float, dahl_stiffness: float
) -> float:
    """Return the force after slipping on by ``slip`` m, N: dF/dz = sigma_0 (1 - F/F_c sgn(z'))."""
    limit = direction * dahl_force
    return limit + (force - limit) * math.exp(-dahl_stiffness / dahl_force * direction * slip)


class PreslidingFrictionTerm(Term):
    """It builds up over a small travel after each reversal; its force is the state."""

    name = "presliding_friction"
    parameters = (
        Parameter("dahl_force", "N", 1e-6, 1e4, 0.5, "F_c: friction force after some travel"),
        Parameter("dahl_stiffness", "N/m", 1.0, 1e9, 5e4, "sigma_0: stiffness at the start of a slip"),
    )
    law = "dF/dz = sigma_0 (1 - F/F_c sgn(z'))"
    source = "Dahl's law with exponent 1, solved in closed form between reversals"
    meaning = "contacts and deposits that give a little before they slide"
    check = "varnish on the lands, seals, time at rest"
    # Within one pre-sliding loop part of the force is elastic: it gives work back before the loop closes.
    dissipates = False

    def force(
        self,
        displacement: Array,
        velocity: Array,  # noqa: ARG002
        acceleration: Array,  # noqa: ARG002
        values: Mapping[str, float],
        time: Array | None = None,  # noqa: ARG002
    ) -> Array:
        """Return the force, N, shape (n,), from zero at the first sample on; reversals fall on samples."""
        total = np.zeros(displacement.size)
        for index, slip in enumerate(np.diff(displacement).tolist()):
            side = math.copysign(1.0, slip)
            total[index + 1] = memory_law(
                total[index], slip, side, values["dahl_force"], values["dahl_stiffness"]
            )
        return total
