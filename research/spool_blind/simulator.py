"""Simulator of a spool, written a second time: nothing here is shared with the one that ships.

First the force laws, then the plant and how it moves.

Everything is a function of the displacement z (m) and the velocity v (m/s) relative to the body, the time t
(s) and the numbers of a plant, an array in the order of :data:`NAMES`. An effect is absent where its
numbers are 0.

Row of states: deflections of the slip elements (m), the chamber's force (N), displacement (m) and velocity
(m/s) of the coils relative to the body.

Steps are short and of equal length: half a step of drift, all impulses together, half a step of drift.
Within a step the forces are held; dry friction is set-valued, so that a step which would reverse the motion
is split where the velocity vanishes and goes on, or rests, from there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
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
DAMPING_RATE = PLACE["damping_rate"]
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
    force = p[STIFFNESS] * z
    if p[BACKLASH] > 0.0:
        outside = max(abs(z) - p[BACKLASH], 0.0)
        force = p[STIFFNESS] * math.copysign(outside, z)
    if p[CUBIC] != 0.0:
        force += p[CUBIC] * z**3
    if p[PRELOAD] > 0.0:
        force += p[PRELOAD] * (math.copysign(1.0, z) if abs(z) > p[TRAVEL] else z / p[TRAVEL])
    if p[STOP] > 0.0 and abs(z) > p[GAP]:
        inward = math.copysign(1.0, z)
        push = p[STOP] * (abs(z) - p[GAP]) + p[STOP_DAMPING] * inward * v
        force += inward * max(push, 0.0)
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
def drag(v: float, t: float, p: Array) -> float:
    """Return what grows with the velocity, N."""
    course = 1.0 + p[DAMPING_RATE] * t
    if p[WARMING] != 0.0:
        course += p[WARMING] * (1.0 - math.exp(-t / p[WARMING_TIME]))
    force = p[DAMPING] * max(course, 0.0) * v
    if p[QUADRATIC] != 0.0:
        force += p[QUADRATIC] * abs(v) * v
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

    The spring's own force, which the coils pass on, counts with ``restoring``: here is what differs.
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


#: s, longest step, and rad, how far the stiffest contact may turn within one.
LONGEST_STEP, LARGEST_TURN = 25e-6, 0.03
#: Stiffness of all slip elements together over force by travel: of four, 1 + 1/2 + 1/3 + 1/4.
SLIP_STIFFNESS = 25.0 / 12.0
#: s of motion after the record's end, for a channel that is ahead.
AFTER = 0.01

Spectrum = NDArray[np.complex128]

#: s in which the last value fades out, and s of rest after it: what is over must not come round to the start.
FADE, REST = 0.5, 4.0


@dataclass(frozen=True, slots=True)
class Plant:
    """Plant numbers by name, see ``NAMES``; what is not named is absent."""

    numbers: Mapping[str, float]

    def __post_init__(self) -> None:
        unknown = set(self.numbers) - set(NAMES)
        if unknown:
            raise KeyError(f"a plant has no {', '.join(sorted(unknown))}")

    def array(self) -> Array:
        """Return the numbers in the order of ``NAMES``."""
        values = np.zeros(len(NAMES))
        for name, value in self.numbers.items():
            values[PLACE[name]] = value
        return values

    def with_(self, **numbers: float) -> Plant:
        """Return the same plant with other or further numbers."""
        return Plant({**self.numbers, **numbers})

    @property
    def longest_step(self) -> float:
        """Longest step that the plant's stiffest contact allows, s."""

        def over(force: str, travel: str) -> float:
            return self.numbers[force] / self.numbers[travel] if travel in self.numbers else 0.0

        stiffest = max(
            self.numbers.get("stop_stiffness", 0.0),
            self.numbers.get("bristle_stiffness", 0.0),
            over("preload_force", "preload_travel"),
            over("soft_preload", "soft_travel"),
            SLIP_STIFFNESS * over("slip_force", "slip_travel"),
            self.numbers["stiffness"],
        )
        return min(LONGEST_STEP, LARGEST_TURN / float(np.sqrt(stiffest / self.numbers["mass"])))


@dataclass(frozen=True, slots=True)
class SpoolMotion:
    """Motion of a plant: values in the middles of equal steps.

    Attributes:
        time: s since the record's start; negative before it, shape (n,).
        step: s.
        body: acceleration of the body, m/s^2, shape (n,).
        spool: acceleration of the spool, m/s^2, shape (n,).
        displacement: of the spool relative to the body, m, shape (n,).
    """

    time: Array
    step: float
    body: Array
    spool: Array
    displacement: Array


