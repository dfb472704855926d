"""Result of an analysis of the model gap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from spool_core.uncertainty import Quantity
from spool_estimator.identification.nuisances.record_nuisance import Nuisance
from spool_sim.model import Model

from spool_gap.profile_likelihood import ProfileLikelihood

Array = NDArray[np.float64]


#: What the standard deviations of the selection's own fit count, for people. Measured on records with a known
#: truth: in practice_01 (no dry friction) stiffness and drag lie within their intervals, in practice_03 and
#: practice_04 drag and Coulomb force are 0.3 to 0.5 % off, 6 to 19 half widths.
COUNTED = (
    "these intervals count the noise alone, since no fit of the whole record ended where the selection did; "
    "values may be off by up to about 0.5 % besides"
)


@dataclass(frozen=True, slots=True)
class GapSettings:
    """How to look for the gap.

    Attributes:
        gain_tolerance: relative gain error of the spool's sensor that its data sheet allows.
        delay_tolerance: delay between the channels that the measuring system allows, s.
        longest: samples at most that are simulated, for the fit and again for the held-out part.
        most_effects: at most that are named in one record.
        least_share: of the spool's acceleration, rms, that an effect must change to be part of the verdict.
        thorough: a search has all the time that it takes.
        profiles: the profile likelihood of each number of what is named is worked out.
        left_out: names of stages of the selection that are not run, to see what they are worth.
    """

    gain_tolerance: float = 0.05
    delay_tolerance: float = 0.5e-3
    longest: int = 30_000
    most_effects: int = 3
    least_share: float = 0.0025
    thorough: bool = False
    profiles: bool = False
    left_out: frozenset[str] = frozenset()


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
        amplitude_ratio: the paper's a_est/a_pom.
        position_rmse: of a free run of position from the force alone, m; of a driven mass.
    """

    nrmse: float
    amplitude_ratio: float
    position_rmse: float = float("nan")


@dataclass(frozen=True, slots=True)
class Remainder:
    """What is left of the gap once everything that has a name is in the model, and is not noise.

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
    parameters: tuple[Quantity, ...]
    share: float


@dataclass(frozen=True, slots=True)
class NamedEffect:
    """An effect that was found.

    Attributes:
        id: of the catalogue.
        parameters: each with its standard deviation.
        nrmse_before, nrmse_after: held out, without and with it, everything else refitted.
        evidence: twice the log likelihood ratio on held-out data, without the BIC penalty of its parameters.
        meaning: on the machine.
        check: what to look at there.
    """

    id: str
    parameters: tuple[Quantity, ...]
    nrmse_before: float
    nrmse_after: float
    evidence: float
    meaning: str
    check: str


@dataclass(frozen=True, slots=True)
class RankedHypothesis:
    """One row of the ranking.

    Attributes:
        id: effect of the catalogue.
        jointly_with: effects that were already accepted when it was tried.
        nrmse_after: held out, with it, everything else refitted.
        evidence: twice the log likelihood ratio on held-out data, less the BIC penalty of its parameters.
        parameters: values by name.
        accepted: it is part of the verdict.
        reason: why not, where it is not.
    """

    id: str
    jointly_with: tuple[str, ...]
    nrmse_after: float
    evidence: float
    parameters: Mapping[str, float]
    accepted: bool = False
    reason: str = ""

    @property
    def key(self) -> tuple[str, tuple[str, ...]]:
        """What tells it from the other rows: its effect, and those that it was tried jointly with."""
        return self.id, self.jointly_with


@dataclass(frozen=True, slots=True)
class Change:
    """Change of the choice: the stage that made it, and the effects chosen before and after it.

    ``gave_up``: the stage was not run to its end, since the time was over.
    """

    stage: str
    before: tuple[str, ...]
    after: tuple[str, ...]
    gave_up: bool = False


@dataclass(frozen=True, slots=True)
class GapResult:
    """The outcome of an analysis; ``nrmse`` are on data held out from the fit throughout.

    Attributes:
        record: what was analysed.
        kind: ``accelerations``, ``driven`` or ``imposed``.
        base_model: name.
        verdict: effect ids joined by ``+``, ``none`` or ``unexplained``; the last one after names where
            those were found, and something else is left.
        confidence: that the verdict is right, 0 to 1.
        sentence: the verdict in words: what is missing, how big, what it means, what to check.
        effects: what was found, in order of the gap that each closed.
        runner_up: the best hypothesis that was not chosen.
        candidates: for ``unexplained``: the class of effects that comes nearest.
        ranking: all hypotheses that were fitted by simulation, best first.
        base: fitted numbers of the base before anything was added.
        parameters: all fitted numbers of the final model.
        where: where the gap sat before; ``where_after``: what is left.
        surface, surface_after: restoring-force surface of the gap before and after.
        curves: waveforms and spectra before and after.
        before, after: held-out agreement.
        noise_floor: nrmse that noise alone would leave with the final model.
        model: with everything that was found, to simulate with.
        noise_alone: deviations of the parameters count the noise of the samples alone, see ``COUNTED``.
        warnings: what a reader should know, one line each.
        seconds: of data used; ``elapsed``: s of computing.
        predictable: predictable share of what is left, by what from, see :mod:`.screening.remainder`.
        remainder: what is left, ``None`` where that is noise.
        nuisances: what the measuring chain did.
        small_effects: what was found and does not matter.
        trace: which stage of the selection changed the choice.
        confidence_note: why the confidence is capped, empty where it is a frequency.
        signs: what the confidence goes by, see :mod:`.report.confidence`.
        profiles: of the numbers of what is named, where they were asked for.
        correlation: of the numbers ``correlated``, shape (p, p); empty where it is not known.
        correlated: names of its rows.
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
    noise_alone: bool = False
    warnings: tuple[str, ...] = ()
    seconds: float = 0.0
    elapsed: float = 0.0
    advice: str = ""
    predictable: Mapping[str, float] = field(default_factory=dict)
    remainder: Remainder | None = None
    nuisances: tuple[Nuisance, ...] = ()
    small_effects: tuple[SmallEffect, ...] = ()
    trace: tuple[Change, ...] = ()
    confidence_note: str = ""
    signs: Mapping[str, float] = field(default_factory=dict)
    profiles: tuple[ProfileLikelihood, ...] = ()
    correlation: Array = field(default_factory=lambda: np.empty((0, 0)))
    correlated: tuple[str, ...] = ()
