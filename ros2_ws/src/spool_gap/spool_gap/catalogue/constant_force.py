"""A push that does not depend on the motion."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from spool_gap.effect import Array, Effect, Motion


class ConstantForce(Effect):
    """A force that is always there; two accelerometers cannot see it."""

    id = "constant_force"
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
