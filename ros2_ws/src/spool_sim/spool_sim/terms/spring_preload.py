"""Preload of the centring springs."""

from __future__ import annotations

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term


@compiled
def force_law(
    z: float,
    v: float,  # noqa: ARG001
    t: float,  # noqa: ARG001
    preload_force: float,
    preload_travel: float,
) -> float:
    """Return the force, N."""
    return preload_force * min(1.0, max(-1.0, z / preload_travel))


@compiled
def levels_law(
    preload_force: float,  # noqa: ARG001
    preload_travel: float,
) -> tuple[float, float]:
    """Return where the force has its kinks, m."""
    return -preload_travel, preload_travel


class SpringPreloadTerm(Term):
    """A force towards the centre that is there as soon as the spool leaves it."""

    name = "spring_preload"
    parameters = (
        Parameter("preload_force", "N", 0.0, 1e5, 2.0, "force to leave the centre"),
        Parameter(
            "preload_travel",
            "m",
            1e-6,
            1e-2,
            2e-5,
            "travel over which it builds up: give of plates and seats",
        ),
    )
    law = "F = F_0 min(1, max(-1, z/w)), nearly F_0 sgn(z)"
    source = "springs held by plates that rest on shoulders; the shoulder's give w keeps the force continuous"
    meaning = "springs fitted with preload against shoulders"
    check = "spring length, shims and plates"
    conserves = True
