"""Structure of a hypothesis: what acts on the spool and in the measuring chain, with every number.

A part of the chain is a factor on the spectrum of one channel, a delay of the spool's samples, or a gain that
drifts. All are 1 (or 0 s) where their size is 0. The record is never changed: the likelihood applies the
inverse of the body's parts to the excitation and the inverse of the spool's parts to what the model is
corrected by.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from spool_core.numbers import Array
from spool_estimator.identification.least_squares import Unknown
from spool_estimator.identification.nuisances import Nuisance
from spool_sim.model import Model
from spool_sim.terms import Parameter, term
from spool_sim.valve import Valve

from spool_gap.catalogue import EFFECTS

Values = Mapping[str, float]

#: m of travel before sliding that a record of an accelerometer shows at least; below, it is Coulomb friction.
SHORTEST = 1e-6
#: Factor by which the spring may be off its description: play and stops have local minima without a spring.
OFF = 5.0

Spectrum = NDArray[np.complex128]

GAIN, DELAY = "spool_gain_error", "spool_delay"
#: Smallest factor of a response whose inverse is taken: beyond, the reading holds noise alone.
SMALLEST = 0.1


def _coupling(channel: str) -> ChainPart:
    corner = Parameter(f"{channel}_corner", "Hz", 0.0, 6.0, 0.3, "corner of the channel's high-pass")
    return ChainPart(
        "ac_coupling",
        channel,
        (corner,),
        lambda frequency, values: high_pass(frequency, values[corner.name]),
        "the channel is AC-coupled: slow motion is shifted in phase and lost",
        "coupling of the channel (AC or DC), lower limit of an IEPE or charge amplifier, the logger",
    )


def _filter(channel: str) -> ChainPart:
    time = Parameter(f"{channel}_filter_time", "s", 0.0, 8e-3, 1e-3, "1 over the corner of the low-pass")
    return ChainPart(
        "anti_alias",
        channel,
        (time,),
        lambda frequency, values: low_pass(frequency, values[time.name]),
        "this channel has a lower anti-alias filter than the other one",
        "filter settings of both channels in logger and amplifier: same type, order and corner",
    )


def _mode(channel: str) -> ChainPart:
    share = Parameter(
        f"{channel}_mode_share", "1", 0.0, 1.0, 0.1, "share of the reading that passes the mode"
    )
    natural = Parameter(f"{channel}_mode_frequency", "Hz", 20.0, 2e3, 150.0, "natural frequency")
    damping = Parameter(f"{channel}_mode_damping", "1", 2e-3, 0.2, 0.05, "damping ratio")
    return ChainPart(
        "extra_mode",
        channel,
        (share, natural, damping),
        lambda frequency, values: mode(
            frequency, values[share.name], values[natural.name], values[damping.name]
        ),
        "the sensor's bracket, or the body between the sensors, has its own resonance",
        "mounting of both sensors (stud, not magnet or wax), stiffness of brackets, a tap test; if the mode "
        "stays when you move the sensor, it belongs to the valve (spring surge or oil column)",
    )


@dataclass(frozen=True, slots=True)
class ChainPart:
    """A part of one channel.

    Attributes:
        id: as in results; ``channel`` is "body" or "spool".
        parameters: the first one is its size.
        response: factor on the spectrum at frequencies (Hz, > 0), ``None`` for a part that is no filter.
        meaning: what it is; ``check``: what to look at.
    """

    id: str
    channel: str
    parameters: tuple[Parameter, ...]
    response: Callable[[Array, Values], Spectrum] | None
    meaning: str
    check: str

    def told(self, values: Values, deviations: Values) -> Nuisance:
        """Return its nuisance for the result: its corner or natural frequency, or its rate."""
        place = 1 if self.id == "extra_mode" else 0
        own = self.parameters[place]
        size, spread, unit = abs(values[own.name]), deviations.get(own.name, float("nan")), own.unit
        if self.id == "anti_alias" and size > 0.0:
            size, spread, unit = 1.0 / size, spread / size**2, "Hz"
        return Nuisance(self.id, self.channel, size, spread, unit, corrected=False, check=self.check)

    @property
    def key(self) -> str:
        """Name of this part among those of both channels."""
        return f"{self.channel}_{self.id}"


def high_pass(frequency: Array, corner: float) -> Spectrum:
    """Return the response of a high-pass of first order with its ``corner`` in Hz."""
    return np.asarray(frequency / (frequency - 1j * corner), dtype=np.complex128)


def low_pass(frequency: Array, time: float) -> Spectrum:
    """Return the response of a Butterworth low-pass of second order; ``time`` is 1 over its corner, s."""
    turn = 1j * frequency * time
    return np.asarray(1.0 / (1.0 + np.sqrt(2.0) * turn + turn**2), dtype=np.complex128)


def mode(frequency: Array, share: float, natural: float, damping: float) -> Spectrum:
    """Return 1 plus ``share`` of the motion of a mode at ``natural`` Hz with the ratio ``damping``."""
    own = frequency**2 / (natural**2 - frequency**2 + 2j * damping * natural * frequency)
    return np.asarray(1.0 + share * own, dtype=np.complex128)


#: Every part, by its key; gain and delay of the spool's channel belong to each structure.
CHAIN_PARTS: dict[str, ChainPart] = {
    part.key: part
    for part in (
        _coupling("body"),
        _coupling("spool"),
        _filter("body"),
        _filter("spool"),
        _mode("body"),
        _mode("spool"),
        ChainPart(
            "gain_drift",
            "spool",
            (Parameter("gain_drift_rate", "1/s", -0.05, 0.05, 2e-4, "relative change of the spool's gain"),),
            None,
            "the sensitivity of a sensor or amplifier drifts, for example while it warms up",
            "warm-up time and temperature of sensors and amplifiers, cables and mountings that come loose",
        ),
    )
}


SPOOL_GAIN = ChainPart(
    GAIN,
    "spool",
    (Parameter(GAIN, "1", -0.5, 1.0, 0.02, "relative gain error"),),
    lambda frequency, values: np.full(frequency.size, 1.0 + values[GAIN], dtype=np.complex128),
    "the spool's channel has another gain than the body's",
    "sensitivity of both sensors and settings of both amplifiers",
)
SPOOL_DELAY = ChainPart(
    DELAY,
    "spool",
    (Parameter(DELAY, "s", -5e-3, 5e-3, 2e-4, "time of the spool's reading after the motion"),),
    None,
    "the spool's channel lags behind the body's",
    "filters of both channels, sampling order of the logger, clocks of two loggers",
)


@dataclass(frozen=True, slots=True)
class Limits:
    """What a record resolves of a law of friction.

    Attributes:
        slowest: m/s, by which the speed changes within a sample at the slowest reversals.
        reach: m, largest displacement: friction that never slid would be a spring.
    """

    slowest: float = 0.0
    reach: float = math.inf


@dataclass(frozen=True, slots=True)
class Structure:
    """What is thought to act, with its numbers.

    Attributes:
        base: names of the base's force terms.
        base_unknowns: what is fitted of the base.
        effects: ids of the catalogue.
        parts: keys of ``CHAIN_PARTS``.
        values: every number by name, SI.
        limits: of what the record resolves.
    """

    base: tuple[str, ...]
    base_unknowns: tuple[Unknown, ...]
    effects: tuple[str, ...]
    parts: tuple[str, ...]
    values: Values
    limits: Limits = Limits()

    @property
    def key(self) -> tuple[frozenset[str], frozenset[str]]:
        """What tells it from structures that differ in more than numbers."""
        return frozenset(self.effects), frozenset(self.parts)

    @property
    def terms(self) -> tuple[str, ...]:
        """Force terms that are on."""
        own = (name for effect in self.effects for name in EFFECTS[effect].terms)
        return tuple(dict.fromkeys((*self.base, *own)))

    @property
    def jumps(self) -> bool:
        """Whether a force jumps where the velocity changes its sign."""
        return any(term(name).jumps for name in self.terms)

    @property
    def chain(self) -> tuple[ChainPart, ...]:
        """Parts of the measuring chain, with gain and delay of the spool's channel."""
        return (SPOOL_GAIN, SPOOL_DELAY, *(CHAIN_PARTS[key] for key in self.parts))

    def unknowns(self, seconds: float) -> list[Unknown]:
        """Return what a fit of a record of ``seconds`` finds."""
        found = list(self.base_unknowns)
        for effect in self.effects:
            found += [
                _resolved(one, self.values, self.limits)
                for one in EFFECTS[effect].unknowns(self.values, seconds)
            ]
        for part in self.chain:
            found += [Unknown(p.name, p.unit, p.low, p.high, p.start, absolute=True) for p in part.parameters]
        return found

    def bounded(self, seconds: float) -> Structure:
        """Return this with its numbers within the bounds of a fit."""
        moved = {
            one.name: min(max(self.values[one.name], one.low), one.high) for one in self.unknowns(seconds)
        }
        return self.moved(moved)

    def moved(self, values: Values) -> Structure:
        """Return this with other numbers."""
        return replace(self, values={**self.values, **values})

    def having(
        self, effects: Sequence[str] = (), parts: Sequence[str] = (), values: Values | None = None
    ) -> Structure:
        """Return this with other ``effects`` and ``parts``; numbers that are not known start as declared."""
        structure = replace(self, effects=tuple(effects), parts=tuple(parts))
        known = {**structure.values, **(values or {})}
        for effect in structure.effects:
            for name in EFFECTS[effect].terms:
                for parameter in term(name).parameters:
                    known.setdefault(parameter.name, parameter.start)
        for key in structure.parts:
            for parameter in CHAIN_PARTS[key].parameters:
                known.setdefault(parameter.name, parameter.start)
        return replace(structure, values=known)

    def without(self, name: str) -> Structure:
        """Return this without the effect or part called ``name``."""
        return replace(
            self,
            effects=tuple(one for one in self.effects if one != name),
            parts=tuple(one for one in self.parts if one != name),
        )

    def response(self, channel: str, frequency: Array) -> Spectrum:
        """Return the factor on the spectrum of ``channel`` at ``frequency`` (Hz, > 0)."""
        found: Spectrum = np.ones(frequency.size, dtype=np.complex128)
        for part in self.chain:
            if part.channel == channel and part.response is not None:
                found = found * part.response(frequency, self.values)
        return found


