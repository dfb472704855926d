"""Drag of the oil, and pushes from outside."""

from __future__ import annotations

import math

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term

VISCOUS_COEFFICIENT = Parameter(
    "viscous_coefficient", "N s/m", 0.0, 1e6, 8.2, "pi d l mu / h", "likely_viscous_coefficient"
)
#: s, time constant beyond which the course of any record is a straight line.
LINE = 1e7


@compiled
def viscous(v: float, viscous_coefficient: float) -> float:
    return viscous_coefficient * v


VISCOUS_FRICTION = Term(
    name="viscous_friction",
    parameters=(VISCOUS_COEFFICIENT,),
    law="F = c z', c = pi d l mu / h",
    source="equations (4), (5), (7), (12) and (29), second term",
    meaning="oil sheared in the annular gap; follows viscosity and temperature",
    check="oil temperature and grade, then the radial clearance",
    dissipates=True,
    force_law=viscous,
)


@compiled
def quadratic(v: float, quadratic_coefficient: float) -> float:
    return quadratic_coefficient * v * abs(v)


QUADRATIC_DAMPING = Term(
    name="quadratic_damping",
    parameters=(
        Parameter(
            "quadratic_coefficient", "N s^2/m^2", 0.0, 1e8, 5.0, "force over the square of the velocity"
        ),
    ),
    law="F = d z' abs(z')",
    source="turbulent orifice flow",
    meaning="oil displaced from the spring chambers through a narrow passage",
    check="drain and damping orifices, oil level in the chambers",
    dissipates=True,
    force_law=quadratic,
)


@compiled
def drift(
    v: float, t: float, viscous_coefficient: float, damping_drift_rate: float, damping_drift_time: float
) -> float:
    course = -damping_drift_time * math.expm1(-t / damping_drift_time)
    return viscous_coefficient * max(-1.0, damping_drift_rate * course) * v


DAMPING_DRIFT = Term(
    name="damping_drift",
    parameters=(
        VISCOUS_COEFFICIENT,
        Parameter("damping_drift_rate", "1/s", -100.0, 100.0, -0.01, "relative change per second at t = 0"),
        Parameter(
            "damping_drift_time", "s", 1.0, LINE, LINE, "time constant; the largest is a line", held=True
        ),
    ),
    law="F = c max(-1, r T (1 - exp(-t/T))) z': with the viscous term never below 0; r t for large T",
    source="(12) with a viscosity that runs away from its value at t = 0",
    meaning="oil that warms up or cools down, or thins",
    check="oil temperature over the record",
    dissipates=True,
    dissipates_with="viscous_friction",
    force_law=drift,
)


@compiled
def constant(push: float) -> float:
    return -push


CONSTANT_FORCE = Term(
    name="constant_force",
    parameters=(Parameter("push", "N", -1e6, 1e6, 1.0, "force in the direction of positive z"),),
    law="F = -F_0",
    source="a force on the spool, hence the minus sign in the balance",
    meaning="gravity on an upright spool, flow force, residual magnetism, pressure on one side",
    check="mounting position, leakage, solenoid",
    conserves=True,
    odd=False,
    force_law=constant,
)


@compiled
def periodic(t: float, force_frequency: float, force_amplitude: float, force_phase: float) -> float:
    turns = force_frequency * t
    return -force_amplitude * math.sin(2.0 * math.pi * (turns - math.floor(turns)) + force_phase)


PERIODIC_FORCE = Term(
    name="periodic_force",
    parameters=(
        Parameter("force_frequency", "Hz", 0.0, 1e5, 50.0, "frequency"),
        Parameter("force_amplitude", "N", 0.0, 1e6, 1.0, "peak"),
        Parameter("force_phase", "rad", -100.0, 100.0, 0.0, "phase at t = 0"),
    ),
    law="F = -A sin(2 pi f t + phi)",
    source="a force on the spool, hence the minus sign in the balance",
    meaning="pump pulsation, dither of the solenoid, mains hum",
    check="pressure pulsation and solenoid current at that frequency",
    odd=False,
    force_law=periodic,
)
