"""Numbers from which a structure is simulated before it is fitted.

None of them decides anything: they come from the balance of forces along the measured motion, from what each
effect shows alone, from laws that act alike, and from lists where an effect acts in few samples only.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from spool_gap.catalogue import EFFECTS, FRICTIONS
from spool_gap.likelihood.score import MODES, Balance
from spool_gap.likelihood.structure import CHAIN_PARTS, DELAY, GAIN, Structure, Values
from spool_gap.likelihood.structure_fit import StructureFit

#: Starts by the balance of forces, of one effect and of several.
BALANCED = 6
#: Levels of friction, and shares of the drag, that are tried of what the balance of forces gives.
LEVELS, DRAGS = (0.6, 1.0, 1.5, 2.2, 3.3), (1.0, 0.4)
#: Starts of a law of friction that acts like another one.
ALIKE = 4
#: Shares of a mode that are tried, of elastic mountings and of a body that bends.
SHARES = (0.15, 0.6)
#: Sizes of any other part over its typical one.
SIZES = (1.0, 3.0)
#: Signs with which an effect is tried whose numbers may have either.
SIGNS = (1.0, -1.0)


class Starts:
    """Starts of structures on one record.

    Attributes:
        balance: of forces along the measured motion.
    """

    def __init__(self, balance: Balance, names: Sequence[str], furthest: float) -> None:
        """Keep what all starts share.

        Args:
            balance: of forces along the measured motion.
            names: of the effects that may be missing.
            furthest: displacement of the base's motion, m.
        """
        self.balance, self._names = balance, tuple(names)
        self._noted: dict[frozenset[str], list[dict[str, float]]] = {}
        # Where hits are rare, they lie beyond all but a few samples.
        self._ends = balance.reach, float(np.abs(balance.motion.displacement).max()), furthest
        self._fastest = float(np.quantile(np.abs(balance.motion.velocity), 0.99))

    def note(self, names: Sequence[str], values: Mapping[str, float]) -> None:
        """Keep ``values`` as a start of the effects ``names`` together."""
        self._noted.setdefault(frozenset(names), []).append(dict(values))

    def of(self, wider: Structure, own: Structure, singles: Sequence[StructureFit]) -> list[dict[str, float]]:
        """Return starts of ``wider``, ``own`` with its effects; ``singles``: fits with one of them alone."""
        chain = {p.name: own.values[p.name] for part in own.chain for p in part.parameters}
        found = [
            {**self._noted_values(one, wider), **chain}
            for one in self._noted.get(frozenset(wider.effects), ())
        ]
        numbers = {
            own_name: one.structure.values[own_name]
            for one in singles
            for name in one.structure.effects
            for own_name in EFFECTS[name].fitted
        }
        of_base = [
            {p.name: one.structure.values[p.name] for p in one.structure.base_unknowns} for one in singles
        ]
        found += [{**base, **numbers, **chain} for base in of_base if len(singles) == len(wider.effects)]
        balanced = sorted(self.balance.starts(wider.effects), key=lambda one: one.left)
        # What the base makes of gain and delay belongs to a model without the effect.
        nominal = {**chain, GAIN: 0.0, DELAY: 0.0}
        for one in balanced[:BALANCED]:
            found.append({**nominal, **one.values})
        for name in wider.effects:
            if name in FRICTIONS:
                found += [
                    {**nominal, **one}
                    for one in self._levels(name, [one.values for one in balanced[:3]], own)
                ]
            if EFFECTS[name].localised:
                begun = found[:3] or [dict(wider.values)]
                found += [
                    {**base, **one}
                    for base in begun
                    for end in self._ends
                    for one in EFFECTS[name].starts({**wider.values, **base}, end)
                ]
        if not found or len(wider.effects) == 1:
            found += self._typical(wider)
        return found

    def _noted_values(self, values: Mapping[str, float], wider: Structure) -> dict[str, float]:
        known = {name for effect in wider.effects for name in EFFECTS[effect].fitted}
        known |= {one.name for one in wider.base_unknowns}
        return {name: value for name, value in values.items() if name in known}

    def _typical(self, wider: Structure) -> list[dict[str, float]]:
        """Return typical sizes of the one effect of ``wider``, of either sign."""
        entry = EFFECTS[wider.effects[0]]
        shapes = entry.shapes(self.balance.motion)
        known = [{name: one[name] for name in one if name in wider.values} for one in shapes]
        sizes = [name for name in entry.fitted if not known or name not in known[0]]
        signs = (1.0,) if entry.positive else SIGNS
        return [
            {**shape, **{name: sign * size * wider.values[name] for name in sizes}}
            for shape in (known or [{}])[:: max(1, len(known) // 4)]
            for sign in signs
            for size in (0.2, 1.0)
        ]

    def _levels(
        self, name: str, balanced: Sequence[Mapping[str, float]], own: Structure
    ) -> list[dict[str, float]]:
        """Return ``balanced`` with the law of friction ``name`` at other levels of its force.

        A spool that sticks much shows the balance of forces half of its friction; no fit gets from there to
        all of it, as the reversals of another motion are elsewhere.
        """
        entry = EFFECTS[name]
        scaled = [one for one in entry.fitted if one not in entry.shapes(self.balance.motion)[0]]
        return [
            {
                **one,
                **{number: level * one[number] for number in scaled},
                "viscous_coefficient": share * one["viscous_coefficient"],
                "spring_stiffness": math.sqrt(one["spring_stiffness"] * own.values["spring_stiffness"]),
            }
            for one in balanced
            for level in LEVELS
            for share in DRAGS
        ]

    def like(self, name: str) -> list[str]:
        """Return the effects that act like ``name``."""
        containing = [one for one in self._names if name in EFFECTS[one].replaces]
        plainer = [one for one in EFFECTS[name].replaces if one in self._names]
        frictions = [one for one in self._names if one in FRICTIONS] if name in FRICTIONS else []
        near = [one for one in EFFECTS[name].confusable_with if one in self._names]
        own = [name] if name not in FRICTIONS and len(EFFECTS[name].speeds_to_try(1.0)) > 1 else []
        others = dict.fromkeys([*containing, *plainer, *frictions, *near])
        return [*own, *(one for one in others if one != name)]

    def acting_like(self, name: str, other: str, values: Values) -> Iterator[dict[str, float]]:
        """Yield numbers of ``other`` with which it acts like ``name`` with ``values``."""
        entry = EFFECTS[other]
        if name in FRICTIONS and other in FRICTIONS:
            force = self.balance.force_of(EFFECTS[name].terms, values)
            for one in self.balance.like(other, force)[:ALIKE]:
                drag = values.get("viscous_coefficient", 0.0) + one.values["viscous_coefficient"]
                yield {**one.values, "viscous_coefficient": max(drag, 0.0)}
        elif name in entry.replaces or name == other:
            yield from (
                {**entry.acting_like(values), **speeds} for speeds in entry.speeds_to_try(self._fastest)
            )


def numbers_of_part(key: str) -> Iterator[dict[str, float]]:
    """Yield numbers to try of the part ``key`` of the chain."""
    size, *others = CHAIN_PARTS[key].parameters
    if CHAIN_PARTS[key].id == "extra_mode":
        for frequency in MODES[::2]:
            yield from ({others[0].name: frequency, size.name: one} for one in SHARES)
    else:
        signs = SIGNS if size.low < 0.0 else (1.0,)
        yield from ({size.name: sign * one * size.start} for one in SIZES for sign in signs)


def several(name: str) -> bool:
    """Whether fits of the effect ``name`` have local minima."""
    entry = EFFECTS[name]
    return entry.local_minima or entry.localised or name in FRICTIONS
