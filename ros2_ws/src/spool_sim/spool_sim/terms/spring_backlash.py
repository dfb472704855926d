"""Backlash of the springs."""

from __future__ import annotations

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term


@compiled
def force_law(
    z: float,
    v: float,  # noqa: ARG001
    t: float,  # noqa: ARG001
    spring_stiffness: float,
    backlash: float,
) -> float:
    """Return the force, N."""
    return -spring_stiffness * min(backlash, max(-backlash, z))


@compiled
def levels_law(
    spring_stiffness: float,  # noqa: ARG001
    backlash: float,
) -> tuple[float, float]:
    """Return where the force has its kinks, m."""
    return -backlash, backlash


class SpringBacklashTerm(Term):
    """A dead zone in which the springs do not touch the spool."""

    name = "spring_backlash"
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
        Parameter("backlash", "m", 0.0, 0.1, 1e-4, "half the width of the dead zone"),
    )
    law = "F = -k min(b, max(-b, z)): with the spring term 0 within +-b, k (abs(z) - b) outside"
    source = "dead zone; shares the stiffness of the spring term"
    meaning = "play between spool, spring plates and springs"
    check = "spring seats and plates, length of the springs"
    conserves = True
