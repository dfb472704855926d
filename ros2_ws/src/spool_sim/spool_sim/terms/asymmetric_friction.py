"""Asymmetric Coulomb friction law."""

from __future__ import annotations

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term


@compiled
def sliding_law(
    z: float,  # noqa: ARG001
    speed: float,  # noqa: ARG001
    direction: float,
    forward_force: float,
    backward_force: float,
) -> float:
    """Return the friction while slipping, N."""
    return forward_force if direction > 0.0 else backward_force


class AsymmetricFrictionTerm(Term):
    """One constant force for each direction of motion."""

    name = "asymmetric_friction"
    parameters = (
        Parameter("forward_force", "N", 0.0, 1e4, 0.6, "friction force while z' > 0"),
        Parameter("backward_force", "N", 0.0, 1e4, 0.4, "friction force while z' < 0"),
    )
    law = "F = F_forward for z' > 0, -F_backward for z' < 0, between them at rest"
    source = "Coulomb's law with a force per direction"
    meaning = "tilted spool, burr or one-sided seal"
    check = "burrs on the edges, tilt, seal lips"
    dissipates = True
    odd = False
