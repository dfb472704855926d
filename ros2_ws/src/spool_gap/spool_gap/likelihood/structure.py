"""Structure of a hypothesis: what acts on the spool and in the measuring chain, with every number.

A part of the chain is a factor on the spectrum or the samples of one channel, or a delay of the spool's. All
are 1 (or 0 s) where their size is 0. The record is never changed: the inverse of the body's parts
is applied to the excitation, and the spool's parts to the simulated motion.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from spool_estimator.identification.chain import CHAIN_PARTS, ChainPart
from spool_estimator.identification.free_run import USUAL, Reading
from spool_estimator.identification.least_squares import Unknown
from spool_estimator.identification.nuisances import Nuisance
from spool_estimator.identification.residuals import filter_numbers, filter_unknowns, with_numbers
from spool_sim.model import Model
from spool_sim.observation import Observation
from spool_sim.terms import term
from spool_sim.valve import Valve

from spool_gap.catalogue import EFFECTS

Values = Mapping[str, float]

#: m of travel before sliding that a record of an accelerometer shows at least; below, it is Coulomb friction.
SHORTEST = 1e-6
#: Factor by which the spring may be off its description: play and stops have local minima without a spring.
OFF = 5.0

GAIN, DELAY = "spool_gain_error", "spool_delay"
#: Gain and delay of the spool's channel, which belong to each structure.
READ_UNKNOWNS = (
    Unknown(GAIN, "1", -0.5, 1.0, 0.02, absolute=True),
    Unknown(DELAY, "s", -5e-3, 5e-3, 2e-4, absolute=True),
)


def told(part: ChainPart, values: Values, deviations: Values) -> Nuisance:
    """Return the nuisance of ``part`` for the result: corner, natural frequency, rate or surest number."""
    own = part.parameters[1 if part.id == "extra_mode" else 0]
    if part.id == "nonlinearity":
        own = max(part.parameters, key=lambda p: abs(values[p.name]) / deviations.get(p.name, math.inf))
    size, spread, unit = abs(values[own.name]), deviations.get(own.name, float("nan")), own.unit
    if part.id == "anti_alias" and size > 0.0:
        size, spread, unit = 1.0 / size, spread / size**2, "Hz"
    return Nuisance(part.id, part.channel, size, spread, unit, corrected=False, check=part.check)


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
        observation: low-pass of the logger.
    """

    base: tuple[str, ...]
    base_unknowns: tuple[Unknown, ...]
    effects: tuple[str, ...]
    parts: tuple[str, ...]
    values: Values
    limits: Limits = Limits()
    observation: Observation = USUAL

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
    def sharp(self) -> bool:
        """Whether a force jumps, or bends at a place: that shows the low-pass of the logger."""
        return any({"sliding_law", "levels_law", "memory_law"} & set(term(name).laws) for name in self.terms)

    @property
    def reading(self) -> Reading:
        """What the measuring chain makes of the motion."""
        values = self.values
        free = filter_unknowns(self.observation)
        observation = with_numbers(self.observation, free, [values[one.name] for one in free])
        parts = [CHAIN_PARTS[key] for key in self.parts]
        numbers = (tuple(values[p.name] for p in part.parameters) for part in parts)
        return Reading(values[GAIN], values[DELAY], observation, tuple(zip(parts, numbers, strict=True)))

    def unknowns(self, seconds: float) -> list[Unknown]:
        """Return what a fit of a record of ``seconds`` finds."""
        own = (one for effect in self.effects for one in EFFECTS[effect].unknowns(self.values, seconds))
        resolved = (_resolved(one, self.values, self.limits) for one in own)
        found = [*self.base_unknowns, *resolved, *READ_UNKNOWNS]
        for key in self.parts:
            found += [
                Unknown(p.name, p.unit, p.low, p.high, p.start, absolute=True)
                for p in CHAIN_PARTS[key].parameters
            ]
        if self.sharp:
            found += filter_unknowns(self.observation)
        return found

    def bounded(self, seconds: float) -> Structure:
        """Return this with its numbers within the bounds of a fit."""
        moved = {
            one.name: min(max(self.values[one.name], one.low), one.high) for one in self.unknowns(seconds)
        }
        return self.moved(moved)

    def read_by(self, observation: Observation) -> Structure:
        """Return this with another low-pass of the logger."""
        names = (one.name for one in filter_unknowns(observation))
        numbers = dict(zip(names, filter_numbers(observation), strict=True))
        return replace(self, observation=observation, values={**self.values, **numbers})

    def moved(self, values: Values) -> Structure:
        """Return this with other numbers."""
        return replace(self, values={**self.values, **values})

    def having(
        self, effects: Sequence[str] = (), parts: Sequence[str] = (), values: Values | None = None
    ) -> Structure:
        """Return this with other ``effects`` and ``parts``; numbers that are not known start as declared."""
        structure = replace(self, effects=tuple(effects), parts=tuple(parts))
        known = {**structure.values, **(values or {})}
        terms = [term(name) for effect in structure.effects for name in EFFECTS[effect].terms]
        declared = [p for entry in terms for p in entry.parameters]
        declared += [p for key in structure.parts for p in CHAIN_PARTS[key].parameters]
        for parameter in declared:
            known.setdefault(parameter.name, parameter.start)
        return replace(structure, values=known)

    def without(self, name: str) -> Structure:
        """Return this without the effect or part called ``name``."""
        return replace(
            self,
            effects=tuple(one for one in self.effects if one != name),
            parts=tuple(one for one in self.parts if one != name),
        )


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
    return bare.read_by(USUAL).having(effects, parts, values)


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
