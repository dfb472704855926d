"""Force laws, written a second time: nothing here is shared with the simulator that ships.

Everything is a function of the displacement z (m) and the velocity v (m/s) relative to the body, the time t
(s) and the numbers of a plant, an array in the order of :data:`NAMES`. An effect is absent where its
numbers are 0.

Row of states: deflections of the slip elements (m), the chamber's force (N), displacement (m) and velocity
(m/s) of the coils relative to the body.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from spool_core.kernels.compiled import compiled

Array = NDArray[np.float64]

#: What a plant is made of, in SI units; the comment says what the number does.
NAMES: tuple[str, ...] = (
    "mass", "stiffness", "damping",
    "coulomb_force",  # dry friction at speed
    "static_force",  # dry friction at rest, where it differs
    "stribeck_velocity", "stribeck_exponent",  # m/s, 1
    "asymmetry",  # added to the friction for v > 0, taken off for v < 0
    "root_drag",  # mixed friction: N per sqrt(m/s)
    "contact_power",  # mixed friction: N m/s
    "contact_velocity",  # mixed friction: m/s
    "bristle_stiffness",  # friction with memory: N/m; its force is coulomb_force
    "bristle_damping",  # N s/m, LuGre's
    "quadratic",
    "cubic",
    "stop_gap", "stop_stiffness", "stop_damping",
    "backlash",
    "preload_force", "preload_travel",
    "ripple_force", "ripple_frequency", "ripple_phase",
    "damping_rate",  # relative, 1/s
    "stiffness_rate",  # relative, 1/s
    "damping_by_position",  # relative, 1/m^2
    "hysteresis_force", "hysteresis_travel",  # Bouc-Wen
    "step_force", "step_place", "step_width",  # flow force where a land opens
    "power_drag", "power_exponent",
    "loose_mass", "loose_friction",  # a part that rides on the spool and slips
    "skew_stiffness",  # N/m^2, even in z
    "warming_share", "warming_time",  # drag that tends to 1 + share times itself, with a time constant, s
    "slip_force", "slip_travel",  # Maxwell slip: all elements slide at this force, N, after this travel, m
    "soft_preload", "soft_travel",  # preload that sets in smoothly, N and m
    "seat_place", "seat_stiffness", "seat_dissipation",  # a seat on one side that pushes and never pulls
    "flow_stiffness", "flow_overlap",  # flow force of an opening beyond the overlap, N/m and m
    "flow_ripple", "flow_frequency", "flow_phase",  # relative ripple of the pressure that drives it
    "chamber_stiffness", "chamber_time",  # oil chamber that leaks: Maxwell's spring and dashpot in series
    "surge_mass", "surge_damping",  # mass of the spring's coils, kg, and their drag, N s/m
)  # fmt: skip
PLACE: dict[str, int] = {name: index for index, name in enumerate(NAMES)}

MASS, STIFFNESS, DAMPING = PLACE["mass"], PLACE["stiffness"], PLACE["damping"]
COULOMB, STATIC, STRIBECK = PLACE["coulomb_force"], PLACE["static_force"], PLACE["stribeck_velocity"]
STEEPNESS = PLACE["stribeck_exponent"]
ASYMMETRY, ROOT, CONTACT = PLACE["asymmetry"], PLACE["root_drag"], PLACE["contact_power"]
CONTACT_VELOCITY = PLACE["contact_velocity"]
BRISTLE, BRISTLE_DAMPING = PLACE["bristle_stiffness"], PLACE["bristle_damping"]
QUADRATIC, CUBIC = PLACE["quadratic"], PLACE["cubic"]
GAP, STOP, STOP_DAMPING = PLACE["stop_gap"], PLACE["stop_stiffness"], PLACE["stop_damping"]
BACKLASH, PRELOAD, TRAVEL = PLACE["backlash"], PLACE["preload_force"], PLACE["preload_travel"]
RIPPLE, RIPPLE_HZ, RIPPLE_PHASE = PLACE["ripple_force"], PLACE["ripple_frequency"], PLACE["ripple_phase"]
DAMPING_RATE, STIFFNESS_RATE = PLACE["damping_rate"], PLACE["stiffness_rate"]
BY_POSITION = PLACE["damping_by_position"]
HYSTERESIS, HYSTERESIS_TRAVEL = PLACE["hysteresis_force"], PLACE["hysteresis_travel"]
STEP, STEP_PLACE, STEP_WIDTH = PLACE["step_force"], PLACE["step_place"], PLACE["step_width"]
POWER, EXPONENT = PLACE["power_drag"], PLACE["power_exponent"]
LOOSE_MASS, LOOSE_FRICTION = PLACE["loose_mass"], PLACE["loose_friction"]
SKEW = PLACE["skew_stiffness"]
WARMING, WARMING_TIME = PLACE["warming_share"], PLACE["warming_time"]
SLIP, SLIP_TRAVEL = PLACE["slip_force"], PLACE["slip_travel"]
SOFT, SOFT_TRAVEL = PLACE["soft_preload"], PLACE["soft_travel"]
SEAT, SEAT_PLACE, SEAT_LOSS = PLACE["seat_stiffness"], PLACE["seat_place"], PLACE["seat_dissipation"]
FLOW, OVERLAP = PLACE["flow_stiffness"], PLACE["flow_overlap"]
FLOW_RIPPLE, FLOW_HZ, FLOW_PHASE = PLACE["flow_ripple"], PLACE["flow_frequency"], PLACE["flow_phase"]
CHAMBER, CHAMBER_TIME = PLACE["chamber_stiffness"], PLACE["chamber_time"]
SURGE, SURGE_DAMPING = PLACE["surge_mass"], PLACE["surge_damping"]

#: Slip elements: four follow the curve of many to some per cent of the force.
ELEMENTS = 4
STATES = ELEMENTS + 3
_CHAMBER, _COILS, _COILS_SPEED = ELEMENTS, ELEMENTS + 1, ELEMENTS + 2


@compiled
def restoring(z: float, v: float, t: float, p: Array) -> float:
    """Return what depends on place and time, N: springs, stops, flow force, a force from outside."""
    force = p[STIFFNESS] * (1.0 + p[STIFFNESS_RATE] * t) * z
    if p[BACKLASH] > 0.0:
        outside = max(abs(z) - p[BACKLASH], 0.0)
        force = p[STIFFNESS] * math.copysign(outside, z)
    if p[CUBIC] != 0.0:
        force += p[CUBIC] * z**3
    if p[SKEW] != 0.0:
        force += p[SKEW] * z * z
    if p[PRELOAD] > 0.0:
        force += p[PRELOAD] * (math.copysign(1.0, z) if abs(z) > p[TRAVEL] else z / p[TRAVEL])
    if p[STOP] > 0.0 and abs(z) > p[GAP]:
        inward = math.copysign(1.0, z)
        push = p[STOP] * (abs(z) - p[GAP]) + p[STOP_DAMPING] * inward * v
        force += inward * max(push, 0.0)
    if p[STEP] != 0.0:
        force += 0.5 * p[STEP] * (1.0 + math.tanh((z - p[STEP_PLACE]) / p[STEP_WIDTH]))
    if p[SOFT] != 0.0:
        force += p[SOFT] * math.tanh(z / p[SOFT_TRAVEL])
    if p[SEAT] > 0.0 and z > p[SEAT_PLACE]:
        force += max(p[SEAT] * (z - p[SEAT_PLACE]) * (1.0 + p[SEAT_LOSS] * v), 0.0)
    if p[FLOW] != 0.0 and abs(z) > p[OVERLAP]:
        pressure = 1.0 + p[FLOW_RIPPLE] * math.sin(2.0 * math.pi * p[FLOW_HZ] * t + p[FLOW_PHASE])
        force += p[FLOW] * pressure * math.copysign(abs(z) - p[OVERLAP], z)
    if p[RIPPLE] != 0.0:
        force -= p[RIPPLE] * math.sin(2.0 * math.pi * p[RIPPLE_HZ] * t + p[RIPPLE_PHASE])
    return float(force)


@compiled
def drag(z: float, v: float, t: float, p: Array) -> float:
    """Return what grows with the velocity, N."""
    course = 1.0 + p[DAMPING_RATE] * t
    if p[WARMING] != 0.0:
        course += p[WARMING] * (1.0 - math.exp(-t / p[WARMING_TIME]))
    share = max(course, 0.0) * (1.0 + p[BY_POSITION] * z * z)
    force = p[DAMPING] * share * v
    if p[QUADRATIC] != 0.0:
        force += p[QUADRATIC] * abs(v) * v
    if p[POWER] != 0.0:
        force += math.copysign(p[POWER] * abs(v) ** p[EXPONENT], v)
    return float(force)


@compiled
def dry(speed: float, direction: float, p: Array) -> float:
    """Return the dry friction that opposes slipping at ``speed`` >= 0 in ``direction``, N."""
    if p[BRISTLE] > 0.0:
        return 0.0  # it acts through the bristles
    force = p[COULOMB] + direction * p[ASYMMETRY]
    if p[STRIBECK] > 0.0:
        force += (p[STATIC] - p[COULOMB]) * math.exp(-((speed / p[STRIBECK]) ** p[STEEPNESS]))
    if p[CONTACT] > 0.0:
        force += p[ROOT] * math.sqrt(speed) + p[CONTACT] / (speed + p[CONTACT_VELOCITY])
    return float(force)


@compiled
def bristle_limit(speed: float, p: Array) -> float:
    """Return the force to which friction with memory tends, N: Dahl's constant, LuGre's falls with speed."""
    force = p[COULOMB]
    if p[STRIBECK] > 0.0:
        force += (p[STATIC] - p[COULOMB]) * math.exp(-((speed / p[STRIBECK]) ** p[STEEPNESS]))
    return float(force)


@compiled
def bristle_after(x: float, v: float, duration: float, p: Array) -> float:
    """Return the bristles' deflection (m) after moving at ``v`` for ``duration``: exact for constant v."""
    if v == 0.0:
        return x
    aim = math.copysign(bristle_limit(abs(v), p) / p[BRISTLE], v)
    return float(aim + (x - aim) * math.exp(-abs(v * duration / aim)))


