"""Workflow of a gap analysis: look at the record, search, decide, judge on data held out, say.

One model describes both channels: forces on the spool, the measuring chain, noise. The record is never
changed. Structures of that model are compared by one likelihood, see :mod:`.likelihood.prediction`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace

from spool_core.errors import InputError
from spool_core.uncertainty import Quantity, Validity
from spool_estimator.identification.chain import CHAIN_PARTS
from spool_estimator.identification.fit_result import explains_nothing
from spool_estimator.identification.free_run import excitation_limit
from spool_estimator.identification.nuisances import Nuisance
from spool_estimator.identification.record import Record
from spool_sim.model import Model
from spool_sim.terms import term
from spool_sim.valve import Valve

from spool_gap import report
from spool_gap.catalogue import EFFECTS
from spool_gap.evidence.decision import Decision, decide
from spool_gap.evidence.explanations import said_by
from spool_gap.evidence.held_out import HeldOut, Judged
from spool_gap.evidence.intervals import Numbers, numbers_of, profiles_of
from spool_gap.evidence.look import Look, as_stuck, jitter_of, look_at, sentence
from spool_gap.likelihood.kernel import motions_for
from spool_gap.likelihood.prediction import Prediction, Predictions
from spool_gap.likelihood.search import Search, senseless
from spool_gap.likelihood.structure import structure_of, told
from spool_gap.likelihood.structure_fit import StructureFit, fit_structure
from spool_gap.result import (
    UNEXPLAINED,
    Explanation,
    GapResult,
    GapSettings,
    NamedEffect,
    Progress,
    RankedHypothesis,
    Remainder,
    SmallEffect,
)

#: Steps of integration that a search may take, about a minute's; what it found by then is judged.
ALLOWED = 4e8
#: Structures that the ranking shows.
RANKED = 20

SATURATION, COMPARED_SENTENCE = "sensor_saturation", "the spool's acceleration"
#: Power of the remainder over the white noise's from which noise is called coloured: the density of white
#: noise is known to some 10 %, that of the residual to some 20 %.
COLOURED = 2.0
#: Confidence at most where the channels may not be of one valve: even that they are is doubted.
DOUBTFUL = 0.3


def analyse(
    records: Sequence[Record],
    valve: Valve,
    base: Model,
    *,
    holdout: Sequence[Record] = (),
    settings: GapSettings | None = None,
    progress: Progress | None = None,
) -> GapResult:
    """Return what ``base`` lacks in ``records``, judged on data that a last fit is made without.

    Args:
        records: two accelerations each, of one valve.
        valve: gives the mass, which two accelerometers cannot see, and what is expected.
        base: any composition of force terms.
        holdout: records to judge on; without them half of the windows of ``records`` are held out.
        settings: tolerances and amounts.
        progress: takes what is done and the share of the work.

    Raises:
        InputError: the records cannot be analysed; what is wrong is named.
    """
    tell = progress or (lambda _what, _share: None)
    begun = time.monotonic()
    run = searched(records, valve, base, holdout=holdout, settings=settings, progress=tell)
    return replace(run.concluded(tell), elapsed=time.monotonic() - begun)


@dataclass(frozen=True, slots=True)
class Run:
    """Search over records with everything that was fitted, before anything is decided."""

    records: Sequence[Record]
    base: Model
    look: Look
    predictions: Predictions
    held: HeldOut
    search: Search
    settings: GapSettings

    def apart(self) -> AbstractContextManager[None]:
        """Leave records that are held out as a whole out of fits while this lasts.

        Windows that are held out take part in the search, since a sweep shows each motion once.
        """
        return self.held.apart() if self.look.held else nullcontext()

    def decided(self) -> Decision:
        """Return what the fits say."""
        motions = self.predictions.parts[0].motions
        return decide(self.predictions, self.search, self.look, self.settings, motions, self.held)

    def concluded(self, progress: Progress = lambda _what, _share: None) -> GapResult:
        """Return the result: what the fits say, judged on data held out, in words."""
        late = self.search.late
        with self.apart():
            progress("deciding", 0.85)
            decision = self.decided()
            progress("judging on data held out", 0.92)
            judged = self.judged(decision)
            words = self.words(decision, judged)
            parts = self.predictions, self.search, decision, self.held
            result = _assembled(self.records, self.base, *parts, judged, words)
            if self.settings.profiles:
                progress("profiling the numbers", 0.95)
                names = [quantity.name for effect in result.effects for quantity in effect.parameters]
                own = profiles_of(self.predictions, decision.fit, decision.numbers, names)
                result = replace(result, profiles=own)
        hurried = ("the search stopped early with the best result so far; pass --thorough for a full search",)
        warnings = (*self.look.warnings, *(hurried if late else ()), *result.warnings)
        result = replace(result, warnings=warnings)
        return as_stuck(result) if self.look.stuck else result

    def judged(self, decision: Decision) -> tuple[Judged, Judged]:
        """Return what the base and the choice of ``decision`` leave of data held out."""
        return self.held.least(decision.base), self.held.judged(decision.fit)

    def words(self, decision: Decision, judged: tuple[Judged, Judged]) -> Words:
        """Return ``decision`` in words."""
        # Forces that jump, and hits, leave what looks like jitter.
        best = decision.fit.structure
        sharp = best.jumps or any(EFFECTS[name].localised for name in best.effects)
        jitter = None if sharp or self.look.stuck else jitter_of(self.predictions.parts, judged[1].rows)
        return words_of(decision, self.look, self.base, *judged, jitter)


def searched(
    records: Sequence[Record],
    valve: Valve,
    base: Model,
    *,
    holdout: Sequence[Record] = (),
    settings: GapSettings | None = None,
    progress: Progress = lambda _what, _share: None,
) -> Run:
    """Return the search over ``records``; see :func:`analyse`."""
    chosen = settings or GapSettings()
    progress("checking the record", 0.0)
    look = look_at(records, holdout, valve)
    progress("preparing", 0.05)
    motions = motions_for(base)
    # Laws count the time from the first sample that is analysed, wherever that lies in its recording.
    begin = min(one.time for one in look.readings)
    counted = [replace(one, time=one.time - begin) for one in look.readings]
    predictions = Predictions([Prediction(one, valve, motions) for one in counted])
    if predictions.clipped and predictions.numbers > 0.0:
        # Clipped tops are several samples long, and no curve through the others restores them as well as
        # a model.
        predictions.bridge(fit_structure(predictions, structure_of(base, valve)).structure)
    held = HeldOut(
        predictions, [number >= len(look.readings) - look.held for number in range(len(look.readings))]
    )
    if predictions.numbers <= 0.0 or held.empty:
        clipped = " and ".join(look.limits) or "neither"
        raise InputError(
            f"{records[0].name}: hardly a second of the record is usable, since too many samples are "
            f"missing or clipped (clipped channel: {clipped}); choose a larger range of the sensor, or "
            "excite less"
        )
    with held.apart() if look.held else nullcontext():
        tried = [] if look.stuck else tried_effects(base)
        allowed = math.inf if chosen.thorough else ALLOWED
        search = Search(predictions, structure_of(base, valve), tried, progress, allowed, chosen.least_share)
        search.run()
    return Run(records, base, look, predictions, held, search, chosen)


def tried_effects(base: Model) -> list[str]:
    """Return the forces that ``base`` may lack and that show along the measured motion."""
    known = {entry.name for entry in base.terms}
    return [
        name
        for name, entry in EFFECTS.items()
        if entry.terms and entry.searched and "accelerations" in entry.kinds and not known & set(entry.terms)
    ]


@dataclass(frozen=True, slots=True)
class Words:
    """Verdict in words; fields as those of the result. ``extra``: numbers of effects that no fit has."""

    verdict: str
    confidence: float
    sentence: str
    effects: tuple[str, ...]
    candidates: tuple[str, ...]
    remainder: Remainder | None
    nuisances: tuple[Nuisance, ...]
    advice: str
    warnings: tuple[str, ...] = ()
    confidence_note: str = ""
    alternatives: tuple[Explanation, ...] = ()
    extra: Mapping[str, tuple[Quantity, ...]] = field(default_factory=dict)


def words_of(
    decision: Decision, look: Look, base: Model, before: Judged, after: Judged, jitter: Nuisance | None = None
) -> Words:
    """Return the words for ``decision`` on records with ``look``, whose sampling instants may scatter."""
    names = [*decision.effects]
    members = list(dict.fromkeys((decision.effects, *(one.effects for one in decision.others))))
    said = said_by(members)
    extra: dict[str, tuple[Quantity, ...]] = {}
    if "spool" in look.limits:
        limit = look.limits["spool"]
        extra[SATURATION] = (Quantity("saturation_limit", "m/s^2", limit, 0.01 * limit, Validity.VALID),)
        names.append(SATURATION)
    warnings = [*explains_nothing("even the best model", after.agreement.nrmse)]
    # Where even the best model explains nothing, something is missing, whatever the evidence.
    open_ = decision.unexplained or (bool(warnings) and not names)
    doubtful = not look.trusted and (open_ or not names)
    candidates: tuple[str, ...] = ()
    if doubtful or (open_ and not names):
        candidates = tuple(decision.effects) or decision.nearest
        verdict, names = UNEXPLAINED, []
    else:
        parts = [*said, *(name for name in names if name not in decision.effects)]
        verdict = "+".join([*parts, UNEXPLAINED] if open_ else parts) or "none"
        candidates = tuple(dict.fromkeys(name for one in members for name in one if name not in said))
    power = (after.agreement.nrmse / max(after.floor, 1e-12)) ** 2
    remainder = _remainder(decision, power, before, after) if open_ else None
    values, deviations = decision.fit.structure.values, decision.numbers.deviations
    nuisances = [*look.nuisances, *(told(CHAIN_PARTS[key], values, deviations) for key in decision.parts)]
    if jitter is not None:
        nuisances.append(jitter)
    elif not open_ and power > COLOURED and not decision.fit.structure.jumps:
        squares = sum(float((rows[0] ** 2).sum()) for rows in after.rows)
        size = after.agreement.nrmse * math.sqrt(squares / sum(rows.shape[1] for rows in after.rows))
        coloured = Nuisance(
            "coloured_noise", "spool", size, math.nan, "m/s^2", corrected=False, check=report.CHECK_COLOURED
        )
        nuisances.append(coloured)
    errors = before.agreement.nrmse, after.agreement.nrmse, after.known_floor, COMPARED_SENTENCE
    if verdict == "none":
        text = report.nothing_missing(base.name, *errors[1:])
    elif verdict == UNEXPLAINED:
        text = report.unnamed(base.name, candidates, decision.rest.follows, *errors)
    else:
        known = {one.name: one for one in decision.numbers.quantities}
        numbers = {name: [known[own] for own in EFFECTS[name].fitted if own in known] for name in names}
        text = report.named([(name, extra.get(name) or numbers[name]) for name in names], *errors)
        if remainder is not None:
            text = f"{text} {report.still_missing(remainder)}"
    alternatives = [] if verdict == UNEXPLAINED and not names else _alternatives(decision, members)
    if alternatives:
        text = f"{text} {report.not_told_apart(decision.effects, alternatives)}"
    warnings = [*([] if jitter is None else [sentence(jitter)]), *warnings]
    # A name beside a remainder may be the nearest law's; a model that explains nothing is no evidence.
    capped = doubtful or (open_ and (bool(names) or not decision.unexplained))
    confidence = min(decision.confidence, DOUBTFUL) if capped else decision.confidence
    apart = (EFFECTS[name].distinguished_by for name in (*names, *candidates) if name in EFFECTS)
    return Words(
        verdict, confidence, text, tuple(names), candidates, remainder, tuple(nuisances),
        "; ".join(dict.fromkeys(one for one in apart if one)), tuple(warnings), extra=extra,
        alternatives=tuple(alternatives),
    )  # fmt: skip


def _alternatives(decision: Decision, members: Sequence[tuple[str, ...]]) -> list[Explanation]:
    """Return what else ``members`` say than the effects of ``decision``, with their numbers."""
    found = []
    for names in members[1:]:
        one = next(other for other in decision.others if other.effects == names)
        share = sum(other.share for other in decision.others if other.effects == names)
        numbers = tuple(quantity for name in names for quantity in _own(one.numbers, name))
        chain = one.fit.structure
        parts = [told(CHAIN_PARTS[key], chain.values, one.numbers.deviations) for key in chain.parts]
        apart = "; ".join(dict.fromkeys(EFFECTS[name].distinguished_by for name in names))
        found.append(Explanation(names, share, numbers, tuple(parts), apart))
    return found


def _assembled(
    records: Sequence[Record],
    base: Model,
    predictions: Predictions,
    search: Search,
    decision: Decision,
    held: HeldOut,
    judged: tuple[Judged, Judged],
    words: Words,
) -> GapResult:
    """Return the result: numbers, where the gap sat, how far it closed, and the words."""
    before, after = judged
    where, picture = held.located(before)
    where_after, picture_after = held.located(after)
    numbers = decision.numbers
    ranking = tuple(_ranked(search, decision, held, after))
    return GapResult(
        record=", ".join(dict.fromkeys(record.name for record in records)),
        kind="accelerations",
        base_model=base.name,
        verdict=words.verdict,
        confidence=words.confidence,
        sentence=words.sentence,
        effects=tuple(_named(search, decision, held, words, after)),
        runner_up=next((row for row in ranking if not row.accepted and not row.jointly_with), None),
        candidates=words.candidates,
        ranking=ranking,
        base=numbers_of(predictions, decision.base).quantities,
        parameters=numbers.quantities,
        where=where,
        where_after=where_after,
        surface=picture,
        surface_after=picture_after,
        curves=held.curves(before, after),
        before=before.agreement,
        after=after.agreement,
        noise_floor=after.known_floor,
        model=_model(base, decision.fit),
        warnings=words.warnings,
        seconds=sum(part.seconds for part in predictions.parts),
        advice=words.advice,
        predictable={decision.rest.follows: decision.rest.share},
        remainder=words.remainder,
        nuisances=words.nuisances,
        small_effects=tuple(
            SmallEffect(name, _own(numbers, name), share) for name, share in decision.small.items()
        ),
        confidence_note=words.confidence_note,
        signs=decision.signs,
        correlation=numbers.correlation,
        correlated=tuple(one.name for one in numbers.quantities),
        alternatives=words.alternatives,
        excited_to=max(map(excitation_limit, records)),
    )


def _own(numbers: Numbers, name: str) -> tuple[Quantity, ...]:
    known = {one.name: one for one in numbers.quantities}
    return tuple(known[own] for own in EFFECTS[name].fitted if own in known)


def _named(
    search: Search, decision: Decision, held: HeldOut, words: Words, after: Judged
) -> list[NamedEffect]:
    found = []
    for name in words.effects:
        entry = EFFECTS[name]
        without = search.without(decision.fit, name)
        error = held.judged(without).agreement.nrmse if without is not None else after.agreement.nrmse
        evidence = (
            2.0 * (decision.fit.log_likelihood - without.log_likelihood)
            if without is not None
            else float("nan")
        )
        parameters = words.extra.get(name) or _own(decision.numbers, name)
        errors = error, after.agreement.nrmse
        found.append(
            NamedEffect(name, tuple(parameters), *errors, evidence, entry.on_the_machine, entry.to_check)
        )
    return found


def _ranked(search: Search, decision: Decision, held: HeldOut, after: Judged) -> list[RankedHypothesis]:
    """Return the structure that was taken, then those with effects, those with one first, best first."""
    taken = decision.fit
    others = [
        fit
        for effects, fit in search.of_each_set.items()
        if effects and effects != frozenset(taken.structure.effects)
    ]
    others.sort(key=lambda fit: (len(fit.structure.effects), -fit.evidence))
    return [
        _row(taken, decision, after),
        *(_row(fit, decision, held.judged(fit, refitted=False)) for fit in others[: RANKED - 1]),
    ]


def _row(fit: StructureFit, decision: Decision, judged: Judged) -> RankedHypothesis:
    """Return the row of a structure, and why it was not taken."""
    effects, accepted = fit.structure.effects, fit is decision.fit
    newest = effects[-1] if effects else "none"
    fitted = EFFECTS[newest].fitted if effects else ()
    refused = next((decision.refused[one] for one in effects if one in decision.refused), "")
    return RankedHypothesis(
        newest,
        effects[:-1],
        judged.agreement.nrmse,
        2.0 * (fit.evidence - decision.base.evidence),
        {name: fit.structure.values[name] for name in fitted},
        accepted,
        "" if accepted else refused or senseless(fit) or _less(fit, decision.fit),
        fit.structure.parts,
    )


def _less(fit: StructureFit, taken: StructureFit) -> str:
    """Return what speaks for the structure that was taken against another one that is possible."""
    lead = 2.0 * (taken.evidence - fit.evidence)
    name = " + ".join(taken.structure.effects) or "no effect"
    if lead > 0.0:
        return f"evidence {lead:.0f} lower than for {name}"
    return f"evidence {-lead:.0f} higher than for {name}, which does not justify more parameters"


def _model(base: Model, fit: StructureFit) -> Model:
    """Return ``base`` with the effects of ``fit`` as terms, with its numbers."""
    known = {entry.name for entry in base.terms}
    terms = (*base.terms, *(term(name) for name in fit.structure.terms if name not in known))
    names = {parameter.name for entry in terms for parameter in entry.parameters}
    values = {name: value for name, value in fit.structure.values.items() if name in names}
    return Model("_".join([base.name, *fit.structure.effects]), terms, values)


def _remainder(decision: Decision, power: float, before: Judged, after: Judged) -> Remainder:
    gap = max(before.agreement.nrmse**2 - after.floor**2, 1e-12)
    share = max(after.agreement.nrmse**2 - after.floor**2, 0.0) / gap
    follows = decision.rest.follows
    return Remainder(min(share, 1.0), power, follows, report.looks_like(follows))
