"""Simulator of a spool, written a second time: nothing here is shared with the one that ships.

First the force laws, then the plant and how it moves.

Everything is a function of the displacement z (m) and the velocity v (m/s) relative to the body, the time t
(s) and the numbers of a plant, a row of :data:`NUMBERS`. An effect is absent where its numbers are 0.

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
#: A plant's numbers as its laws take them: ``p.mass`` and so on; 0 where it has none.
NUMBERS = np.dtype([(name, np.float64) for name in NAMES])

#: Slip elements: four follow the curve of many to some per cent of the force.
ELEMENTS = 4
STATES = ELEMENTS + 3
_CHAMBER, _COILS, _COILS_SPEED = ELEMENTS, ELEMENTS + 1, ELEMENTS + 2


@compiled
def restoring(z: float, v: float, t: float, p: np.record) -> float:
    """Return what depends on place and time, N: springs, stops, flow force, a force from outside."""
    force = p.stiffness * z
    if p.backlash > 0.0:
        outside = max(abs(z) - p.backlash, 0.0)
        force = p.stiffness * math.copysign(outside, z)
    if p.cubic != 0.0:
        force += p.cubic * z**3
    if p.preload_force > 0.0:
        force += p.preload_force * (
            math.copysign(1.0, z) if abs(z) > p.preload_travel else z / p.preload_travel
        )
    if p.stop_stiffness > 0.0 and abs(z) > p.stop_gap:
        inward = math.copysign(1.0, z)
        push = p.stop_stiffness * (abs(z) - p.stop_gap) + p.stop_damping * inward * v
        force += inward * max(push, 0.0)
    if p.soft_preload != 0.0:
        force += p.soft_preload * math.tanh(z / p.soft_travel)
    if p.seat_stiffness > 0.0 and z > p.seat_place:
        force += max(p.seat_stiffness * (z - p.seat_place) * (1.0 + p.seat_dissipation * v), 0.0)
    if p.flow_stiffness != 0.0 and abs(z) > p.flow_overlap:
        pressure = 1.0 + p.flow_ripple * math.sin(2.0 * math.pi * p.flow_frequency * t + p.flow_phase)
        force += p.flow_stiffness * pressure * math.copysign(abs(z) - p.flow_overlap, z)
    if p.ripple_force != 0.0:
        force -= p.ripple_force * math.sin(2.0 * math.pi * p.ripple_frequency * t + p.ripple_phase)
    return float(force)


@compiled
def drag(v: float, t: float, p: np.record) -> float:
    """Return what grows with the velocity, N."""
    course = 1.0 + p.damping_rate * t
    if p.warming_share != 0.0:
        course += p.warming_share * (1.0 - math.exp(-t / p.warming_time))
    force = p.damping * max(course, 0.0) * v
    if p.quadratic != 0.0:
        force += p.quadratic * abs(v) * v
    return float(force)


@compiled
def dry(speed: float, direction: float, p: np.record) -> float:
    """Return the dry friction that opposes slipping at ``speed`` >= 0 in ``direction``, N."""
    if p.bristle_stiffness > 0.0:
        return 0.0  # it acts through the bristles
    force = p.coulomb_force + direction * p.asymmetry
    if p.stribeck_velocity > 0.0:
        force += (p.static_force - p.coulomb_force) * math.exp(
            -((speed / p.stribeck_velocity) ** p.stribeck_exponent)
        )
    if p.contact_power > 0.0:
        force += p.root_drag * math.sqrt(speed) + p.contact_power / (speed + p.contact_velocity)
    return float(force)


@compiled
def bristle_limit(speed: float, p: np.record) -> float:
    """Return the force to which friction with memory tends, N: Dahl's constant, LuGre's falls with speed."""
    force = p.coulomb_force
    if p.stribeck_velocity > 0.0:
        force += (p.static_force - p.coulomb_force) * math.exp(
            -((speed / p.stribeck_velocity) ** p.stribeck_exponent)
        )
    return float(force)


@compiled
def bristle_after(x: float, v: float, duration: float, p: np.record) -> float:
    """Return the bristles' deflection (m) after moving at ``v`` for ``duration``: exact for constant v."""
    if v == 0.0:
        return x
    aim = math.copysign(bristle_limit(abs(v), p) / p.bristle_stiffness, v)
    return float(aim + (x - aim) * math.exp(-abs(v * duration / aim)))