@compiled
def hysteresis_after(x: float, v: float, duration: float, p: Array) -> float:
    """Return Bouc and Wen's internal displacement (m) after moving at ``v`` for ``duration``, exponent 2."""
    reach = p[HYSTERESIS_TRAVEL]
    middle = x + 0.5 * duration * (v - 0.5 * (abs(v) * abs(x) * x + v * x * x) / reach**2)
    return float(x + duration * (v - 0.5 * (abs(v) * abs(middle) * middle + v * middle * middle) / reach**2))


@compiled
def has_states(p: Array) -> bool:
    """Return whether the plant has any of these states."""
    return bool(p[SLIP] > 0.0 or p[CHAMBER] > 0.0 or p[SURGE] > 0.0)


@compiled
def slipped(x: float, way: float, limit: float) -> float:
    """Return the deflection of a slip element (m) after ``way`` m: it slides at its ``limit``."""
    return float(min(max(x + way, -limit), limit))


@compiled
def relaxed(force: float, v: float, duration: float, p: Array) -> float:
    """Return the chamber's force (N) after moving at ``v`` for ``duration``: exact for constant v."""
    aim = p[CHAMBER] * p[CHAMBER_TIME] * v
    return float(aim + (force - aim) * math.exp(-duration / p[CHAMBER_TIME]))