def steps(duration: float, sample_rate: float, before: float, longest: float) -> tuple[Array, float]:
    """Return the middles of the steps (s) from ``before`` s ahead of the record's start to its end, and h.

    Each sample instant is a border of two steps; none is longer than ``longest`` s.
    """
    per_sample = int(np.ceil(1.0 / sample_rate / longest))
    h = 1.0 / sample_rate / per_sample
    first = -round(before * sample_rate) * per_sample
    last = round((duration + AFTER) * sample_rate) * per_sample
    return np.asarray((np.arange(first, last) + 0.5) * h, dtype=np.float64), h


def move(plant: Plant, time: Array, h: float, body: Array) -> SpoolMotion:
    """Move ``plant`` from rest under ``body`` (m/s^2, in the middles ``time`` of steps of ``h`` s)."""
    spool, displacement = step_through(body, h, float(time[0] - 0.5 * h), plant.array())
    return SpoolMotion(time, h, body, spool, displacement)


@compiled
def remembered(v: float, x: float, duration: float, p: Array) -> float:
    """Return the force of what has a memory, N, in the middle of a step of ``duration`` at velocity ``v``."""
    if p[BRISTLE] > 0.0:
        after = bristle_after(x, v, 0.5 * duration, p)
        rate = (bristle_after(x, v, duration, p) - x) / duration
        return float(p[BRISTLE] * after + p[BRISTLE_DAMPING] * rate)
    return 0.0


@compiled
def kick(v: float, speed: float, pull: float, h: float, p: Array) -> float:
    """Return the velocity after ``h`` s under ``pull`` (m/s^2) and dry friction at ``speed``."""
    mass = p[MASS]
    if v == 0.0:
        direction = 1.0 if pull > 0.0 else -1.0
        free = abs(pull) - dry(0.0, direction, p) / mass
        return float(direction * max(free, 0.0) * h)
    direction = 1.0 if v > 0.0 else -1.0
    against = dry(abs(speed), direction, p) / mass
    after = v + h * (pull - direction * against)
    if after * direction > 0.0:
        return float(after)
    # Comes to rest inside the step: the rest of the step starts from rest.
    left = h - v / (direction * against - pull)
    onward = 1.0 if pull > 0.0 else -1.0
    free = abs(pull) - dry(0.0, onward, p) / mass
    return float(onward * max(free, 0.0) * left)


@compiled
def step_through(excitation: Array, h: float, start: float, p: Array) -> tuple[Array, Array]:
    """Move a spool from rest and return (spool's acceleration m/s^2, displacement m), shapes (n,).

    Both belong to the middles of the steps, as ``excitation`` does.

    Args:
        excitation: acceleration of the body in the middle of each step, m/s^2, shape (n,).
        h: length of a step, s.
        start: time at the begin of the first step, s.
        p: numbers of the plant in the order of ``NAMES``.
    """
    count = excitation.size
    acceleration, displacement = np.empty(count), np.empty(count)
    mass = p[MASS]
    z, v, x = 0.0, 0.0, 0.0
    states, more = np.zeros(STATES), has_states(p)
    for n in range(count):
        t = start + (n + 0.5) * h
        body = excitation[n]
        middle = z + 0.5 * h * v
        speed, after = v, v
        for _ in range(2):  # the second time with the velocity in the middle: second order
            force = restoring(middle, speed, t, p) + drag(speed, t, p) + remembered(speed, x, h, p)
            if more:
                force += force_of_states(states, middle, speed, h, p)
            after = kick(v, speed, -body - force / mass, h, p)
            speed = 0.5 * (v + after)
        if p[BRISTLE] > 0.0:
            x = bristle_after(x, speed, h, p)
        if more:
            advance_states(states, middle, speed, body, h, p)
        acceleration[n] = (after - v) / h + body
        displacement[n] = middle
        z = middle + 0.5 * h * after
        v = after
    return acceleration, displacement


def transmissibility(numbers: Mapping[str, float], frequency: Array, *, travel: bool = False) -> Spectrum:
    """Return spool's over body's acceleration at ``frequency`` (Hz), or travel over it (s^2)."""
    s = 2j * np.pi * frequency
    inner = numbers["damping"] * s + numbers["stiffness"]
    whole = numbers["mass"] * s * s + inner
    return np.asarray(-numbers["mass"] / whole if travel else inner / whole, dtype=np.complex128)


def respond(numbers: Mapping[str, float], body: Array, rate: float, *, travel: bool = False) -> Array:
    """Return the spool's acceleration (m/s^2) or travel (m) under ``body`` (from rest, ``rate`` Hz)."""
    fade = round(FADE * rate)
    whole = np.concatenate((body, body[-1] * (0.5 + 0.5 * np.cos(np.pi * np.arange(1, fade + 1) / fade))))
    length = next_fast_len(whole.size + round(REST * rate), real=True)
    through = transmissibility(numbers, rfftfreq(length, 1.0 / rate), travel=travel)
    return np.asarray(irfft(rfft(whole, length) * through, length)[: body.size], dtype=np.float64)
