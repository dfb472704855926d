"""Search for the most likely structures: what is added to the base, exchanged, and left out again.

Every addition that a score test finds promising is fitted, from the base and from each of the best
structures in turn, so that no step is final. Then each effect is exchanged for those that act alike, and
each component is left out to see what it is worth. Everything that was fitted stays, for the decision.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from spool_gap.catalogue import EFFECTS, FRICTIONS
from spool_gap.likelihood.prediction import Predictions
from spool_gap.likelihood.score import (
    MODES,
    Balance,
    Proposal,
    best_of,
    close_proposals,
    proposals,
    resolved_by,
)
from spool_gap.likelihood.structure import CHAIN_PARTS, DELAY, GAIN, Structure, Values
from spool_gap.likelihood.structure_fit import ENOUGH, LOOSENESS, STEPS, StructureFit, fit_structure, judged

Key = tuple[frozenset[str], frozenset[str]]

#: Looseness at which starts are compared and fitted first, where fits have few minima, and of those starts
#: that a regression finds near the minimum.
LOOSE, TIGHT = LOOSENESS[0], 0.03
#: Looseness up to which structures are compared: a looser one follows the measured motion, whatever acts.
COMPARED = LOOSENESS[2]
#: Starts that are fitted of a stop, and of other effects whose fits have local minima; steps of such a fit.
STARTS, MOST_STARTS, QUICK = 2, 5, 4
#: Looseness at which starts of a contact are compared: a motion bound too closely hides its few samples.
CONTACTS = (LOOSENESS[0], LOOSENESS[2])
#: Starts by the balance of forces, and share of what the base leaves of that from which an effect is fitted.
BALANCED, SPEAKS = 3, 0.95
#: Parts that are modes, and shares of them that are tried, of elastic mountings and of a body that bends.
MOUNTINGS = tuple(key for key, part in CHAIN_PARTS.items() if part.id == "extra_mode")
SHARES = (0.15, 0.6)
#: Levels of friction, and shares of the drag, that are tried of what the balance of forces gives.
LEVELS, DRAGS = (0.6, 1.0, 1.5, 2.2, 3.3), (1.0, 0.4)
#: Starts of a law of friction that acts like another one.
ALIKE = 4
#: Steps of a fit while structures are only compared.
BRIEF = 15
#: Draws around the best structure's numbers, and their standard deviations (ln): a factor of 3 either way,
#: and 5 %, by which a gain within the tolerance of a data sheet makes them wrong.
DRAWS, SHAKEN, GENTLY = 24, 1.1, 0.05
#: Rise of the log likelihood that ends a fit while structures are only compared: at least, and as a share of
#: what the best one gains over the base.
ROUGH, ROUGHLY = 3.0, 1e-3
#: Structures that are extended side by side, and additions to each that are fitted at most.
BEAM, MOST_ADDED = 2, 5
#: Share of the best structure's gain over the base from which the next one is extended, too.
NEAR_BEST = 0.95
#: Components of a structure at most: effects, and parts of the chain.
MOST_EFFECTS, MOST_PARTS = 3, 5
#: Share of the best proposal's gain from which another one is fitted.
HOPEFUL = 0.1
#: Evidence (log likelihood less its penalty) from which a component stays: twice what counts as decisive
#: (Kass and Raftery, 1995), since many are tried.
DECISIVE = 10.0
#: Evidence by which a structure without a component must be behind not to be fitted to its end, and share of
#: what an effect explains that one in its place must explain in a brief fit.
CLOSE, NEARLY = 100.0, 0.8


class Search:
    """Search over structures of one valve and record.

    Attributes:
        fits: the most likely fit of each structure that was tried.
    """

    def __init__(
        self,
        predictions: Predictions,
        base: Structure,
        names: Sequence[str],
        tell: Callable[[str, float], None] = lambda _what, _share: None,
        allowed: float = math.inf,
    ) -> None:
        """Fit the base.

        Args:
            predictions: of the record.
            base: with the numbers of the valve's description.
            names: of the effects that may be missing.
            tell: takes what is done and the share of the work.
            allowed: steps of integration, after which nothing further is tried.
        """
        self._predictions, self._names, self._tell = predictions, tuple(names), tell
        self._allowed = allowed
        self.fits: dict[Key, StructureFit] = {}
        self._numbers: dict[str, dict[str, float]] = {}
        self._exchanges: set[Key] = set()
        self._shaken: set[Key] = set()
        base = replace(base, limits=resolved_by(predictions))
        tell("fitting the base", 0.1)
        rough = fit_structure(predictions, base)
        self._brief = predictions.excerpt(predictions.parts[0].motions)
        for part in {*predictions.parts, *self._brief.parts}:
            part.leave_out_reversals()
        self.base = judged(predictions, rough)
        for one, looseness in ((rough.structure, LOOSE), (base, TIGHT)):
            self.base = self._tighten(one, looseness)
        values = self.base.structure.values
        damping = values.get("viscous_coefficient", 0.0)
        self._balance = Balance(predictions, values["spring_stiffness"], damping, names)

    @property
    def late(self) -> bool:
        """Whether no further structure is tried."""
        return self._work > self._allowed

    @property
    def _work(self) -> float:
        """Steps of integration so far."""
        return sum(one.work for one in {self._predictions, self._brief})

    @property
    def best(self) -> StructureFit:
        """The structure with the most evidence among those that make sense on a machine."""
        return max(self._sensible(), key=lambda one: one.evidence)

    def _sensible(self) -> list[StructureFit]:
        return [one for one in self.fits.values() if not senseless(one)]

    @property
    def of_each_set(self) -> dict[frozenset[str], StructureFit]:
        """The likeliest fit with each set of effects, whatever its measuring chain."""
        rising = sorted(self.fits.values(), key=lambda one: one.evidence)
        return {frozenset(one.structure.effects): one for one in rising}

    @property
    def simplest(self) -> StructureFit:
        """The structure with the fewest numbers among those whose evidence does not decide against it."""
        least = self.best.evidence - DECISIVE
        near = [one for one in self._sensible() if one.evidence >= least]
        return min(near, key=lambda one: (one.count, -one.evidence))

    @property
    def _enough(self) -> float:
        """Rise of the log likelihood that ends a fit while structures are only compared."""
        if not self.fits:
            return ROUGH
        return max(ROUGH, ROUGHLY * (self.best.log_likelihood - self.base.log_likelihood))

    def without(self, fit: StructureFit, name: str) -> StructureFit | None:
        """Return the fit of ``fit`` without the effect ``name``, if there is one."""
        return self.fits.get(fit.structure.without(name).key)

    def run(self) -> None:
        """Extend, exchange and leave out until nothing is more likely."""
        self._extend([self.base])
        while not self.late and self._exchanged():
            self._extend([self.best])
        self._polish()
        self._shake()
        # Numbers that make no sense on a machine say in most cases that a plainer law is enough.
        self._plainer(max(self.fits.values(), key=lambda one: one.evidence))
        for _ in range(3):
            before = self.simplest
            self.leave_out(before)
            self._plainer(before)
            if self.simplest.structure.key == before.structure.key:
                break

    def tried(self, one: Structure) -> StructureFit:
        """Return the likeliest fit of ``one`` from its numbers, by strong and by weak corrections.

        It is kept for the decision, where it is likelier than what is known.
        """
        for looseness in (COMPARED, LOOSE):
            found = self._tighten(one.bounded(self._predictions.seconds), looseness)
        self._settle(found.structure, found.looseness)
        return self.fits[one.key]

    def _polish(self) -> None:
        """Fit on what may turn out to be the best."""
        least = self.best.evidence - 5.0 * self._enough
        for one in [fit for fit in self._sensible() if fit.evidence > least]:
            self._settle(one.structure, one.looseness)

    def _shake(self) -> None:
        """Look for a better minimum of the best structure: from its numbers, each several times off."""
        best = self.best
        if self.late or best.structure.key in self._shaken:
            return
        self._shaken.add(best.structure.key)
        names = [own for name in best.structure.effects if _several(name) for own in EFFECTS[name].fitted]
        if not names:
            return
        own = best.structure
        generator = np.random.default_rng(0)
        far = np.exp(generator.normal(0.0, SHAKEN, (DRAWS, len(names)))).tolist()
        for one in self._likeliest(self._scaled(own, names, far), LOOSENESS[1]):
            begun = self._fit(one, (LOOSENESS[1],)).structure
            self._keep(self._fit(begun, (best.looseness,)))
        if any(EFFECTS[name].localised for name in own.effects):
            # A gain that is a little wrong, and springs and clearances that make up for it, are a valley.
            nominal = own.moved({GAIN: 0.0, DELAY: 0.0})
            everything = [*names, *(one.name for one in own.base_unknowns)]
            near = np.exp(generator.normal(0.0, GENTLY, (DRAWS, len(everything)))).tolist()
            starts = [nominal, *self._likeliest(self._scaled(nominal, everything, near), TIGHT)]
            for one, share in zip(starts, (COMPARED, *[TIGHT] * STARTS), strict=True):
                begun = self._fit(one, (share,)).structure
                tighter = [at for at in LOOSENESS if min(best.looseness, share) <= at <= share]
                self._keep(self._fit(begun, tighter))
        if self.best.evidence > best.evidence + ROUGH:
            self._settle(self.best.structure, self.best.looseness)

    def _scaled(self, own: Structure, names: Sequence[str], factors: list[list[float]]) -> list[Structure]:
        """Return ``own`` with the numbers called ``names`` times each row of ``factors`` (draws, names)."""
        return [
            own.moved(
                {name: own.values[name] * factor for name, factor in zip(names, row, strict=True)}
            ).bounded(self._predictions.seconds)
            for row in factors
        ]

    def _settle(self, one: Structure, looseness: float) -> None:
        """Fit ``one`` to its end; with forces that jump at last by all that corrects the motion."""
        found = self._keep(self._fit(one, (looseness,), enough=ENOUGH, steps=STEPS))
        if one.jumps:
            self._keep(fit_structure(self._predictions, found.structure, (looseness,)))

    # Steps ----------------------------------------------------------------------------------------------

    def _extend(self, frontier: Sequence[StructureFit]) -> None:
        """Add what is promising to the structures of ``frontier`` and to what comes of them."""
        expanded: set[Key] = set()
        queue = list(frontier)
        while queue and not self.late:
            for fit in queue:
                expanded.add(fit.structure.key)
                self._tell(f"adding to {_named(fit)}", 0.2 + 0.05 * min(len(expanded), 10))
                self._add_to(fit)
            # What is added next shows beside the best minimum only.
            self._shake()
            # One of a pair may stand for a law like it: that is seen before a third effect is tried.
            if len(self.best.structure.effects) > 1:
                self._exchanged()
            queue = self._next(expanded)

    def _next(self, expanded: set[Key]) -> list[StructureFit]:
        """Return which structures are extended next: what is decisively better than those that were.

        Next to the best single component the second best is extended, if that is nearly as likely.
        """
        done = [one.evidence for one in self._sensible() if one.structure.key in expanded]
        known = max(done, default=-math.inf)
        ranked = sorted(self._sensible(), key=lambda one: -one.evidence)
        gain = ranked[0].evidence - self.base.evidence
        found = [ranked[0]] if ranked[0].evidence > known + DECISIVE else []
        singles = [one for one in ranked if len(one.structure.effects) + len(one.structure.parts) == 1]
        least = self.base.evidence + max(DECISIVE, NEAR_BEST * gain)
        found += [one for one in singles[:BEAM] if one.evidence > least]
        return [one for one in dict.fromkeys(found) if one.structure.key not in expanded]

    def _add_to(self, fit: StructureFit) -> None:
        """Fit ``fit`` with one component more: first briefly, then those that are promising.

        The most promising one is fitted even when the search is late. The others may take half of the steps
        that are left, so that a pair is looked for, too, where single effects take long.
        """
        until = 0.5 * (self._work + self._allowed)
        own, penalty = fit.structure, 0.5 * math.log(self._predictions.numbers)
        allowed = [name for name in self._names if self._may_add(own, name)]
        # Once something is found, the motion of the fit shows what is small.
        known = bool(own.effects or own.parts)
        shares = dict.fromkeys((LOOSE, TIGHT, COMPARED, *((fit.looseness,) if known else ())))
        close = close_proposals(self._predictions, fit, allowed) if known else {}
        quick: list[tuple[float, StructureFit]] = []
        before: dict[bool, float] = {}
        found = proposals(self._predictions, fit, allowed)
        # What the measured motion does not show at all has no gain there; hits are where reversals hide them.
        hit = self._balance.hit or not own.effects
        local = {name for name in allowed if hit and EFFECTS[name].localised}
        nothing = {name: Proposal(name, own.values, 0.0, 0) for name in local} | close
        nothing |= {key: Proposal(key, own.values, 0.0, 0) for key in MOUNTINGS if key not in own.parts}
        missed = set(nothing) - {rows[0].name for rows in found}
        found += [[replace(nothing[name], gain=0.0)] for name in sorted(missed)]
        always = local | set(MOUNTINGS)
        for rows in self._with_balanced(found, own, allowed):
            if self.late:
                break
            best = best_of(rows)
            if best.name in CHAIN_PARTS and len(own.parts) >= MOST_PARTS:
                continue
            hidden = best.name in EFFECTS and EFFECTS[best.name].local_minima and not own.effects
            near = close.get(best.name)
            if near is not None and near.gain < DECISIVE + near.count * penalty:
                near = None
            if best.gain > best.count * penalty or near is not None or hidden or best.name in always:
                for tried in self._quick(fit, rows, near):
                    jumps = tried.structure.jumps
                    if jumps not in before:
                        rough = [self._fit(own, (one,), jumps=jumps, brief=True) for one in shares]
                        before[jumps] = max(one.log_likelihood for one in rough)
                    quick.append((tried.log_likelihood - before[jumps], tried))
        quick.sort(key=lambda row: -row[0])
        for gain, one in quick[:MOST_ADDED]:
            hopeful = gain >= max(1.0, HOPEFUL * quick[0][0])
            if hopeful and (self._work < until or one is quick[0][1]):
                self._tighten(one.structure, one.looseness)

    def _fit(
        self,
        one: Structure,
        looseness: Sequence[float],
        *,
        jumps: bool | None = None,
        steps: int = BRIEF,
        enough: float | None = None,
        brief: bool = False,
    ) -> StructureFit:
        """Return the fit of ``one``, without samples at reversals where its force ``jumps`` there.

        A ``brief`` one is of few steps and of excerpts of the record.
        """
        # A force that jumps is fitted without what depends on the instants of its jumps; they are not heard
        # either, as errors would be moved there.
        apart = one.jumps if jumps is None else jumps
        predictions = self._brief if brief else self._predictions
        with predictions.reversals(counted=not apart, heard=not apart):
            return fit_structure(
                predictions, one, looseness, steps=QUICK if brief else steps, enough=enough or self._enough
            )

    def _may_add(self, own: Structure, name: str) -> bool:
        if (
            name in own.effects
            or len(own.effects) >= MOST_EFFECTS
            or set(EFFECTS[name].terms) & set(own.terms)
        ):
            return False
        return not (name in FRICTIONS and any(one in FRICTIONS for one in own.effects))

    def _exchanged(self) -> bool:
        """Whether the best structure with one effect exchanged is more likely than it."""
        best = self.best
        if best.structure.key in self._exchanges:
            return False
        self._exchanges.add(best.structure.key)
        for name in best.structure.effects:
            for other in self._like(name):
                if self.late:
                    break
                if other in best.structure.effects and other != name:
                    continue
                bare = best.structure.without(name)
                if not self._may_add(bare, other):
                    continue
                self._tell(f"{other.replace('_', ' ')} in place of {name.replace('_', ' ')}", 0.7)
                start = bare.having((*bare.effects, other), bare.parts)
                known = self.fits.get(start.key)
                starts = list(self._acting_like(name, other, best.structure.values))
                if starts and (known is None or known.evidence < best.evidence or other == name):
                    self._exchange(bare, other, best, starts)
        return self.best.structure.key != best.structure.key

    def _exchange(
        self, bare: Structure, other: str, best: StructureFit, starts: Sequence[dict[str, float]]
    ) -> None:
        """Fit ``bare`` with ``other`` from ``starts``, if that explains nearly what ``best`` does."""
        wider = bare.having((*bare.effects, other), bare.parts)
        trials = [wider.moved({**best.structure.values, **one}) for one in starts]
        trials = [one.bounded(self._predictions.seconds) for one in trials]
        near = self._likeliest(trials, best.looseness)
        known, without, *found = [
            self._fit(one, (best.looseness,), jumps=wider.jumps, brief=True)
            for one in (best.structure, bare, *near)
        ]
        least = without.log_likelihood + NEARLY * (known.log_likelihood - without.log_likelihood)
        for one in found:
            if one.log_likelihood > least:
                self._tighten(one.structure, best.looseness)

    def _like(self, name: str) -> list[str]:
        """Return the effects that act like ``name``."""
        containing = [one for one in self._names if name in EFFECTS[one].replaces]
        frictions = [one for one in self._names if one in FRICTIONS] if name in FRICTIONS else []
        near = [one for one in EFFECTS[name].confusable_with if one in self._names]
        own = [name] if name not in FRICTIONS and len(EFFECTS[name].speeds_to_try(1.0)) > 1 else []
        others = dict.fromkeys([*containing, *frictions, *near])
        return [*own, *(one for one in others if one != name)]

    def _acting_like(self, name: str, other: str, values: Values) -> Iterator[dict[str, float]]:
        """Yield starts of ``other`` in place of ``name``."""
        entry = EFFECTS[other]
        if name in FRICTIONS and other in FRICTIONS:
            force = self._balance.force_of(EFFECTS[name].terms, values)
            for one in self._balance.like(other, force)[:ALIKE]:
                drag = values.get("viscous_coefficient", 0.0) + one.values["viscous_coefficient"]
                yield {**one.values, "viscous_coefficient": max(drag, 0.0)}
        elif name in entry.replaces or name == other:
            yield from (
                {**entry.acting_like(values), **speeds} for speeds in entry.speeds_to_try(self._fastest)
            )
        known = self.fits.get((frozenset([other]), frozenset()))
        if known is not None:
            yield {one: known.structure.values[one] for one in entry.fitted if one in known.structure.values}

    def _plainer(self, fit: StructureFit) -> None:
        """Fit ``fit`` with the plainer laws that its laws contain, however late it is."""
        for name in fit.structure.effects:
            bare = fit.structure.without(name)
            for plain in EFFECTS[name].replaces:
                starts = list(self._acting_like(name, plain, fit.structure.values))
                key = frozenset([*bare.effects, plain]), frozenset(bare.parts)
                if plain in self._names and starts and key not in self.fits:
                    self._exchange(bare, plain, fit, starts)

    def leave_out(self, fit: StructureFit) -> None:
        """Fit ``fit`` without each of its components."""
        for name in (*fit.structure.effects, *fit.structure.parts):
            bare = fit.structure.without(name)
            known = self.fits.get(bare.key)
            self._tell(f"without {name.replace('_', ' ')}", 0.8)
            for one in [bare] if known is None else [bare.moved(known.structure.values), bare]:
                found = self._keep(self._fit(one, (fit.looseness,)))
                if found.evidence > fit.evidence - CLOSE:
                    self._settle(found.structure, fit.looseness)

    # Fits -----------------------------------------------------------------------------------------------

    def _quick(
        self, fit: StructureFit, starts: Sequence[Proposal], near: Proposal | None
    ) -> list[StructureFit]:
        """Return brief fits of ``fit`` with what ``starts`` propose: the most likely of each of its forms.

        ``near``, by the motion of ``fit`` itself, is fitted with its correction.
        """
        own, name, seconds = fit.structure, starts[0].name, self._predictions.seconds
        effect = name in EFFECTS
        wider = own.having(
            (*own.effects, name) if effect else own.effects, own.parts if effect else (*own.parts, name)
        )
        best = wider.moved(best_of(starts).values).bounded(seconds)
        trials = [wider.moved(one.values).bounded(seconds) for one in starts]
        quick: list[StructureFit] = []
        if name in self._numbers:
            trials = [best.moved(self._numbers[name]), best]
        elif effect and EFFECTS[name].localised:
            # Where hits are rare, they lie beyond all but a few samples.
            ends = self._balance.reach, float(np.abs(self._balance.motion.displacement).max())
            more = [one for end in ends for one in EFFECTS[name].starts(best.values, end)]
            trials += [wider.moved(one).bounded(seconds) for one in more]
            for share in CONTACTS:
                quick += [self._fit(one, (share,), brief=True) for one in self._likeliest(trials, share)]
            trials = []
        elif name in MOUNTINGS:
            # A strong mode is far from the small one that a score test sees.
            trials += [wider.moved(one).bounded(seconds) for one in _mountings(name)]
            likeliest = self._likeliest(trials, COMPARED)
            quick += [self._fit(one, LOOSENESS[1:3], brief=True) for one in likeliest]
            trials = []
        elif effect and _several(name) and not own.effects:
            places = np.linspace(0, len(trials) - 1, min(MOST_STARTS, len(trials))).round().astype(int)
            trials = [trials[place] for place in places.tolist()]
        else:
            # Of each form of the effect, as a line or a bend over time, the best.
            forms = {len(wider.moved(one.values).unknowns(seconds)): one for one in reversed(starts)}
            forms |= {len(best.unknowns(seconds)): best_of(starts)}
            trials = [wider.moved(one.values).bounded(seconds) for one in forms.values()]
        quick += [self._fit(one, (LOOSE,), brief=True) for one in trials]
        if near is not None:
            begun = wider.moved(near.values).bounded(seconds)
            quick.append(self._fit(begun, (fit.looseness,), brief=True))
        if own.effects:
            # What is fitted already need not be found again by a loose correction.
            kept = best.moved({one: own.values[one] for one in fit.names})
            quick.append(self._fit(kept, (fit.looseness,), brief=True))
        if effect:
            balanced = self._by_balance(wider)
            quick += [self._fit(one, (TIGHT,), brief=True) for one in balanced]
            if name in FRICTIONS and balanced:
                levels = self._levels(name, balanced, own)
                quick += [
                    self._fit(one, (COMPARED,), brief=True) for one in self._likeliest(levels, COMPARED)
                ]
        else:
            # Compared with what the structure without it leaves at either looseness.
            loose = max(quick, key=lambda one: one.evidence)
            quick.append(self._fit(loose.structure, (TIGHT,), brief=True))
        found: dict[int, StructureFit] = {}
        for one in sorted(quick, key=lambda one: one.evidence):
            found[len(one.unknowns)] = one
        return list(found.values())

    def _with_balanced(
        self, found: list[list[Proposal]], own: Structure, allowed: Sequence[str]
    ) -> list[list[Proposal]]:
        """Return ``found`` with the effects that the balance of forces speaks for."""
        rows = {one[0].name: one for one in found}
        before = min((one.left for one in self._balance.starts(own.effects)), default=self._balance.left)
        for name in allowed:
            left = min((one.left for one in self._balance.starts((*own.effects, name))), default=math.inf)
            if left < SPEAKS * before:
                given = rows.get(name, [Proposal(name, own.values, 0.0, 0)])
                rows[name] = [replace(one, gain=math.inf) for one in given]
        return list(rows.values())

    def _by_balance(self, wider: Structure) -> list[Structure]:
        """Return ``wider`` with the numbers that the balance of forces gives it."""
        found = sorted(self._balance.starts(wider.effects), key=lambda one: one.left)[:BALANCED]
        # What the base makes of gain and delay belongs to a model without the effect.
        nominal = {GAIN: 0.0, DELAY: 0.0} if len(wider.effects) == 1 else {}
        return [wider.moved({**one.values, **nominal}).bounded(self._predictions.seconds) for one in found]

    def _levels(self, name: str, balanced: Sequence[Structure], own: Structure) -> list[Structure]:
        """Return ``balanced`` with the law of friction ``name`` at other levels of its force.

        A spool that sticks much shows the balance of forces half of its friction; no fit gets from there to
        all of it, as the reversals of another motion are elsewhere.
        """
        entry = EFFECTS[name]
        scaled = [one for one in entry.fitted if one not in entry.shapes(self._balance.motion)[0]]
        return [
            one.moved(
                {
                    **{number: level * one.values[number] for number in scaled},
                    "viscous_coefficient": share * one.values["viscous_coefficient"],
                    "spring_stiffness": math.sqrt(
                        one.values["spring_stiffness"] * own.values["spring_stiffness"]
                    ),
                }
            ).bounded(self._predictions.seconds)
            for one in balanced
            for level in LEVELS
            for share in DRAGS
        ]

    def _likeliest(self, trials: Sequence[Structure], looseness: float) -> list[Structure]:
        """Return the few of ``trials`` that are likeliest in the excerpts, as they stand."""
        rows = self._brief.errors(trials, looseness)
        likely = [self._brief.log_likelihood(lines) for lines in rows]
        return [trials[place] for place in np.argsort(likely)[::-1][:STARTS].tolist()]

    def _tighten(self, begun: Structure, looseness: float = LOOSE) -> StructureFit:
        """Fit on from ``begun``, with the correction ``looseness`` and with tighter ones."""
        # Which correction is best is judged by the samples that count in comparisons, not in fits.
        last = begun
        for share in (one for one in LOOSENESS if one <= looseness):
            fit = self._fit(last, (share,))
            last = fit.structure
            if share <= COMPARED:
                found = self._keep(fit)
        for name in found.structure.effects:
            if found.evidence > self.base.evidence:
                self._numbers[name] = {one: found.structure.values[one] for one in EFFECTS[name].fitted}
        return found

    def _keep(self, fit: StructureFit) -> StructureFit:
        fit = judged(self._predictions, fit)
        known = self.fits.get(fit.structure.key)
        # Numbers that make no sense on a machine never hide others that do.
        if known is None or (not senseless(fit), fit.evidence) > (not senseless(known), known.evidence):
            self.fits[fit.structure.key] = fit
            return fit
        return known

    @property
    def _fastest(self) -> float:
        return float(np.quantile(np.abs(self._balance.motion.velocity), 0.99))


def senseless(fit: StructureFit) -> str:
    """Return which numbers of the effects make no sense on a machine and why, "" where all do."""
    values = fit.structure.values
    reasons = (EFFECTS[name].sensible(values, {}) for name in fit.structure.effects)
    return next((one for one in reasons if one), "")


def _named(fit: StructureFit) -> str:
    names = [*fit.structure.effects, *fit.structure.parts]
    return " and ".join(names).replace("_", " ") or "the base"


def _mountings(key: str) -> Iterator[dict[str, float]]:
    """Yield modes to try of the part ``key``."""
    share, natural, _ = CHAIN_PARTS[key].parameters
    for frequency in MODES[::2]:
        yield from ({natural.name: frequency, share.name: one} for one in SHARES)


def _several(name: str) -> bool:
    """Whether fits of the effect ``name`` have local minima."""
    entry = EFFECTS[name]
    return entry.local_minima or entry.localised or name in FRICTIONS
