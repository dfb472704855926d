"""Mass and springs of the spool, and the stops of its stroke."""

from __future__ import annotations

import math

from spool_core.kernels.compiled import compiled

from spool_sim.terms.base import Parameter, Term

STIFFNESS = Parameter(
    "spring_stiffness", "N/m", 1.0, 1e10, 1632.0, "equivalent of both centring springs", "spring_stiffness"
)


def inertia(acceleration: float, mass: float) -> float:
    return mass * acceleration


INERTIA = Term(
    name="inertia",
    parameters=(Parameter("mass", "kg", 1e-4, 1e5, 0.18, "spool + oil + 1/3 of the springs", "moving_mass"),),
    law="F = m (z'' + w'')",
    source="equations (10) and (29), first term",
    meaning="the spool with the oil and the part of the springs that move with it",
    check="the weight of the spool, and that nothing but it moves",
    inertia_law=inertia,
)


@compiled
def spring(z: float, spring_stiffness: float) -> float:
    return spring_stiffness * z


SPRING = Term(
    name="spring",
    parameters=(STIFFNESS,),
    law="F = k z",
    source="equations (11) and (29), third term: c_sz (x_su - w)",
    meaning="both centring springs; a lower value is a tired or broken spring",
    check="free length and rate of both springs, and that the right ones are fitted",
    conserves=True,
    force_law=spring,
)


@compiled
def cubic(z: float, cubic_coefficient: float) -> float:
    return cubic_coefficient * z * z * z


CUBIC_STIFFNESS = Term(
    name="cubic_stiffness",
    parameters=(
        Parameter(
            "cubic_coefficient", "N/m^3", -1e12, 1e12, 1e7, "force over the third power of the displacement"
        ),
    ),
    law="F = k3 z^3",
    source="Duffing's spring",
    meaning="coils that touch, conical springs, springs at an angle",
    check="coil clearance and seating of the springs",
    conserves=True,
    force_law=cubic,
)


@compiled
def missing_spring(z: float, spring_stiffness: float, backlash: float) -> float:
    return -spring_stiffness * min(backlash, max(-backlash, z))


@compiled
def backlash_levels(backlash: float) -> tuple[float, float]:
    return -backlash, backlash


SPRING_BACKLASH = Term(
    name="spring_backlash",
    parameters=(STIFFNESS, Parameter("backlash", "m", 0.0, 1.0, 1e-4, "half the width of the dead zone")),
    law="F = -k min(b, max(-b, z)): with the spring term 0 within +-b, k (abs(z) - b) outside",
    source="dead zone; shares the stiffness of the spring term",
    meaning="play between spool, spring plates and springs",
    check="spring seats and plates, length of the springs",
    conserves=True,
    force_law=missing_spring,
    levels_law=backlash_levels,
)


@compiled
def preload(z: float, preload_force: float, preload_travel: float) -> float:
    return preload_force * min(1.0, max(-1.0, z / preload_travel))


@compiled
def preload_levels(preload_travel: float) -> tuple[float, float]:
    return -preload_travel, preload_travel


SPRING_PRELOAD = Term(
    name="spring_preload",
    parameters=(
        Parameter("preload_force", "N", 0.0, 1e6, 2.0, "force to leave the centre"),
        Parameter(
            "preload_travel", "m", 1e-6, 0.1, 2e-5, "travel over which it builds up: give of plates and seats"
        ),
    ),
    law="F = F_0 min(1, max(-1, z/w)), nearly F_0 sgn(z)",
    source="springs held by plates that rest on shoulders; the shoulder's give w keeps the force continuous",
    meaning="springs fitted with preload against shoulders",
    check="spring length, shims and plates",
    conserves=True,
    force_law=preload,
    levels_law=preload_levels,
)


@compiled
def stop(
    z: float, v: float, stop_gap: float, stop_stiffness: float, stop_dissipation: float, stop_damping: float
) -> float:
    depth = abs(z) - stop_gap
    if depth <= 0.0:
        return 0.0
    side = math.copysign(1.0, z)
    speed = side * v
    push = stop_stiffness * depth * (1.0 + stop_dissipation * speed) + stop_damping * speed
    return side * max(0.0, push)


@compiled
def stop_levels(stop_gap: float) -> tuple[float, float]:
    return -stop_gap, stop_gap


END_STOP = Term(
    name="end_stop",
    parameters=(
        Parameter("stop_gap", "m", 0.0, 1.0, 0.004, "travel from the centre to either stop"),
        Parameter("stop_stiffness", "N/m", 0.0, 1e10, 1e6, "contact stiffness"),
        Parameter(
            "stop_dissipation", "s/m", 0.0, 100.0, 0.5,
            "loss of the contact: share of the force per m/s of approach",
        ),
        Parameter("stop_damping", "N s/m", 0.0, 1e4, 0.0, "drag of the contact, whatever the depth"),
    ),
    law="F = sgn(z) max(0, K d (1 + chi d') + c d'), d = abs(z) - gap > 0",
    source="Hunt and Crossley's contact law (c = 0) or Kelvin and Voigt's (chi = 0), neither of which pulls",
    meaning="spool that reaches the end of its stroke",
    check="stroke, spring seating, amplitude of the vibration",
    force_law=stop,
    levels_law=stop_levels,
)  # fmt: skip