def structure_of(
    base: Model,
    valve: Valve,
    effects: Sequence[str] = (),
    parts: Sequence[str] = (),
    values: Values | None = None,
) -> Structure:
    """Return ``base`` with ``effects`` and ``parts``; what ``values`` do not give starts as described."""
    given = [p for entry in EFFECTS.values() for name in entry.terms for p in term(name).parameters]
    known = {p.name: p.start_for(valve) for p in given if p.valve_attribute is not None}
    known |= dict(base.values_for(valve))
    unknowns = []
    for p in base.parameters:
        fixed = p.held or p.valve_attribute is not None
        if fixed and p.name not in ("spring_stiffness", "viscous_coefficient"):
            continue
        start = max(abs(p.start_for(valve)), 1e-9)
        low, high = p.low, p.high
        if p.name == "spring_stiffness":
            low, high = max(low, start / OFF), min(high, start * OFF)
        unknowns.append(Unknown(p.name, p.unit, low, high, start))
    names = tuple(entry.name for entry in base.terms)
    bare = Structure(names, tuple(unknowns), (), (), {**known, GAIN: 0.0, DELAY: 0.0})
    return bare.having(effects, parts, values)


def inverse(response: Spectrum) -> Spectrum:
    """Return 1 over ``response``, at most 1 over ``SMALLEST`` in size."""
    size = np.abs(response)
    return np.asarray(np.conj(response) / np.maximum(size, SMALLEST) ** 2)


def _resolved(unknown: Unknown, values: Values, limits: Limits) -> Unknown:
    """Return ``unknown`` within what the record resolves."""
    if unknown.name == "stribeck_velocity":
        return replace(unknown, low=min(max(unknown.low, limits.slowest), unknown.high))
    if unknown.name != "dahl_stiffness":
        return unknown
    # Of friction before it slides: the travel is the force over the stiffness.
    force = max(values.get("dahl_force", 0.0), 1e-6)
    high = min(unknown.high, force / SHORTEST)
    return replace(unknown, low=min(max(unknown.low, force / limits.reach), high), high=high)
