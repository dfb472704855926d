"""By which rules hypotheses are compared: evidence, sense, the simpler of two that do alike."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from spool_identification.least_squares.parallel import in_parallel
from spool_sim.terms import term

from spool_gap.fitting.hypothesis import DELAY, GAIN, Fitting, Step
from spool_gap.registry import EFFECTS
from spool_gap.simulation.segments import span_of

Array = NDArray[np.float64]

#: Twice the log likelihood ratio on held-out data, less the price of the parameters, that an effect needs.
EVIDENCE = 40.0
#: Share of the weighed sum of squares that it must take away at least.
RELATIVE = 4e-3
#: Share of the measured acceleration, rms, that it must explain: less is within what any simulation errs.
SMALLEST = 5e-4
#: Share of the power of what is left that a further effect must explain beside others.
BESIDE = 0.08
#: The same of what noise does not leave.
OPEN = 0.1
#: Share of the windows, those most helped, without which a further effect must still help.
MOST_HELPED = 0.15
#: Error over the noise floor up to which nothing is left: chance does not lead there. And up to which it is
#: noise where what is left cannot be foretold.
AT_FLOOR, CLOSED = 1.2, 1.3
#: Error over that with an effect up to which others do without it.
NO_WORSE = 1.01
#: Evidence by which a richer effect must beat a simpler one that it contains.
RICHER = 16.0
#: Probability that it does so in as many windows by chance, and the fewest windows that such a test takes.
BY_CHANCE, FEWEST = 0.005, 8
#: Share of the weighed sum of squares by which it must do so in fewer, and one that is only alike in any.
CLEARLY = 0.03
#: Numbers that may end at a bound without harm: contact parts that vanish.
FREE_TO_VANISH = (
    "mixed_root_coefficient",
    "coulomb_force",
    "stribeck_exponent",
    "preload_travel",
    "stop_dissipation",
    "stop_damping",
    "mixed_velocity",
)


@dataclass(slots=True)
class Rules(Fitting):
    """Fits, and how they are chosen among.

    Attributes:
        small: effects count that no half of the data shows, see :mod:`.small_effects`.
        floor: what noise leaves of the accepted hypothesis, over the measured acceleration; others: see
            :class:`Fitting`.
    """

    small: bool = field(default=True, kw_only=True)
    floor: float = field(default=0.0, kw_only=True)

    @staticmethod
    def own_of(entry: Step) -> dict[str, float]:
        """Return the numbers of the newest effect of ``entry``, SI."""
        return {name: entry.fitted.point.get(name) for name in EFFECTS[entry.effects[-1]].fitted}

    def evidence(self, step: Step, entry: Step) -> float:
        """Return the evidence for ``entry`` over ``step``: gain or delay out of tolerance counts."""
        sensors = {GAIN, DELAY}
        numbers = len(entry.fitted.free) - len(step.fitted.free)
        numbers += len(sensors & set(entry.effects)) - len(sensors & set(step.effects))
        return step.cost - entry.cost - self.price * numbers

    def polished(self, step: Step, rounds: int = 7) -> Step:
        """Return ``step`` fitted on from its own numbers, for ``rounds`` at most, or settled as it is."""
        if step.fitted.settled is self.simulation.weighing:
            return step
        found = self.fit(step.effects, [step.fitted.point], rounds=rounds)
        found.trials = step.trials
        return found

    def beats_simpler(self, simple: Step, rich: Step) -> bool:
        """Whether ``rich`` beats ``simple``, which it contains, in the sum and window by window."""
        numbers = len(rich.fitted.free) - len(simple.fitted.free)
        gain = simple.cost - rich.cost - self.price * numbers
        return gain > RICHER and in_windows(simple.costs - rich.costs, gain / rich.cost)

    def still_better(self, step: Step, winner: Step) -> bool:
        """Whether ``winner`` beats ``step`` even where that goes on from the numbers of ``winner``."""
        point = replace(winner.fitted.point, active=self.terms_of(step.effects))
        again = self.fit(step.effects, [point], rounds=5)
        if again.cost >= step.cost:
            return True
        numbers = len(winner.fitted.free) - len(again.fitted.free)
        if again.cost - winner.cost - self.price * numbers > max(EVIDENCE, RELATIVE * again.cost):
            return True
        step.take(again)
        return False

    @property
    def price(self) -> float:
        """What a further number must bring, ln of the samples held out (Schwarz's criterion)."""
        sizes = [window.stop - window.start for _, window, training in self.simulation.places if not training]
        return math.log(max(10, sum(sizes)))

    @staticmethod
    def has_jumps(step: Step) -> bool:
        """Whether the force of ``step`` jumps where the velocity changes its sign."""
        laws = {law for name in step.fitted.point.active for law in term(name).laws}
        return bool(laws & {"sliding_law", "memory_law"})

    @classmethod
    def has_kinks(cls, step: Step) -> bool:
        """Whether the force of ``step`` jumps, or its slope over the displacement does."""
        laws = {law for name in step.fitted.point.active for law in term(name).laws}
        return cls.has_jumps(step) or "levels_law" in laws

    def refusal(self, step: Step, entry: Step, evidence: float) -> str:
        """Return why ``entry`` is not taken in place of ``step``, or an empty string."""
        if evidence < max(EVIDENCE, RELATIVE * step.cost):
            return "it does not close the gap significantly"
        falls = [
            before**2 - after**2 < max(SMALLEST**2, self._least_share(step, before) * before**2)
            for before, after in (
                (self.nrmse(step), self.nrmse(entry)),
                (self.usual_nrmse(step), self.usual_nrmse(entry)),
            )
        ]
        if all(falls):
            return "it is too small to be told from errors of the simulation"
        name = entry.effects[-1]
        if step.effects and self._by_chance(step, entry):
            return "it helps in few windows only, as chance does where the motion is sensitive"
        values = {f.name: entry.fitted.point.get(f.name) for f in entry.fitted.free}
        if name in (GAIN, DELAY):
            if abs(values[name]) < self.tolerance(name) + 2.0 * entry.fitted.deviations[name]:
                return "it is not significantly beyond its tolerance"
            return ""
        return self.senseless(entry, name)

    def _by_chance(self, step: Step, entry: Step) -> bool:
        """Whether ``entry`` helps ``step`` in few windows only, and not down to the floor."""
        name = entry.effects[-1]
        local = name not in EFFECTS or EFFECTS[name].rare or EFFECTS[name].follows_time
        closes = self.nrmse(entry) < AT_FLOOR * self.floor
        return not (local or closes) and _in_most(step, entry) < EVIDENCE

    def _least_share(self, step: Step, before: float) -> float:
        """Return the share of the power ``before`` that an effect beside those of ``step`` must explain."""
        if not step.effects:
            return 0.0
        return min(BESIDE, OPEN * max(0.0, 1.0 - (self.floor / before) ** 2))

    @staticmethod
    def senseless(entry: Step, name: str) -> str:
        """Return why the numbers of the effect ``name`` in ``entry`` make no sense, or an empty string."""
        own = [bound for bound in entry.fitted.at_bound if bound in EFFECTS[name].fitted]
        own = [bound for bound in own if bound not in FREE_TO_VANISH]
        if own:
            return f"{', '.join(own)} stopped at a bound"
        values = {f.name: entry.fitted.point.get(f.name) for f in entry.fitted.free}
        return EFFECTS[name].sensible(values, entry.fitted.deviations)

    @staticmethod
    def vanished(entry: Step, name: str) -> bool:
        """Whether what is 0 without the effect ``name`` is, in ``entry``, smaller than its uncertainty."""
        own = EFFECTS[name].amplitudes
        values, spread = entry.fitted.point.values, entry.fitted.deviations
        return bool(own) and all(abs(values[number]) < spread.get(number, 0.0) for number in own)

    def trifling(self, entry: Step, name: str) -> bool:
        """Whether the effect ``name`` of ``entry`` is too small to mean anything on a machine."""
        return EFFECTS[name].trifling(entry.fitted.point.values, span_of(self.stretches))

    def tolerance(self, name: str) -> float:
        """Return how far gain or delay may be off."""
        return self.settings.gain_tolerance if name == GAIN else self.settings.delay_tolerance

    def usual_nrmse(self, step: Step) -> float:
        """Held out, in the median window: those in which the motion goes another way count no more."""
        measured = self.simulation.measured(self.simulation.held_out)
        shares = [
            float(np.sum(error**2)) / max(1e-30, float(np.sum(own**2)))
            for error, own in zip(step.held, measured, strict=True)
        ]
        return math.sqrt(float(np.median(shares)))

    def without_needless(self, step: Step) -> Step:
        """Return ``step`` without the effects that it no longer needs beside its newest."""
        for name in step.effects[:-1]:
            less = self.without(step, [name])
            if self._does_as_well(less, step):
                return less
        return step

    def needless(self, step: Step) -> list[str]:
        """Return the first effect beside others without which ``step`` does as well, if there is one."""
        names = step.effects if len(step.effects) > 1 else ()
        for name, less in zip(
            names, in_parallel(lambda name: self.without(step, [name]), names), strict=True
        ):
            if self._does_as_well(less, step) or self.nrmse(less) < NO_WORSE * self.nrmse(step):
                return [name]
        return []

    def without(self, step: Step, names: Collection[str]) -> Step:
        """Return ``step`` without the effects ``names``, fitted."""
        effects = tuple(entry for entry in step.effects if entry not in names)
        less = self.fit(effects, [replace(step.fitted.point, active=self.terms_of(effects))])
        less.trials = {e: t for e, t in step.trials.items() if e not in names}
        return less

    def _does_as_well(self, less: Step, step: Step) -> bool:
        gain = less.cost - step.cost - self.price * (len(step.fitted.free) - len(less.fitted.free))
        return gain < EVIDENCE or gain < RELATIVE * step.cost


def in_windows(gains: Array, share: float) -> bool:
    """Whether what a richer law gains in each window is more than chance.

    What simulations of friction err by is large in few windows: there a richer law gains by chance. The
    windows are independent, so the sign and rank of each gain tell (Wilcoxon, Biometrics Bulletin 1, 1945).

    Args:
        gains: falls of the weighed sum of squares, one a window, shape (w,).
        share: the fall of all, as a share of the sum that is left; it decides where windows are too few.
    """
    if gains.size < FEWEST:
        return share > CLEARLY
    return float(stats.wilcoxon(gains, alternative="greater").pvalue) < BY_CHANCE


def _in_most(step: Step, entry: Step) -> float:
    """Return by how much ``entry`` lowers the cost of ``step`` without the windows in which it does most."""
    fall = np.sort(step.costs - entry.costs)
    return float(fall[: fall.size - math.ceil(MOST_HELPED * fall.size)].sum())
