"""Search for the most likely structures: every set of effects by simulation, the best ones to their end.

Three steps. In excerpts of the record every effect alone, every part of the measuring chain, and every pair
is simulated from many starts and fitted briefly from the likeliest. The best of these are fitted to the whole
record, with each part that may help and with the numbers of those that act alike, so that finished fits only
are compared. Last, each component is left out to see what it is worth. All that was fitted to the whole
record stays, for the decision.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from spool_gap.catalogue import EFFECTS, FRICTIONS
from spool_gap.likelihood.prediction import FREE, Predictions
from spool_gap.likelihood.score import Balance, close_proposals, parts_of, proposals, resolved_by
from spool_gap.likelihood.starts import Starts, numbers_of_part, several
from spool_gap.likelihood.structure import CHAIN_PARTS, DELAY, GAIN, Structure, Values
from spool_gap.likelihood.structure_fit import ENOUGH, LOOSENESS, STEPS, StructureFit, fit_structure, judged

Key = tuple[frozenset[str], frozenset[str]]

#: Looseness at which fits have few minima, and of those starts that are near the minimum.
LOOSE, TIGHT = LOOSENESS[0], 0.03
#: Looseness up to which structures are compared: a looser one follows the measured motion, whatever acts.
COMPARED = LOOSENESS[2]
#: Starts that are looked at in all excerpts, that are fitted of each structure, and steps of such a fit.
GLANCED, STARTS, QUICK = 8, 2, 4
#: Steps of a fit while structures are only compared.
BRIEF = 15
#: Draws around the best structure's numbers, and their standard deviations (ln): a factor of 3 either way,
#: and 5 %, by which a gain within the tolerance of a data sheet makes them wrong.
DRAWS, SHAKEN, GENTLY = 24, 1.1, 0.05
#: Parts of the chain, but for modes, that are fitted beside the best structure.
SHOWN = 3
#: Parts of the chain that are modes.
MODES_OF_CHAIN = tuple(key for key, part in CHAIN_PARTS.items() if part.id == "extra_mode")
#: Rise of the log likelihood that ends a fit while structures are only compared: at least, and as a share of
#: what the best one gains over the base.
ROUGH, ROUGHLY = 3.0, 1e-3
#: Structures that are fitted whole whatever they gain in excerpts, and at most.
BESIDE, FINALISTS = 3, 5
#: Share of the best one's gain over the base in excerpts that a structure must have to be fitted whole.
HOPEFUL = 0.7
#: Share of what the likeliest effect gains in excerpts from which a part may hide another effect.
HIDING = 0.1
#: Components of a structure at most: effects, and parts of the chain.
MOST_EFFECTS, MOST_PARTS = 3, 5
#: Evidence (log likelihood less its penalty) from which a component stays: twice what counts as decisive
#: (Kass and Raftery, 1995), since many are tried.
DECISIVE = 10.0
#: Evidence by which a structure without a component must be behind not to be fitted to its end.
CLOSE = 100.0
#: Share of the steps that are left which pairs may take, and pairs after which is looked whether one does.
PAIRED, IN_TURN = 0.5, 8


class Search:
    """Search over structures of one valve and record.

    Attributes:
        fits: the most likely fit of each structure that was fitted to the whole record.
        base: nothing but the base.
    """

    def __init__(
        self,
        predictions: Predictions,
        base: Structure,
        names: Sequence[str],
        tell: Callable[[str, float], None] = lambda _what, _share: None,
        allowed: float = math.inf,
        least_share: float = 0.0,
    ) -> None:
        """Fit the base.

        Args:
            predictions: of the record.
            base: with the numbers of the valve's description.
            names: of the effects that may be missing.
            tell: takes what is done and the share of the work.
            allowed: steps of integration, after which nothing further is tried.
            least_share: of the spool's acceleration, rms, that a second effect must change to be looked for.
        """
        self._least_share = least_share
        self._predictions, self._names, self._tell = predictions, tuple(names), tell
        self._allowed = allowed
        self.fits: dict[Key, StructureFit] = {}
        self._rough: dict[Key, StructureFit] = {}
        base = replace(base, limits=resolved_by(predictions))
        tell("fitting the base", 0.1)
        rough = fit_structure(predictions, base)
        self._brief = predictions.excerpt(predictions.parts[0].motions)
        strongest = max(self._brief.parts, key=lambda one: float(np.mean(one.spool**4)) * (one.numbers > 0.0))
        self._glance = Predictions([strongest])
        self._glance.seconds = predictions.seconds
        for part in {*predictions.parts, *self._brief.parts}:
            part.leave_out_reversals()
        self.base = judged(predictions, rough)
        for one, looseness in ((rough.structure, LOOSE), (base, TIGHT)):
            self.base = self._tighten(one, looseness)
        values = self.base.structure.values
        damping = values.get("viscous_coefficient", 0.0)
        balance = Balance(predictions, values["spring_stiffness"], damping, names)
        motions = (part.errors([self.base.structure], COMPARED).displacement for part in predictions.parts)
        furthest = max(float(np.abs(motion).max()) for motion in motions)
        self._starts = Starts(balance, names, furthest)
        self._scan(self.base.structure, [values])

    @property
    def late(self) -> bool:
        """Whether no further structure is tried."""
        return self._work > self._allowed

    @property
    def hit(self) -> bool:
        """Whether the spool may hit something: springs and drag do not make the largest of its forces."""
        return self._starts.balance.hit

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

    def tried(self, one: Structure) -> StructureFit:
        """Return the likeliest fit of ``one`` from its numbers, by strong and by weak corrections.

        It is kept for the decision, where it is likelier than what is known.
        """
        for looseness in (COMPARED, LOOSE):
            found = self._tighten(one.bounded(self._predictions.seconds), looseness)
        self._settle(found.structure, found.looseness)
        return self.fits[one.key]

    def run(self) -> None:
        """Try every effect alone, every pair where one does not do, and finish what is best."""
        self._tell("every effect alone", 0.15)
        bare = self.base.structure
        for name, rows in proposals(self._predictions, self.base, self._names).items():
            for one in rows:
                self._starts.note((name,), one.values)
        for name in self._names:
            self._scan_set(bare, (name,))
        self._scan_alike(1)
        self._tell("the measuring chain", 0.3)
        self._scan_parts()
        self._tell("the likeliest on the whole record", 0.35)
        self._fit_whole(BESIDE)
        self._add_parts(1)
        self._add_effect()
        self._fit_alike()
        if self._open() and self._scan_pairs():
            self._scan_alike(2)
            self._tell("the likeliest on the whole record", 0.6)
            self._fit_whole(FINALISTS)
            self._share_chain()
            self._add_parts()
            self._fit_alike()
            self._add_effect()
        self._shake()
        self._without_chain()
        # Fit on what may turn out to be the best.
        least = self.best.evidence - 5.0 * self._enough
        for close in [fit for fit in self._sensible() if fit.evidence > least]:
            self._settle(close.structure, close.looseness)
        # Numbers that make no sense on a machine say in most cases that a plainer law is enough.
        self._plainer(max(self.fits.values(), key=lambda one: one.evidence))
        for _ in range(3):
            before = self.simplest
            self.leave_out(before)
            self._plainer(before)
            if self.simplest.structure.key == before.structure.key:
                break

    # In excerpts ----------------------------------------------------------------------------------------

    def _scan(self, wider: Structure, starts: Iterable[Mapping[str, float]]) -> StructureFit:
        """Return the best brief fit of ``wider`` in the excerpts from the likeliest of ``starts``."""
        seconds = self._predictions.seconds
        trials = [wider.moved(one).bounded(seconds) for one in starts]
        fitted = STARTS if any(several(name) for name in wider.effects) else 1
        begun: list[tuple[Structure, tuple[float, ...]]] = [
            (one, (COMPARED,)) for one in self._likeliest(trials, COMPARED, fitted)
        ]
        if len(wider.effects) == 1 and not wider.parts:
            # A motion bound to the measured one has few minima.
            begun += [(one, LOOSENESS[:3]) for one in self._likeliest(trials, LOOSE, 1)]
        fits = [self._fit(one, looseness, brief=True) for one, looseness in begun]
        found = max((judged(self._brief, one) for one in fits), key=lambda one: one.evidence)
        known = self._rough.get(wider.key)
        if known is None or found.evidence > known.evidence:
            self._rough[wider.key] = found
        return self._rough[wider.key]

    def _scan_set(self, own: Structure, names: tuple[str, ...]) -> None:
        """Scan ``own`` with the effects ``names``, from the numbers of each alone and from the balance."""
        wider = own.having((*own.effects, *names), own.parts)
        singles = [one for name in wider.effects if (one := self._single(name)) is not None]
        self._scan(wider, self._starts.of(wider, own, singles))

    def _single(self, name: str) -> StructureFit | None:
        """Return the likeliest brief fit with the effect ``name`` alone, whatever the chain."""
        found = [one for (effects, _), one in self._rough.items() if effects == {name}]
        return max(found, key=lambda one: one.evidence, default=None)

    def _ranked(self, effects: int | None = None) -> list[StructureFit]:
        """Return the brief fits with so many ``effects``, the likeliest of each set, best first."""
        rising = sorted(self._rough.values(), key=lambda one: one.evidence)
        of_set = {frozenset(one.structure.effects): one for one in rising}
        found = [one for own, one in of_set.items() if effects is None or len(own) == effects]
        return sorted(found, key=lambda one: -one.evidence)

    def _scan_alike(self, effects: int) -> None:
        """Scan what acts like the likeliest with so many ``effects``, from its numbers."""
        for fit in self._ranked(effects)[:1]:
            for wider, starts in self._alike(fit):
                if not self.late:
                    self._scan(wider, starts)

    def _alike(self, fit: StructureFit) -> Iterator[tuple[Structure, list[dict[str, float]]]]:
        """Yield ``fit`` with an effect exchanged for one that acts like it, and numbers to start from."""
        for name in fit.structure.effects:
            bare = fit.structure.without(name)
            for other in self._starts.like(name):
                if other in bare.effects or not self._may_add(bare, other):
                    continue
                starts = [
                    {**fit.structure.values, **one}
                    for one in self._starts.acting_like(name, other, fit.structure.values)
                ]
                if starts:
                    yield bare.having((*bare.effects, other), bare.parts), starts

    def _scan_parts(self) -> None:
        """Scan parts of the chain beside the base and the likeliest effect, then every effect beside these.

        A strong mode hides the effect, and the effect the mode: neither may be taken first for good.
        """
        bare = self.base.structure
        beside = [self._rough[bare.key], *self._ranked(1)[:1]]
        chains: dict[str, tuple[float, Structure]] = {}
        least = max(DECISIVE, HIDING * (max(one.evidence for one in beside) - beside[0].evidence))
        for fit in beside:
            for key in CHAIN_PARTS:
                if self.late:
                    return
                found = self._scan_part(fit.structure, key)
                gain = found.evidence - fit.evidence
                if gain > max(least, chains.get(key, (0.0, bare))[0]):
                    chains[key] = gain, found.structure
        for _, one in sorted(chains.values(), key=lambda row: -row[0])[:STARTS]:
            chain = {p.name: one.values[p.name] for part in one.chain for p in part.parameters}
            own = bare.having((), one.parts, chain)
            self._scan(own, [own.values])
            for name in self._names:
                if not self.late:
                    self._scan_set(own, (name,))

    def _scan_part(self, own: Structure, key: str) -> StructureFit:
        """Return the best brief fit of ``own`` with the part ``key``."""
        wider = own.having(own.effects, (*own.parts, key))
        return self._scan(wider, [{**own.values, **one} for one in numbers_of_part(key)])

    def _open(self) -> bool:
        """Whether a score test finds something that matters in what the best structure leaves."""
        best = self.best
        if self.hit and not any(EFFECTS[name].localised for name in best.structure.effects):
            return True
        numbers = self._predictions.numbers
        penalty = 0.5 * math.log(numbers)
        allowed = [name for name in self._names if self._may_add(best.structure, name)]
        found = close_proposals(self._predictions, best, allowed).values()
        # A rise of the log likelihood by this much takes this share of the errors' power away.
        gains = [one.gain for one in found if one.gain > DECISIVE + one.count * penalty]
        explained = 1.0 - math.exp(-2.0 * max(gains, default=0.0) / numbers)
        # What a free run leaves of the spool's acceleration, rms over rms.
        left = read = 0.0
        for part in self._predictions.parts:
            error = part.spool - part.free_run(best.structure, FREE)[0]
            lines = part.counted_lines(np.array([error, part.spool]))[:, part.inside]
            left, read = np.array([left, read]) + np.sum(np.abs(lines) ** 2, axis=(1, 2))
        return math.sqrt(left / max(read, 1e-300)) * math.sqrt(explained) >= self._least_share

    def _scan_pairs(self) -> bool:
        """Scan every pair of effects, the most promising first, with the chain of the best and without.

        It ends early where a pair leaves nothing that a score test finds; returns whether there is any pair.
        """
        until = self._work + PAIRED * (self._allowed - self._work)
        pairs = [
            pair
            for pair in itertools.combinations(self._names, 2)
            if self._may_add(self.base.structure.having((pair[0],), ()), pair[1])
        ]
        promise = self._promised()
        pairs.sort(key=lambda pair: -max(promise.get(pair, -math.inf), promise.get(pair[::-1], -math.inf)))
        best = self.best.structure
        chain = {p.name: best.values[p.name] for part in best.chain for p in part.parameters}
        bare = self.base.structure
        chains = {one.parts: one for one in (bare.having((), best.parts, chain), bare)}
        for number, pair in enumerate(pairs):
            self._tell(" and ".join(pair).replace("_", " "), 0.4 + 0.2 * number / len(pairs))
            for own in chains.values():
                if self._work > until:
                    return True
                self._scan_set(own, pair)
            if number % IN_TURN == IN_TURN - 1:
                self._fit_whole(1)
                if not self._open():
                    break
        return bool(pairs)

    def _promised(self) -> dict[tuple[str, str], float]:
        """Return the evidence that each pair promises: that of one, and what a score test of it finds."""
        found: dict[tuple[str, str], float] = {}
        singles = self._ranked(1)
        for fit in singles:
            name = fit.structure.effects[0]
            allowed = [one for one in self._names if self._may_add(fit.structure, one)]
            near = close_proposals(self._brief, fit, allowed) if fit in singles[: 2 * BESIDE] else {}
            for other in allowed:
                found[name, other] = fit.evidence + (near[other].gain if other in near else 0.0)
                if other in near:
                    self._starts.note((name, other), near[other].values)
        return found

    # On the whole record --------------------------------------------------------------------------------

    def _fit_whole(self, most: int) -> None:
        """Fit the likeliest of what was scanned, ``most`` sets of effects, to the whole record."""
        ranked = [one for one in self._ranked() if not senseless(one)]
        floor = self._rough[self.base.structure.key].evidence
        least = floor + HOPEFUL * (ranked[0].evidence - floor)
        for number, one in enumerate(ranked[:most]):
            # Excerpts may mislead: some are fitted whatever they gain there.
            if (number >= BESIDE and one.evidence < least) or (self.late and len(self.fits) > 1):
                break
            known = self.fits.get(one.structure.key)
            if known is None:
                self._tighten(one.structure, COMPARED)

    def _share_chain(self) -> None:
        """Fit the likeliest other sets of effects with the chain of the best."""
        best = self.best
        chain = {
            p.name: best.structure.values[p.name] for part in best.structure.chain for p in part.parameters
        }
        others = [one for one in self.of_each_set.values() if one.structure.effects != best.structure.effects]
        others.sort(key=lambda one: -one.evidence)
        for one in others[:BESIDE]:
            wider = one.structure.having(one.structure.effects, best.structure.parts, chain)
            if wider.key not in self.fits and not self.late:
                self._tighten(wider, COMPARED)

    def _add_parts(self, most: int = MOST_PARTS) -> None:
        """Add at most so many parts of the chain to the best structure, as long as they are decisive.

        By score tests on the whole record, since a drift, or a corner below the motion, hardly shows in
        excerpts; a strong mode is far from the small one that a score test sees, so modes are scanned, too.
        """
        for number in range(most):
            best = self.best
            own = best.structure
            if len(own.parts) >= MOST_PARTS or (number > 1 and self.late):
                return
            fits = [
                judged(self._predictions, self._fit(one, (best.looseness,), steps=QUICK))
                for one in self._with_parts(best)
            ]
            for one in sorted(fits, key=lambda one: -one.evidence)[:STARTS]:
                if one.evidence > best.evidence + DECISIVE:
                    self._tighten(one.structure, COMPARED)
            if self.best.evidence < best.evidence + DECISIVE:
                return

    def _with_parts(self, fit: StructureFit) -> Iterator[Structure]:
        """Yield ``fit`` with each mode that it lacks, and with the other parts that are likeliest."""
        own, seconds = fit.structure, self._predictions.seconds
        begun: dict[str, list[Values]] = {one.name: [one.values] for one in parts_of(self._predictions, fit)}
        tried: list[tuple[float, Structure]] = []
        for key in (key for key in CHAIN_PARTS if key not in own.parts):
            if key in MODES_OF_CHAIN:
                yield self._scan_part(own, key).structure
                continue
            wider = own.having(own.effects, (*own.parts, key))
            starts = [
                wider.moved(one).bounded(seconds) for one in (*begun.get(key, ()), *numbers_of_part(key))
            ]
            for one, lines in zip(starts, self._predictions.errors(starts, fit.looseness), strict=True):
                tried.append((self._predictions.log_likelihood(lines), one))
        tried.sort(key=lambda row: -row[0])
        of_part: dict[str, Structure] = {}
        for _, one in tried:
            of_part.setdefault(one.parts[-1], one)
        yield from list(of_part.values())[:SHOWN]

    def _fit_alike(self) -> None:
        """Fit what acts like an effect of the best structure beside its chain, from its numbers."""
        best = self.best
        if not best.structure.parts:
            return
        scanned = [self._scan(wider, starts) for wider, starts in self._alike(best) if not self.late]
        for one in sorted(scanned, key=lambda one: -one.evidence)[:STARTS]:
            self._tighten(one.structure, COMPARED)

    def _add_effect(self) -> None:
        """Add an effect to the best structure by score tests, where no scan did so beside its parts."""
        best = self.best
        scanned = len(best.structure.effects) < MOST_EFFECTS - 1 and not best.structure.parts
        if scanned or len(best.structure.effects) >= MOST_EFFECTS:
            return
        penalty = 0.5 * math.log(self._predictions.numbers)
        allowed = [name for name in self._names if self._may_add(best.structure, name)]
        found = close_proposals(self._predictions, best, allowed)
        ranked = sorted(found.values(), key=lambda one: -one.gain)
        for one in ranked[:STARTS]:
            if one.gain > DECISIVE + one.count * penalty and not self.late:
                wider = best.structure.having((*best.structure.effects, one.name), best.structure.parts)
                self._tighten(wider.moved(one.values).bounded(self._predictions.seconds), best.looseness)

    def _without_chain(self) -> None:
        """Fit the likeliest sets of effects without any part of the chain, however late it is."""
        ranked = sorted(self.of_each_set.values(), key=lambda one: -one.evidence)
        for one in ranked[:BESIDE]:
            if one.structure.parts:
                self._tighten(one.structure.having(one.structure.effects, ()), COMPARED)

    def _shake(self) -> None:
        """Look for a better minimum of the best structure: from its numbers, each several times off."""
        best = self.best
        names = [own for name in best.structure.effects if several(name) for own in EFFECTS[name].fitted]
        if self.late or not names:
            return
        own = best.structure
        generator = np.random.default_rng(0)
        far = np.exp(generator.normal(0.0, SHAKEN, (DRAWS, len(names)))).tolist()
        for one in self._likeliest(self._scaled(own, names, far), LOOSENESS[1], STARTS):
            begun = self._fit(one, (LOOSENESS[1],)).structure
            self._keep(self._fit(begun, (best.looseness,)))
        if any(EFFECTS[name].localised for name in own.effects):
            # A gain that is a little wrong, and springs and clearances that make up for it, are a valley.
            nominal = own.moved({GAIN: 0.0, DELAY: 0.0})
            everything = [*names, *(one.name for one in own.base_unknowns)]
            near = np.exp(generator.normal(0.0, GENTLY, (DRAWS, len(everything)))).tolist()
            starts = [nominal, *self._likeliest(self._scaled(nominal, everything, near), TIGHT, STARTS)]
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

    def _plainer(self, fit: StructureFit) -> None:
        """Fit ``fit`` with the plainer laws that its laws contain, however late it is."""
        for wider, starts in self._alike(fit):
            plain = set(wider.effects) - set(fit.structure.effects)
            replaced = {one for name in fit.structure.effects for one in EFFECTS[name].replaces}
            if plain <= replaced and wider.key not in self.fits:
                self._tighten(self._scan(wider, starts).structure, fit.looseness)

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

    def _settle(self, one: Structure, looseness: float) -> None:
        """Fit ``one`` to its end; with forces that jump at last by all that corrects the motion."""
        found = self._keep(self._fit(one, (looseness,), enough=ENOUGH, steps=STEPS))
        if one.jumps:
            self._keep(fit_structure(self._predictions, found.structure, (looseness,)))

    # Fits -----------------------------------------------------------------------------------------------

    def _fit(
        self,
        one: Structure,
        looseness: Sequence[float],
        *,
        steps: int = BRIEF,
        enough: float | None = None,
        brief: bool = False,
    ) -> StructureFit:
        """Return the fit of ``one``, without samples at reversals where its force jumps there.

        A ``brief`` one is of few steps and of excerpts of the record.
        """
        # A force that jumps is fitted without what depends on the instants of its jumps; they are not heard
        # either, as errors would be moved there.
        apart = one.jumps
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

    def _likeliest(self, trials: Sequence[Structure], looseness: float, most: int) -> list[Structure]:
        """Return the ``most`` of ``trials`` that are likeliest in the excerpts, as they stand."""
        for of, kept in ((self._glance, max(most, GLANCED)), (self._brief, most)):
            if len(trials) > kept:
                rows = of.errors(trials, looseness)
                likely = [of.log_likelihood(lines) for lines in rows]
                trials = [trials[place] for place in np.argsort(likely)[::-1][:kept].tolist()]
        return list(trials)

    def _tighten(self, begun: Structure, looseness: float = LOOSE) -> StructureFit:
        """Fit on from ``begun``, with the correction ``looseness`` and with tighter ones."""
        # Which correction is best is judged by the samples that count in comparisons, not in fits.
        last = begun
        for share in (one for one in LOOSENESS if one <= looseness):
            fit = self._fit(last, (share,))
            last = fit.structure
            if share <= COMPARED:
                found = self._keep(fit)
        return found

    def _keep(self, fit: StructureFit) -> StructureFit:
        fit = judged(self._predictions, fit)
        known = self.fits.get(fit.structure.key)
        # Numbers that make no sense on a machine never hide others that do.
        if known is None or (not senseless(fit), fit.evidence) > (not senseless(known), known.evidence):
            self.fits[fit.structure.key] = fit
            return fit
        return known


def senseless(fit: StructureFit) -> str:
    """Return which numbers of the effects make no sense on a machine and why, "" where all do."""
    values = fit.structure.values
    reasons = (EFFECTS[name].sensible(values, {}) for name in fit.structure.effects)
    return next((one for one in reasons if one), "")
