"""Warm-up: compile the kernels of analyses now, so that the first of each waits for none.

Run as ``python -m spool_gap.warm_up``: what `simulate`, `fit`, `compare` and `gap` run of the models by name.
"""

from __future__ import annotations

from spool_sim.integration.composed_motion import ComposedMotion
from spool_sim.model import MODELS

from spool_gap.likelihood.kernel import motions_for


def warm_up_analyses() -> None:
    """Compile the kernel of each model by name, and those in which a search switches terms."""
    for motion in (*motions_for(MODELS["fluid"]), *(ComposedMotion(one.terms) for one in MODELS.values())):
        motion.warm_up()


if __name__ == "__main__":
    warm_up_analyses()
