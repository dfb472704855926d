"""Settings and result of an analysis of the model gap."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from spool_core.numbers import Array
from spool_core.uncertainty import BY_NAME, LEFT_OUT, Quantity
from spool_estimator.identification.determination import Determination, ProfileLikelihood
from spool_estimator.identification.nuisances import Nuisance
from spool_sim.model import Model

from spool_gap.catalogue import EFFECTS, group_of

Progress = Callable[[str, float], None]

UNEXPLAINED = "unexplained"


@dataclass(frozen=True, slots=True)
class GapSettings:
    """How to look for the gap.

    Attributes:
        gain_tolerance: relative gain error of the spool's sensor that its data sheet allows.
        delay_tolerance: delay between the channels that the measuring system allows, s.
        most_effects: at most that are named in a force record.
        least_share: of the spool's acceleration, rms, that an effect must change to be part of the verdict.
        thorough: a search has all the time that it takes.
        profiles: the profile likelihood of each number of what is named is worked out.
    """

    gain_tolerance: float = 0.05
    delay_tolerance: float = 0.5e-3
    most_effects: int = 3
    least_share: float = 0.0025
    thorough: bool = False
    profiles: bool = False


@dataclass(frozen=True, slots=True)
class Share:
    """Where a part of the gap sits: from ``low`` to ``high`` in ``unit``, with its ``share`` of the whole.

    ``floor`` is the share of the whole that noise explains there.
    """

    low: float
    high: float
    unit: str
    share: float
    floor: float = 0.0


@dataclass(frozen=True, slots=True)
class Where:
    """Shares of the gap's energy; each row adds up to 1.

    Attributes:
        frequency, displacement, velocity, direction, time, phase: by Hz, m, m/s, sign of the velocity, s, and
            phase of the motion (rad, 0 at the largest displacement).
        sentence: what stands out, in words.
    """

    frequency: tuple[Share, ...] = ()
    displacement: tuple[Share, ...] = ()
    velocity: tuple[Share, ...] = ()
    direction: tuple[Share, ...] = ()
    time: tuple[Share, ...] = ()
    phase: tuple[Share, ...] = ()
    sentence: str = ""


@dataclass(frozen=True, slots=True)
class Surface:
    """Mean residual force over displacement and velocity.

    Attributes:
        displacement: edges, m, shape (a + 1,).
        velocity: edges, m/s, shape (b + 1,).
        force: mean of what the model lacks, N, shape (a, b); NaN where the record was not.
        count: samples in each cell, shape (a, b).
    """

    displacement: Array
    velocity: Array
    force: Array
    count: Array


@dataclass(frozen=True, slots=True)
class Curves:
    """A stretch of the held-out part and the spectra, before and after; a = m/s^2, or N for force records.

    Attributes:
        time: s since the record's start, shape (n,).
        measured, before, after: shape (n,), in ``unit``.
        frequency: Hz, shape (f,).
        measured_density, before_density, after_density, floor_density: of the power of the measured signal,
            the residual before and after, and the noise floor, unit^2/Hz, shape (f,).
        unit: of the signal.
    """

    time: Array
    measured: Array
    before: Array
    after: Array
    frequency: Array
    measured_density: Array
    before_density: Array
    after_density: Array
    floor_density: Array
    unit: str


@dataclass(frozen=True, slots=True)
class HeldOutAgreement:
    """Held-out agreement; NaN where a number has no meaning.

    Attributes:
        nrmse: rms(model - measured) / rms(measured).
        amplitude_ratio: amplitude of the model over that of the measured signal.
        position_rmse: of a free run of position from the force alone, m; of a driven mass.
    """

    nrmse: float
    amplitude_ratio: float
    position_rmse: float = float("nan")


@dataclass(frozen=True, slots=True)
class Remainder:
    """Remainder of the gap once everything that has a name is in the model, and is not noise.

    Attributes:
        share: of the gap's power, noise taken off.
        over_noise_floor: power of the residual over the noise floor's.
        function_of: what predicts most of it, ``nothing`` where nothing does.
        looks_like: what that may be, in words.
    """

    share: float
    over_noise_floor: float
    function_of: str
    looks_like: str


@dataclass(frozen=True, slots=True)
class SmallEffect:
    """Effect that is significant and does not matter: it changes the acceleration by less than was asked.

    Attributes:
        id: of the catalogue.
        parameters: each with its standard deviation.
        share: of the spool's acceleration, rms, that it changes.
    """

    id: str
    parameters: tuple[Quantity, ...] = field(metadata=BY_NAME)
    share: float


@dataclass(frozen=True, slots=True)
class NamedEffect:
    """An effect that was found.

    Attributes:
        id: of the catalogue.
        parameters: each with its standard deviation.
        nrmse_before, nrmse_after: held out, without and with it, everything else refitted.
        evidence: twice the log likelihood ratio with it and without it, no penalty; NaN of force records.
        meaning: on the machine.
        check: what to look at there.
    """

    id: str
    parameters: tuple[Quantity, ...] = field(metadata=BY_NAME)
    nrmse_before: float
    nrmse_after: float
    evidence: float
    meaning: str
    check: str


@dataclass(frozen=True, slots=True)
class RankedHypothesis:
    """One row of the ranking.

    Attributes:
        id: effect of the catalogue; ``none`` for the structure without effects, where that was taken.
        jointly_with: the other effects of its structure.
        nrmse_after: held out, with it, everything else refitted.
        evidence: twice the log likelihood ratio over the base, less the BIC penalty; of force records on
            held-out data, over the set that it was added to.
        parameters: values by name.
        accepted: its structure was taken; what of it matters is in the verdict.
        reason: why not; empty in force records for one with less evidence than one that was accepted.
        measuring_chain: parts of the measuring chain in its structure.
    """

    id: str
    jointly_with: tuple[str, ...]
    nrmse_after: float
    evidence: float
    parameters: Mapping[str, float]
    accepted: bool = False
    reason: str = ""
    measuring_chain: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Explanation:
    """One of the answers that the record does not tell apart.

    Attributes:
        effects: ids of the catalogue; none where nothing is missing, ``unexplained`` for what has no name.
        probability: of all explanations, which sum to 1.
        parameters: numbers of the effects, each with its standard deviation.
        nuisances: of the measuring chain that belong to it.
        told_apart_by: what would separate it from the others, empty where there is no other.
    """

    JSON_PROPERTIES: ClassVar = ("group",)

    effects: tuple[str, ...]
    probability: float
    parameters: tuple[Quantity, ...] = field(default=(), metadata=BY_NAME)
    nuisances: tuple[Nuisance, ...] = ()
    told_apart_by: str = ""

    @property
    def group(self) -> str:
        """What the effects belong to on the machine, joined by ``+`` where they are of several groups."""
        return group_of(self.effects)


@dataclass(frozen=True, slots=True)
class GapResult:
    """The outcome of an analysis; ``nrmse`` are on data held out from the fit throughout.

    Attributes:
        record: what was analysed.
        determinations: what the records determine of the base model, worked out before the search.
        kind: ``accelerations``, ``driven`` or ``imposed``.
        base_model: name.
        verdict: effect ids joined by ``+``, ``none`` or ``unexplained``; the last one after names where
            those were found, and something else is left. Where the record does not tell effects of one group
            apart, the group (``dry_friction``) stands for them.
        confidence: that the verdict is right, 0 to 1.
        sentence: the verdict in words: what is missing, how big, what it means, what to check.
        effects: what was found, in order of the gap that each closed.
        runner_up: the best hypothesis that was not chosen.
        candidates: for ``unexplained``: the class of effects that comes nearest.
        ranking: all hypotheses that were fitted by simulation, best first.
        base: fitted numbers of the base before anything was added.
        parameters: all fitted numbers of the final model.
        where: where the gap was before; ``where_after``: where the remainder is.
        surface, surface_after: restoring-force surface of the gap before and after.
        curves: waveforms and spectra before and after.
        before, after: held-out agreement.
        noise_floor: nrmse that noise alone would leave with the final model, NaN where only a bound is known.
        model: with everything that was found, to simulate with.
        warnings: what a reader should know, one line each.
        seconds: of data used; ``elapsed``: s of computing.
        predictable: share of the remainder that a smooth force explains, by what it is a function of.
        remainder: the remaining gap, ``None`` where it is noise.
        nuisances: what the measuring chain did.
        small_effects: what was found and does not matter.
        confidence_note: what the confidence does not count, empty where it counts all.
        signs: what decided on a remainder (``rest``: its evidence, ``rest_share``), ``dispersion`` of the
            intervals, ``least_share``: the least share of an effect that matters.
        profiles: of the numbers of what is named, where they were asked for.
        correlation: of the numbers ``correlated``, shape (p, p); empty where it is not known.
        correlated: names of its rows.
        alternatives: to the effects, that the record does not tell from them; ``probability`` is their
            share of those that are not distinguished, of force records of all.
        excited_to: highest frequency (Hz) at which the body stands out of its noise; NaN: not known.
    """

    record: str
    kind: str
    base_model: str
    verdict: str
    confidence: float
    sentence: str
    effects: tuple[NamedEffect, ...]
    runner_up: RankedHypothesis | None
    candidates: tuple[str, ...]
    ranking: tuple[RankedHypothesis, ...]
    base: tuple[Quantity, ...]
    parameters: tuple[Quantity, ...]
    where: Where
    where_after: Where
    surface: Surface
    surface_after: Surface
    curves: Curves
    before: HeldOutAgreement
    after: HeldOutAgreement
    noise_floor: float
    model: Model
    warnings: tuple[str, ...] = ()
    seconds: float = 0.0
    elapsed: float = 0.0
    advice: str = ""
    predictable: Mapping[str, float] = field(default_factory=dict)
    remainder: Remainder | None = None
    nuisances: tuple[Nuisance, ...] = ()
    small_effects: tuple[SmallEffect, ...] = ()
    confidence_note: str = ""
    signs: Mapping[str, float] = field(default_factory=dict)
    profiles: tuple[ProfileLikelihood, ...] = ()
    determinations: tuple[Determination, ...] = ()
    correlation: Array = field(default_factory=lambda: np.empty((0, 0)))
    correlated: tuple[str, ...] = ()
    alternatives: tuple[Explanation, ...] = ()
    excited_to: float = field(default=math.nan, metadata=LEFT_OUT)

    @property
    def explanations(self) -> tuple[Explanation, ...]:
        """Answers that the record does not tell apart, the most probable first, with that of no name."""
        names = tuple(one.id for one in self.effects)
        numbers = tuple(number for one in self.effects for number in one.parameters)
        share = 1.0 - sum(one.probability for one in self.alternatives)
        told = "; ".join(dict.fromkeys(EFFECTS[name].distinguished_by for name in names))
        first = Explanation(names, share, numbers, self.nuisances, told if self.alternatives else "")
        left = UNEXPLAINED in self.verdict.split("+")
        if self.kind != "accelerations":
            # What these leave has been compared with the noise: it is there, whatever the names.
            rest = (UNEXPLAINED,) if left and names else ()
            found = [replace(first, probability=self.confidence), *self.alternatives]
            found = [replace(one, effects=(*one.effects, *rest)) for one in found]
            unknown = 1.0 - sum(one.probability for one in found)
            if left and not names:
                found[0] = replace(found[0], effects=(UNEXPLAINED,))
            found.append(Explanation(self.candidates if left and not names else (UNEXPLAINED,), unknown))
        elif self.alternatives or not left:
            found = [
                replace(one, probability=self.confidence * one.probability)
                for one in (first, *self.alternatives)
            ]
            found.append(Explanation((UNEXPLAINED,), 1.0 - self.confidence))
        else:
            found = [
                replace(first, effects=(*names, UNEXPLAINED), probability=self.confidence),
                replace(first, probability=1.0 - self.confidence),
            ]
        return tuple(sorted(found, key=lambda one: -one.probability))

    @property
    def linear_anomaly(self) -> float | None:
        """Frequency (Hz) of a resonance that the valve's description lacks, ``None`` where there is none.

        Two accelerometers do not tell the bracket of a sensor from the surge of a spring or an oil column.
        Where the body does not shake, a mode only shapes what friction or blows ring: it is no evidence of a
        resonance, and stays among ``nuisances``.
        """
        modes = [one.size for one in self.nuisances if one.id == "extra_mode"]
        return modes[0] if modes and not modes[0] > self.excited_to else None

    @property
    def known_floor(self) -> float:
        """The noise floor, NaN where only a bound is known, which exceeds the error itself."""
        return self.noise_floor if self.noise_floor <= self.after.nrmse else math.nan

    def verdict_of(self, row: RankedHypothesis) -> str:
        """Return whether a row of the ranking was accepted, or why not; empty where that is not known."""
        if row.accepted or row.reason:
            return "accepted" if row.accepted else row.reason
        better = any(
            one.accepted and one.jointly_with == row.jointly_with and one.evidence > row.evidence
            for one in self.ranking
        )
        return "another one is better" if better else ""
