"""Periodic force on the spool."""

from __future__ import annotations

import math

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term


@compiled
def force_law(
    z: float,  # noqa: ARG001
    v: float,  # noqa: ARG001
    t: float,
    force_frequency: float,
    force_amplitude: float,
    force_phase: float,
) -> float:
    """Return the force, N."""
    turns = force_frequency * t
    return -force_amplitude * math.sin(2.0 * math.pi * (turns - math.floor(turns)) + force_phase)


class PeriodicForceTerm(Term):
    """A sine at one frequency, independent of the body."""

    name = "periodic_force"
    parameters = (
        Parameter("force_frequency", "Hz", 0.0, 1e5, 50.0, "frequency"),
        Parameter("force_amplitude", "N", 0.0, 1e5, 1.0, "peak"),
        Parameter("force_phase", "rad", -100.0, 100.0, 0.0, "phase at t = 0"),
    )
    law = "F = -A sin(2 pi f t + phi)"
    source = "a force on the spool, hence the minus sign in the balance"
    meaning = "pump pulsation, dither of the solenoid, mains hum"
    check = "pressure pulsation and solenoid current at that frequency"
    odd = False