@compiled
def force_of_states(states: Array, z: float, v: float, h: float, p: Array) -> float:
    """Return the force against the motion (N) in the middle of a step of ``h`` s, at ``z`` m and ``v`` m/s.

    The spring's own force, which the coils pass on, counts with ``laws.restoring``: here is what differs.
    """
    force = 0.0
    if p[SLIP] > 0.0:
        for j in range(ELEMENTS):
            limit = p[SLIP_TRAVEL] * (j + 1) / ELEMENTS
            force += p[SLIP] / ELEMENTS / limit * slipped(states[j], 0.5 * h * v, limit)
    if p[CHAMBER] > 0.0:
        force += relaxed(states[_CHAMBER], v, 0.5 * h, p)
    if p[SURGE] > 0.0:
        middle = states[_COILS] + 0.5 * h * states[_COILS_SPEED]
        force += 2.0 * p[STIFFNESS] * (z - middle) - p[STIFFNESS] * z
    return float(force)


@compiled
def advance_states(states: Array, z: float, v: float, body: float, h: float, p: Array) -> None:
    """Advance ``states`` in place by a step of ``h`` s, in whose middle the spool is at ``z`` with ``v``.

    ``body`` is the acceleration of the body, m/s^2, which the coils feel as the spool does.
    """
    if p[SLIP] > 0.0:
        for j in range(ELEMENTS):
            states[j] = slipped(states[j], h * v, p[SLIP_TRAVEL] * (j + 1) / ELEMENTS)
    if p[CHAMBER] > 0.0:
        states[_CHAMBER] = relaxed(states[_CHAMBER], v, h, p)
    if p[SURGE] > 0.0:
        middle = states[_COILS] + 0.5 * h * states[_COILS_SPEED]
        pull = 2.0 * p[STIFFNESS] * (z - 2.0 * middle) - p[SURGE_DAMPING] * states[_COILS_SPEED]
        states[_COILS_SPEED] += h * (pull / p[SURGE] - body)
        states[_COILS] = middle + 0.5 * h * states[_COILS_SPEED]
