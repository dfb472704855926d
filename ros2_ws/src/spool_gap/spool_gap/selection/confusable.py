"""Fits from other places: of effects that act alike, from where the other stands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from spool_identification.least_squares.parallel import in_parallel

from spool_gap.fitting.equivalent_start import acting_alike, slides
from spool_gap.fitting.hypothesis import Step
from spool_gap.registry import EFFECTS
from spool_gap.screening.screening import FRICTIONS
from spool_gap.simulation.point import Point
from spool_gap.simulation.segments import Stretch

from .rules import Rules

#: Cost over the best one up to which a sliding law is started from where it acts like that.
ALIKE = 10.0
#: Starts of those that are followed.
FOLLOWED = 3
#: Cost over that of the best up to which a law that contains that one is fitted on.
HOPEFUL = 2.0
#: Cost over the best one up to which a look-alike is fitted to its last digits.
NEAR = 1.3


@dataclass(slots=True)
class LookAlikes(Rules):
    """Rules, and what gives look-alikes the same chance.

    Attributes:
        whole: the stretches with longer windows; others as those of :class:`Rules`.

    """

    whole: Sequence[Stretch]

    @property
    def reach(self) -> float:
        """The largest travel, m: the 99.9 % quantile."""
        return max(float(np.quantile(np.abs(s.motion.displacement), 0.999)) for s in self.whole)

    def contained(self, tried: list[Step]) -> list[Step]:
        """Return ``tried``; what fits worse than an effect that it contains starts from that once more."""
        by_name = {entry.effects[-1]: entry for entry in tried}

        def from_inner(entry: Step) -> Step:
            best = entry
            for name in EFFECTS[entry.effects[-1]].replaces:
                inner = by_name.get(name)
                if inner is None or inner.cost >= best.cost:
                    continue
                own = EFFECTS[entry.effects[-1]].acting_like(inner.fitted.point.values)
                effects = (*inner.effects[:-1], entry.effects[-1])
                values = {**inner.fitted.point.values, **self.own_of(entry), **own}
                point = replace(inner.fitted.point, values=values, active=self.terms_of(effects))
                again = self.fit(effects, [point], rounds=3, enough=5e-3)
                again.trials = entry.trials
                best = min(best, again, key=lambda one: one.cost)
            return best

        return self._alike(in_parallel(from_inner, tried))

    def _alike(self, tried: list[Step]) -> list[Step]:
        """Return ``tried``; sliding laws near the best one start once more from where they act like that."""
        laws = {entry.effects[-1]: entry for entry in tried if entry.effects[-1] in FRICTIONS}
        laws = {name: entry for name, entry in laws.items() if slides(name)}
        if len(laws) < 2:
            return tried
        best = min(laws.values(), key=lambda entry: entry.cost)
        law = best.effects[-1]

        def from_best(entry: Step) -> Step:
            name = entry.effects[-1]
            # A gain or a delay that one law has let free, and the other not, parts the best of laws.
            freed = best.effects[:-1] != entry.effects[:-1]
            near = entry.cost <= ALIKE * best.cost and name not in EFFECTS[law].replaces
            if name not in laws or entry is best or not (freed or near):
                return entry
            starts = self.acting_like(best, law, name, self.own_of(entry))
            again = self.fit((*best.effects[:-1], name), starts, rounds=3, enough=5e-3)
            again.trials = entry.trials
            return min(entry, again, key=lambda one: one.cost)

        return in_parallel(from_best, tried)

    def acting_like(self, like: Step, law: str, name: str, own: Mapping[str, float]) -> list[Point]:
        """Return points of ``like`` at which ``name``, in place of its ``law``, acts most like that.

        None where one of both does not depend on speed alone; ``own`` are numbers of ``name`` to begin with.
        """
        if not (slides(law) and slides(name)):
            return []
        speed = np.concatenate([np.abs(stretch.motion.velocity) for stretch in self.whole])
        point = like.fitted.point
        active = self.terms_of(tuple(name if entry == law else entry for entry in like.effects))
        found = []
        for speeds in EFFECTS[name].speeds_to_try(float(np.quantile(speed, 0.99))):
            start = replace(point, active=active, values={**point.values, **own, **speeds})
            free = [number for number in EFFECTS[name].fitted if number not in speeds]
            found.append(acting_alike(point, law, start, name, free, speed))
        return found

    def closest(self, step: Step, winner: Step, others: list[Step]) -> Step:
        """Return the best of ``winner`` and the sliding laws close behind it, fitted to their last digits."""
        name = winner.effects[-1]
        if name not in FRICTIONS or not slides(name):
            return winner

        def close(entry: Step) -> bool:
            other = entry.effects[-1]
            rival = other in FRICTIONS and slides(other) and other not in EFFECTS[name].replaces
            return rival and entry.cost < ALIKE * winner.cost

        def closer(entry: Step) -> Step:
            other = entry.effects[-1]
            starts = [entry.fitted.point, *self.acting_like(winner, name, other, self.own_of(entry))]
            found = self.fit((*winner.effects[:-1], other), starts, rounds=5, tries=FOLLOWED)
            found.trials = entry.trials
            return self.polished(found)

        rivals = in_parallel(closer, filter(close, others))
        # Down to the last digits a law may leave what makes sense, as a force at rest below that at speed.
        known = [entry for entry in (winner, *rivals) if not self.senseless(entry, entry.effects[-1])]
        return max(known or [winner], key=lambda entry: self.evidence(step, entry))

    def simplest(self, step: Step, winner: Step, others: Sequence[Step]) -> Step:
        """Return the simplest of ``winner`` and its look-alikes that none of the others clearly beats."""
        name = winner.effects[-1]
        replaced = EFFECTS[name].replaces
        related = [
            own for own in others if own.effects[-1] in replaced or name in EFFECTS[own.effects[-1]].replaces
        ]

        def fitted_on(own: Step) -> Step:
            other = own.effects[-1]
            if other not in replaced or not slides(name):
                return self.polished(own)
            # Where the spool sticks the sum of squares is rough: the simpler law may have ended in a dent.
            starts = [own.fitted.point, *self.acting_like(winner, name, other, self.own_of(own))]
            found = self.fit((*winner.effects[:-1], other), starts, rounds=7, tries=len(starts))
            found.trials = own.trials
            return found

        hopeful = [own for own in related if own.effects[-1] in replaced or own.cost < HOPEFUL * winner.cost]
        fitted = in_parallel(fitted_on, hopeful)
        family = [winner, *(own for own in fitted if not self.refusal(step, own, step.cost - own.cost))]
        family.sort(key=lambda entry: len(entry.fitted.free))
        best = family[0]
        for entry in family[1:]:
            same = len(entry.fitted.free) == len(best.fitted.free)
            if entry.cost < best.cost if same else self.beats_simpler(best, entry):
                best = entry
        return best
