"""Structure of a hypothesis: what acts on the spool and in the measuring chain, with every number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from spool_estimator.identification.least_squares import Unknown
from spool_sim.model import Model
from spool_sim.terms import term
from spool_sim.valve import Valve

from spool_gap.registry import EFFECTS

from .chain_part import CHAIN_PARTS, DELAY, GAIN, SPOOL_DELAY, SPOOL_GAIN, ChainPart, Spectrum

Array = NDArray[np.float64]
Values = Mapping[str, float]

#: m of travel before sliding that a record of an accelerometer shows at least; below, it is Coulomb friction.
SHORTEST = 1e-6
#: Factor by which the spring may be off its description: play and stops have local minima without a spring.
OFF = 5.0


@dataclass(frozen=True, slots=True)
class Structure:
    """What is thought to act, with its numbers.

    Attributes:
        base: names of the base's force terms.
        base_unknowns: what is fitted of the base.
        effects: ids of the catalogue.
        parts: keys of ``CHAIN_PARTS``.
        values: every number by name, SI.
    """

    base: tuple[str, ...]
    base_unknowns: tuple[Unknown, ...]
    effects: tuple[str, ...]
    parts: tuple[str, ...]
    values: Values

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
                _with_travel(one, self.values) for one in EFFECTS[effect].unknowns(self.values, seconds)
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
        return _started(replace(self, effects=tuple(effects), parts=tuple(parts)), values or {})

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


def _with_travel(unknown: Unknown, values: Values) -> Unknown:
    """Return ``unknown``; the stiffness of friction before it slides leaves it some travel."""
    if unknown.name != "dahl_stiffness":
        return unknown
    return replace(unknown, high=min(unknown.high, max(values.get("dahl_force", 0.0), 1e-6) / SHORTEST))


def _started(structure: Structure, values: Values) -> Structure:
    known = {**structure.values, **values}
    for effect in structure.effects:
        for name in EFFECTS[effect].terms:
            for parameter in term(name).parameters:
                known.setdefault(parameter.name, parameter.start)
    for key in structure.parts:
        for parameter in CHAIN_PARTS[key].parameters:
            known.setdefault(parameter.name, parameter.start)
    return replace(structure, values=known)