@compiled
def has_states(p: np.record) -> bool:
    """Return whether the plant has any of these states."""
    return bool(p.slip_force > 0.0 or p.chamber_stiffness > 0.0 or p.surge_mass > 0.0)


@compiled
def slipped(x: float, way: float, limit: float) -> float:
    """Return the deflection of a slip element (m) after ``way`` m: it slides at its ``limit``."""
    return float(min(max(x + way, -limit), limit))


@compiled
def relaxed(force: float, v: float, duration: float, p: np.record) -> float:
    """Return the chamber's force (N) after moving at ``v`` for ``duration``: exact for constant v."""
    aim = p.chamber_stiffness * p.chamber_time * v
    return float(aim + (force - aim) * math.exp(-duration / p.chamber_time))


@compiled
def force_of_states(states: Array, z: float, v: float, h: float, p: np.record) -> float:
    """Return the force against the motion (N) in the middle of a step of ``h`` s, at ``z`` m and ``v`` m/s.

    The spring's own force, which the coils pass on, counts with ``restoring``: here is what differs.
    """
    force = 0.0
    if p.slip_force > 0.0:
        for j in range(ELEMENTS):
            limit = p.slip_travel * (j + 1) / ELEMENTS
            force += p.slip_force / ELEMENTS / limit * slipped(states[j], 0.5 * h * v, limit)
    if p.chamber_stiffness > 0.0:
        force += relaxed(states[_CHAMBER], v, 0.5 * h, p)
    if p.surge_mass > 0.0:
        middle = states[_COILS] + 0.5 * h * states[_COILS_SPEED]
        force += 2.0 * p.stiffness * (z - middle) - p.stiffness * z
    return float(force)


@compiled
def advance_states(states: Array, z: float, v: float, body: float, h: float, p: np.record) -> None:
    """Advance ``states`` in place by a step of ``h`` s, in whose middle the spool is at ``z`` with ``v``.

    ``body`` is the acceleration of the body, m/s^2, which the coils feel as the spool does.
    """
    if p.slip_force > 0.0:
        for j in range(ELEMENTS):
            states[j] = slipped(states[j], h * v, p.slip_travel * (j + 1) / ELEMENTS)
    if p.chamber_stiffness > 0.0:
        states[_CHAMBER] = relaxed(states[_CHAMBER], v, h, p)
    if p.surge_mass > 0.0:
        middle = states[_COILS] + 0.5 * h * states[_COILS_SPEED]
        pull = 2.0 * p.stiffness * (z - 2.0 * middle) - p.surge_damping * states[_COILS_SPEED]
        states[_COILS_SPEED] += h * (pull / p.surge_mass - body)
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

    def array(self) -> np.record:
        """Return the numbers as the laws take them."""
        row: np.record = np.zeros(1, NUMBERS).view(np.recarray)[0]
        for name, value in self.numbers.items():
            row[name] = value
        return row

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
def remembered(v: float, x: float, duration: float, p: np.record) -> float:
    """Return the force of what has a memory, N, in the middle of a step of ``duration`` at velocity ``v``."""
    if p.bristle_stiffness > 0.0:
        after = bristle_after(x, v, 0.5 * duration, p)
        rate = (bristle_after(x, v, duration, p) - x) / duration
        return float(p.bristle_stiffness * after + p.bristle_damping * rate)
    return 0.0


@compiled
def kick(v: float, speed: float, pull: float, h: float, p: np.record) -> float:
    """Return the velocity after ``h`` s under ``pull`` (m/s^2) and dry friction at ``speed``."""
    mass = p.mass
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
def step_through(excitation: Array, h: float, start: float, p: np.record) -> tuple[Array, Array]:
    """Move a spool from rest and return (spool's acceleration m/s^2, displacement m), shapes (n,).

    Both belong to the middles of the steps, as ``excitation`` does.

    Args:
        excitation: acceleration of the body in the middle of each step, m/s^2, shape (n,).
        h: length of a step, s.
        start: time at the begin of the first step, s.
        p: numbers of the plant.
    """
    count = excitation.size
    acceleration, displacement = np.empty(count), np.empty(count)
    mass = p.mass
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
        if p.bristle_stiffness > 0.0:
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
