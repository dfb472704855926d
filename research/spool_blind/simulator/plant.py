"""Plant: a spool with what acts on it, how it moves, and what the channels make of it.

Steps are short and of equal length: half a step of drift, all impulses together, half a step of drift.
Within a step the forces are held; dry friction is set-valued, so that a step which would reverse the motion
is split where the velocity vanishes and goes on, or rests, from there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from scipy.signal import butter, lfilter, lfilter_zi
from spool_blind.simulator.laws import (
    BRISTLE,
    BRISTLE_DAMPING,
    HYSTERESIS,
    HYSTERESIS_TRAVEL,
    LOOSE_FRICTION,
    LOOSE_MASS,
    MASS,
    NAMES,
    PLACE,
    STATES,
    advance_states,
    bristle_after,
    drag,
    dry,
    force_of_states,
    has_states,
    hysteresis_after,
    restoring,
)
from spool_core.kernels.compiled import compiled

Array = NDArray[np.float64]

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
    """Plant numbers by name, see ``laws.NAMES``; what is not named is absent."""

    numbers: Mapping[str, float]

    def __post_init__(self) -> None:
        unknown = set(self.numbers) - set(NAMES)
        if unknown:
            raise KeyError(f"a plant has no {', '.join(sorted(unknown))}")

    def array(self) -> Array:
        """Return the numbers in the order of ``laws.NAMES``."""
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
    if p[HYSTERESIS] > 0.0:
        return float(p[HYSTERESIS] / p[HYSTERESIS_TRAVEL] * hysteresis_after(x, v, 0.5 * duration, p))
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
    # Comes to rest inside the step: what is left of it starts from rest.
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
        p: numbers of the plant in the order of ``laws.NAMES``.
    """
    count = excitation.size
    acceleration, displacement = np.empty(count), np.empty(count)
    mass = p[MASS]
    z, v, x, loose = 0.0, 0.0, 0.0, 0.0
    states, more = np.zeros(STATES), has_states(p)
    for n in range(count):
        t = start + (n + 0.5) * h
        body = excitation[n]
        middle = z + 0.5 * h * v
        speed, after = v, v
        for _ in range(2):  # the second time with the velocity in the middle: second order
            force = restoring(middle, speed, t, p) + drag(middle, speed, t, p) + remembered(speed, x, h, p)
            if more:
                force += force_of_states(states, middle, speed, h, p)
            after = kick(v, speed, -body - force / mass, h, p)
            speed = 0.5 * (v + after)
        if p[LOOSE_MASS] > 0.0:
            loose -= h * body
            reduced = mass * p[LOOSE_MASS] / (mass + p[LOOSE_MASS])
            impulse = min(max(reduced * (after - loose), -h * p[LOOSE_FRICTION]), h * p[LOOSE_FRICTION])
            after -= impulse / mass
            loose += impulse / p[LOOSE_MASS]
            speed = 0.5 * (v + after)
        if p[BRISTLE] > 0.0:
            x = bristle_after(x, speed, h, p)
        elif p[HYSTERESIS] > 0.0:
            x = hysteresis_after(x, speed, h, p)
        if more:
            advance_states(states, middle, speed, body, h, p)
        acceleration[n] = (after - v) / h + body
        displacement[n] = middle
        z = middle + 0.5 * h * after
        v = after
    return acceleration, displacement


@dataclass(frozen=True, slots=True)
class Channels:
    """Channel errors of body and spool; the body's is the reference, so gain and delay are the spool's.

    Attributes:
        gain: reading of the spool's sensor over the truth.
        delay: of the spool's reading behind the body's, s; negative is ahead.
        full_scale: of the spool's sensor, m/s^2; 0 for none.
        noise: rms of white noise on either channel, m/s^2.
        low_pass: corner of a second-order low-pass in the spool's sensor, Hz; 0 for none.
        jitter: rms of the spool's sampling instants, s.
        mount_frequency, mount_damping: resonance of the spool sensor's mounting, Hz; 0 for none.
    """

    gain: float = 1.0
    delay: float = 0.0
    full_scale: float = 0.0
    noise: float = 0.0
    low_pass: float = 0.0
    jitter: float = 0.0
    mount_frequency: float = 0.0
    mount_damping: float = 0.05

    def read(self, motion: SpoolMotion, t: Array, generator: np.random.Generator) -> tuple[Array, Array]:
        """Return the readings (body, spool), m/s^2, at the instants ``t`` (s, shape (n,))."""
        sensed = motion.spool
        rate = 1.0 / motion.step
        if self.low_pass > 0.0:
            numerator, denominator = butter(2, self.low_pass, fs=rate)
            sensed, _ = lfilter(
                numerator, denominator, sensed, zi=sensed[0] * lfilter_zi(numerator, denominator)
            )
        if self.mount_frequency > 0.0:
            sensed = self._mounted(sensed, rate)
        when = t - self.delay
        if self.jitter > 0.0:
            when = when + self.jitter * generator.standard_normal(t.size)
        body = np.interp(t, motion.time, motion.body)
        spool = self.gain * np.interp(when, motion.time, sensed)
        body += self.noise * generator.standard_normal(t.size)
        spool += self.noise * generator.standard_normal(t.size)
        if self.full_scale > 0.0:
            spool = np.clip(spool, -self.full_scale, self.full_scale)
        return body, spool

    def _mounted(self, sensed: Array, rate: float) -> Array:
        """Return what a sensor on an elastic mounting feels: one mass on spring and damper."""
        turn = 2.0 * np.pi * self.mount_frequency / rate
        radius = np.exp(-self.mount_damping * turn)
        denominator = [1.0, -2.0 * radius * np.cos(turn * np.sqrt(1.0 - self.mount_damping**2)), radius**2]
        return np.asarray(lfilter([sum(denominator)], denominator, sensed))


def transmissibility(numbers: Mapping[str, float], frequency: Array, *, travel: bool = False) -> Spectrum:
    """Return spool's over body's acceleration at ``frequency`` (Hz), or travel over it (s^2)."""
    s = 2j * np.pi * frequency
    inner = numbers["damping"] * s + numbers["stiffness"]
    whole = numbers["mass"] * s * s + inner
    return np.asarray(-numbers["mass"] / whole if travel else inner / whole, dtype=np.complex128)


class Padded:
    """Spectrum of a signal that starts from rest, extended so that it ends at rest."""

    def __init__(self, signal: Array, rate: float) -> None:
        fade = round(FADE * rate)
        ending = signal[-1] * (0.5 + 0.5 * np.cos(np.pi * np.arange(1, fade + 1) / fade))
        whole = np.concatenate((signal, ending))
        self.size = signal.size
        self.length = next_fast_len(whole.size + round(REST * rate), real=True)
        self.frequency: Array = rfftfreq(self.length, 1.0 / rate)
        self.spectrum: Spectrum = rfft(whole, self.length)

    def through(self, factor: Spectrum) -> Array:
        """Return the signal after a linear system of this frequency response, shape of the signal."""
        return np.asarray(irfft(self.spectrum * factor, self.length)[: self.size], dtype=np.float64)


def respond(numbers: Mapping[str, float], body: Array, rate: float, *, travel: bool = False) -> Array:
    """Return the spool's acceleration (m/s^2) or travel (m) under ``body`` (from rest, ``rate`` Hz)."""
    padded = Padded(body, rate)
    return padded.through(transmissibility(numbers, padded.frequency, travel=travel))
