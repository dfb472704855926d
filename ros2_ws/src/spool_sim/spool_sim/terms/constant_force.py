"""Constant force on the spool."""

from __future__ import annotations

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term


@compiled
def force_law(
    z: float,  # noqa: ARG001
    v: float,  # noqa: ARG001
    t: float,  # noqa: ARG001
    push: float,
) -> float:
    """Return the force, N."""
    return -push


class ConstantForceTerm(Term):
    """A push that does not depend on the motion."""

    name = "constant_force"
    parameters = (Parameter("push", "N", -1e5, 1e5, 1.0, "force in the direction of positive z"),)
    law = "F = -F_0"
    source = "a force on the spool, hence the minus sign in the balance"
    meaning = "gravity on an upright spool, flow force, residual magnetism, pressure on one side"
    check = "mounting position, leakage, solenoid"
    conserves = True
    odd = False
