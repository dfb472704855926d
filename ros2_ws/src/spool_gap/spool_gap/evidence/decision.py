"""Decision: the most probable set of effects, how probable it is, and the intervals of its numbers.

Each structure has the evidence of its likelihood; those with the same effects differ in the measuring chain
alone and count by the best of them. A smooth force of any law competes with all: where it explains what
the best structure leaves, something is unexplained. What is named must be decided by the evidence and must
change the motion by more than the stated share.

Source: Kass and Raftery, Bayes factors, 1995.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from spool_gap.catalogue import EFFECTS
from spool_gap.evidence.explanations import credible
from spool_gap.evidence.held_out import HeldOut, Judged
from spool_gap.evidence.intervals import Numbers, numbers_of, refined
from spool_gap.evidence.look import Look
from spool_gap.likelihood.kernel import SwitchableMotion
from spool_gap.likelihood.prediction import Predictions
from spool_gap.likelihood.remainder import MOTION, patterns_of, phase_kept
from spool_gap.likelihood.rest import (
    Rest,
    TwoForces,
    rest_of,
    share_between,
    share_of_effect,
    share_of_part,
    split_by_direction,
    two_forces,
)
from spool_gap.likelihood.search import Search, of_sets, senseless
from spool_gap.likelihood.structure import DELAY, GAIN, Structure
from spool_gap.likelihood.structure_fit import DECISIVE, StructureFit, fit_structure
from spool_gap.result import UNEXPLAINED, GapSettings

#: Temperature of the probabilities: evidence counts windows as independent and laws as exact, which no
#: record and no simulation is. Of 3 to 300 that with the least Brier score in 50 field cases of development.
TEMPERATURE = 10.0
#: Share of records of which every structure is wrong, so that no evidence among them tells: nine of about a
#: hundred field cases of development had another verdict than the truth, most at a probability of 1.
OUTSIDE = 0.1
#: Share of the verdicts `unexplained` without a name that are right: 13 of 26 of the field studies of seeds
#: 320036 to 320135 and 330000 to 330027. Of the others half hold a small effect beside friction, half a fault
#: of the measuring chain that the model has no part for.
RIGHTLY_UNEXPLAINED = 0.5
#: Standard deviations by which gain or delay must exceed its tolerance, and a size zero (95 %).
BEYOND = 2.0
#: Delay of a low-pass far below its corner over 1 over the corner in Hz (Butterworth, second order).
FILTERED = math.sqrt(2.0) / (2.0 * math.pi)
#: Share of what a named effect changes that another force may leave unexplained beside it, and by which a
#: plainer law may leave more.
MOST_LEFT = 0.1

#: Share of what play or preload changes by which a record differs from its law: real seats give, and the
#: instants at which a spool comes to them are not known exactly. Less than this is no pattern beside it.
SEATS = 0.05

#: Standard deviations by which a richer law must predict better than a plainer one that predicts well.
CERTAIN = 3.0

#: Minus the logarithm of the probability that noise makes a line at any frequency that was looked at: 1 %.
PERIODIC, PAID = "periodic_force", math.log(100.0)
BLOWS = "blows at the ends of the stroke"


@dataclass(frozen=True, slots=True)
class Other:
    """Structure that a record does not tell from the one that was taken.

    Attributes:
        fit: its fit; ``numbers``: with their intervals; ``effects``: that it names.
        share: its probability over that of all that are not distinguished.
    """

    fit: StructureFit
    numbers: Numbers
    effects: tuple[str, ...]
    share: float


@dataclass(frozen=True, slots=True)
class Decision:
    """What was decided.

    Attributes:
        fit: the structure, with every effect and part that the evidence decides for.
        numbers: its numbers with their intervals.
        effects: that are named, those of the spool's channel among them.
        small: share of the acceleration of each effect that is there and does not matter.
        shares: of each effect.
        rest: what a smooth force explains besides.
        unexplained: whether that is more than may be left.
        probabilities: of each set of effects, the most probable first; ``unexplained`` among them.
        base: nothing but the base.
        parts: of the measuring chain that matter.
        nearest: the effect that comes nearest where none is named.
        refused: why an effect is not named, by its id.
        signs: what the confidence goes by.
        others: that the record does not tell from it.
    """

    fit: StructureFit
    numbers: Numbers
    effects: tuple[str, ...]
    small: Mapping[str, float]
    shares: Mapping[str, float]
    rest: Rest
    unexplained: bool
    probabilities: Mapping[str, float]
    base: StructureFit
    parts: tuple[str, ...]
    nearest: tuple[str, ...]
    refused: Mapping[str, str]
    signs: Mapping[str, float]
    others: tuple[Other, ...] = ()

    @property
    def confidence(self) -> float:
        """Probability of the verdict: that among what was fitted, unless the truth is outside of all that."""
        if self.unexplained:
            return RIGHTLY_UNEXPLAINED * self.probabilities.get(UNEXPLAINED, 0.0)
        said = [_joined(self.fit), *(_joined(one.fit) for one in self.others)]
        return (1.0 - OUTSIDE) * sum(self.probabilities.get(one, 0.0) for one in said)


def decide(
    predictions: Predictions,
    search: Search,
    look: Look,
    settings: GapSettings,
    motions: Sequence[SwitchableMotion],
    held: HeldOut,
) -> Decision:
    """Return what the fits of ``search`` say."""
    refused: dict[str, str] = {}
    standing = _standing(search, held, settings.least_share)
    # Of each set of effects the likeliest that stands, where there is one.
    fits = search.of_each_set | of_sets(standing)
    richer: list[StructureFit] = []
    fit = _plainest(predictions, fits, _simplest(standing), refused, settings, held, richer)
    fit = _predicting(fits, held, fit, refused, settings.least_share)
    fit = _plainest(predictions, fits, fit, refused, settings, held, richer)
    fit, refined_fit, numbers = _beyond_chance(predictions, fits, fit, refused)
    chosen = fit
    # Where a free run does not tell a chain from a plainer one, that with more evidence moves the numbers.
    likeliest = search.of_each_set[frozenset(chosen.structure.effects)]
    if likeliest.structure.parts != chosen.structure.parts:
        numbers = numbers.united([likeliest])
    _refuse_leader(search, held, fit, refused)
    forces = two_forces(look.readings, predictions.parts[0].valve, motions, fit)
    fit = refined_fit
    if forces is not None:
        fit, numbers = _by_direction(predictions, fit, numbers, forces)
    own = fit.structure
    shares = {name: share_of_effect(predictions, fit, EFFECTS[name].terms) for name in own.effects}
    small = {name: share for name, share in shares.items() if share < settings.least_share}
    named = [name for name in own.effects if name not in small]
    named += _of_the_channel(own, numbers, look, settings)
    seats = [share for name, share in shares.items() if EFFECTS[name].local_minima]
    limits = settings.least_share, max(settings.least_share, SEATS * max(seats, default=0.0))
    rest, matters = _left(predictions, fit, numbers.dispersion, held.judged(fit), limits)
    unexplained = matters and rest.gain > DECISIVE
    # Free runs with play or preload part from the motion at chance, however right they are.
    chance = any(EFFECTS[name].localised or EFFECTS[name].local_minima for name in own.effects)
    if not unexplained and search.hit and not chance:
        rest, unexplained = _blows(predictions, held.judged(fit), settings.least_share, rest)
        matters |= unexplained
    if unexplained:
        # A name stands beside another force only where that is small against what the name explains: a law
        # that is none of the catalogue's looks like the nearest one of them, and leaves the rest. What
        # follows the body or is a wave is no force of the motion: the name has to explain more than that.
        least = rest.share / (1.0 if rest.beside else MOST_LEFT)
        for name in [one for one in named if shares.get(one, 0.0) < least]:
            named.remove(name)
            refused[name] = "the remainder is too large for this law to be right"
    standing = [one for one in standing if not _as_plain(predictions, one, chosen, settings.least_share)]
    odds = _evidence_of_sets(standing, fit, chosen, refused)
    # Where the evidence decides for a richer law and a free run sees no difference, neither is chosen.
    count = len(chosen.structure.effects)
    undecided = [
        one
        for one in richer
        if len(one.structure.effects) == count and one.evidence > chosen.evidence + DECISIVE
    ]
    odds |= {_joined(one): max(odds.values()) + DECISIVE for one in undecided}
    standing += undecided
    if forces is not None:
        odds[_joined(chosen)] = max(odds.values()) + DECISIVE - forces.evidence
    left = rest.gain - DECISIVE if matters else -math.inf
    probabilities = probabilities_of(odds, _joined(fit), left, frozenset(chosen.structure.effects))
    parts = tuple(key for key in own.parts if share_of_part(predictions, fit, key) >= settings.least_share)
    singles = [one for one in search.fits.values() if len(one.structure.effects) == 1]
    nearest = max(singles, key=lambda one: one.evidence, default=None)
    others = (
        ()
        if unexplained
        else _others(predictions, standing, chosen, _joined(fit), probabilities, look, settings)
    )
    return Decision(
        fit, numbers, tuple(named), small, shares, rest, unexplained, probabilities, search.base, parts,
        nearest.structure.effects if nearest else (), refused,
        {"rest": rest.gain, "rest_share": rest.share, "dispersion": numbers.dispersion,
         "least_share": min((shares[name] for name in shares if name not in small), default=1.0)},
        others,
    )  # fmt: skip


def _standing(search: Search, held: HeldOut, least_share: float) -> list[StructureFit]:
    """Return the fits that make sense and that no other one surely predicts better in a free run.

    Nor does one stand with parts of the measuring chain without which a free run is not surely worse.
    """
    best = search.best.evidence - search.base.evidence
    runs = {
        one: held.judged(one, refitted=False)
        for one in search.fits.values()
        if not senseless(one) and one.evidence - search.base.evidence >= min(0.0, best) - DECISIVE
    }

    def better(one: Judged, other: Judged) -> bool:
        return _gain(other, one) >= least_share and one.lead(other, of_logarithms=True) >= BEYOND

    def beaten(one: StructureFit) -> bool:
        own = runs[one]
        for other, run in runs.items():
            effects, parts = other.structure.key
            plainer = effects == one.structure.key[0] and parts < one.structure.key[1]
            if better(run, own) or (plainer and not better(own, run)):
                return True
        return False

    return [one for one in runs if not beaten(one)] or [search.best]


def _refuse_leader(search: Search, held: HeldOut, fit: StructureFit, refused: dict[str, str]) -> None:
    """Say in ``refused`` why effects of the structure with the most evidence are not in ``fit``."""
    leader = search.best
    errors = [100.0 * held.judged(one, refitted=False).agreement.nrmse for one in (leader, fit)]
    for name in sorted(set(leader.structure.effects) - set(fit.structure.effects)):
        reason = f"free-run error {errors[0]:.2g} % with this effect, {errors[1]:.2g} % with {_joined(fit)}"
        refused.setdefault(name, reason)


def _simplest(fits: Sequence[StructureFit]) -> StructureFit:
    """Return the one with the fewest numbers of those whose evidence does not decide against it."""
    least = max(one.evidence for one in fits) - DECISIVE
    near = [one for one in fits if one.evidence >= least]
    return min(near, key=lambda one: (one.count, -one.evidence))


def _of_the_channel(own: Structure, numbers: Numbers, look: Look, settings: GapSettings) -> list[str]:
    """Return gain or delay of the spool's channel where they exceed their tolerances.

    Low-passes of the channels delay, too: what makes up for one of them is no delay.
    """
    times = {"spool_anti_alias": "spool_filter_time", "body_anti_alias": "body_filter_time"}
    seconds = [own.values[name] if key in own.parts else 0.0 for key, name in times.items()]
    filtered = FILTERED * (seconds[0] - seconds[1])
    found = []
    for name, tolerance in ((GAIN, settings.gain_tolerance), (DELAY, settings.delay_tolerance)):
        one = numbers.of(name)
        # What the body did while its channel clipped is restored by a curve, which says nothing about a gain.
        told_apart = name == DELAY or "body" not in look.limits
        if one is None or not told_apart:
            continue
        sizes = [abs(one.value), abs(one.value + filtered)] if name == DELAY else [abs(one.value)]
        if min(sizes) - tolerance > BEYOND * one.standard_deviation:
            found.append(name)
    return found


def _evidence_of_sets(
    standing: Sequence[StructureFit], fit: StructureFit, chosen: StructureFit, refused: Mapping[str, str]
) -> dict[str, float]:
    """Return the evidence of each set of effects that stands and has nothing that was refused."""
    found = {_joined(fit): chosen.evidence}
    for one in standing:
        if not set(one.structure.effects) & (set(refused) - set(fit.structure.effects)):
            name = _joined(one)
            found[name] = max(found.get(name, -math.inf), one.evidence)
    return found


def _others(
    predictions: Predictions,
    standing: Sequence[StructureFit],
    chosen: StructureFit,
    said: str,
    probabilities: Mapping[str, float],
    look: Look,
    settings: GapSettings,
) -> tuple[Other, ...]:
    """Return the likeliest fit of each other set of effects that is as credible as that of ``chosen``.

    ``said``: what is named of ``chosen``, joined; with a force for each direction another law than its own.
    """
    of_set = of_sets(standing)
    taken = frozenset(chosen.structure.effects)
    of_set[taken] = chosen
    known = {own: probabilities.get(_joined(one), 0.0) for own, one in of_set.items()}
    known[taken] = probabilities[said]
    members = credible(known)
    total = sum(known[own] for own in members) or 1.0
    found = []
    for own in members:
        if own == taken:
            continue
        one = of_set[own]
        numbers = numbers_of(predictions, one)
        shares = {name: share_of_effect(predictions, one, EFFECTS[name].terms) for name in own}
        named = [name for name in one.structure.effects if shares[name] >= settings.least_share]
        names = (*named, *_of_the_channel(one.structure, numbers, look, settings))
        found.append(Other(one, numbers, names, known[own] / total))
    return tuple(found)


def _left(
    predictions: Predictions, fit: StructureFit, dispersion: float, judged: Judged, least: tuple[float, float]
) -> tuple[Rest, bool]:
    """Return what ``fit`` leaves, with its evidence, and whether a free run holds it and it is not small.

    ``least``: share that a smooth force has to make, and a pattern.
    """
    smooth = rest_of(predictions, fit)
    rest = replace(smooth, gain=smooth.gain / dispersion)
    # A free run that leaves no more than noise explains the record, whatever its prediction errors follow.
    matters = rest.share >= least[0] and judged.agreement.nrmse > judged.floor
    known = rest.share if matters and rest.gain > DECISIVE else 0.0
    for one in patterns_of(predictions, fit):
        # A pattern beside which noise leaves more is none that a user would look for.
        noise = math.sqrt(max(0.0, judged.agreement.nrmse**2 - one.share**2))
        loud = one.share >= max(known, least[1], min(judged.floor, noise))
        if loud and one.gain > DECISIVE:
            return replace(one, beside=one.follows != MOTION), True
    return rest, matters


def _blows(predictions: Predictions, judged: Judged, least: float, rest: Rest) -> tuple[Rest, bool]:
    """Return the remainder where the spool hits something that no effect describes, and whether it matters.

    Blows are in few samples: no smooth force follows them, and no pattern repeats.
    """
    error, floor = judged.agreement.nrmse, judged.floor
    share = math.sqrt(max(0.0, error**2 - floor**2))
    if share < max(least, floor):
        return rest, False
    return Rest(predictions.numbers * math.log(error / max(floor, 1e-9)), share, BLOWS), True


def _beyond_chance(
    predictions: Predictions,
    fits: Mapping[frozenset[str], StructureFit],
    fit: StructureFit,
    refused: dict[str, str],
) -> tuple[StructureFit, StructureFit, Numbers]:
    """Return ``fit`` without effects that chance may make, the same fitted to its end, and its numbers."""
    exact, numbers = refined(predictions, fit)
    own = fit.structure.effects
    chance = {name: "all its parameters may be zero" for name in own if _may_be_zero(name, numbers)}
    if PERIODIC in own and phase_kept(predictions, exact) < PAID:
        chance[PERIODIC] = "its phase wanders, as narrow-band noise does"
    if not chance:
        return fit, exact, numbers
    refused.update(chance)
    # What was fitted without them: the rest of the same set, else the most likely of the smaller ones.
    smaller = [one for kept, one in fits.items() if len(kept) < len(own) and not kept & refused.keys()]
    left = fits.get(frozenset(own) - set(chance)) or max(smaller, key=lambda one: one.evidence)
    return _beyond_chance(predictions, fits, left, refused)


def _may_be_zero(name: str, numbers: Numbers) -> bool:
    """Whether the 95 % intervals of all sizes of the effect ``name`` hold zero."""
    entry = EFFECTS[name]
    # What acts in few samples may be of any stiffness; its place shows that it is there.
    sizes = entry.fitted if entry.localised or not entry.amplitudes else entry.amplitudes
    found = [one for one in map(numbers.of, sizes) if one is not None]
    return all(abs(one.value) <= BEYOND * one.standard_deviation for one in found)


def _plainest(
    predictions: Predictions,
    fits: Mapping[frozenset[str], StructureFit],
    fit: StructureFit,
    refused: dict[str, str],
    settings: GapSettings,
    held: HeldOut,
    left: list[StructureFit],
) -> StructureFit:
    """Return ``fit`` with richer laws only where plainer ones do not do, and say in ``refused`` why.

    Those that were richer are added to ``left``.

    They do if they differ by less than the least share, or leave no more than noise of a free run and hardly
    more than the richer one: by less than the least share, or so little that no window by window comparison
    tells it from chance.
    """
    for name in fit.structure.effects:
        for plain in EFFECTS[name].replaces:
            effects = frozenset(plain if one == name else one for one in fit.structure.effects)
            other = fits.get(effects)
            if other is None:
                continue
            shown = share_between(predictions, fit, EFFECTS[name].terms, other, EFFECTS[plain].terms)
            judged, richer = held.judged(other), held.judged(fit)
            enough = min(judged.floor, (1.0 + MOST_LEFT) * richer.agreement.nrmse)
            chance = richer.lead(judged) < CERTAIN or _gain(judged, richer) < settings.least_share
            if shown < settings.least_share or (judged.agreement.nrmse <= enough and chance):
                refused[name] = (
                    f"it differs from {plain.replace('_', ' ')} by {100.0 * shown:.2g} % only"
                    if shown < settings.least_share
                    else f"the free-run error of {plain.replace('_', ' ')} is also within noise"
                )
                if shown >= settings.least_share:
                    left.append(fit)
                fit = other
                break
    return fit


def _as_plain(predictions: Predictions, one: StructureFit, plain: StructureFit, least: float) -> bool:
    """Whether laws of ``one`` contain those of ``plain`` and differ from them by less than ``least``."""
    own, other = set(one.structure.effects), set(plain.structure.effects)
    richer, laws = own - other, other - own
    if not laws or laws != {law for name in richer for law in EFFECTS[name].replaces if law in laws}:
        return False
    terms = [tuple(term for name in names for term in EFFECTS[name].terms) for names in (richer, laws)]
    return share_between(predictions, one, terms[0], plain, terms[1]) < least


def _gain(plainer: Judged, richer: Judged) -> float:
    """Return what the free run of ``richer`` explains beyond ``plainer``, share of the acceleration, rms."""
    return math.sqrt(max(0.0, plainer.agreement.nrmse**2 - richer.agreement.nrmse**2))


def _predicting(
    fits: Mapping[frozenset[str], StructureFit],
    held: HeldOut,
    fit: StructureFit,
    refused: dict[str, str],
    least_share: float,
) -> StructureFit:
    """Return ``fit`` without effects that make the free run over held-out windows no better.

    Where the fewer leave no more than noise, it has to be better by the least share. Those that stay may have
    plainer laws: a richer one may have made up for what the others did wrong.
    """
    own = frozenset(fit.structure.effects)
    known = own.union(*(EFFECTS[name].replaces for name in own))
    fewer = {
        effects: held.judged(fits[effects])
        for effects in fits
        if effects <= known and len(effects) < len(own)
    }
    richer = held.judged(fit)
    least = min(fewer, key=lambda effects: fewer[effects].agreement.nrmse, default=own)
    if least == own:
        return fit
    error = fewer[least].agreement.nrmse
    needed = least_share if error <= fewer[least].floor else 0.0
    if _gain(fewer[least], richer) > needed:
        return fit
    for name in sorted(own - least):
        own_error = f"{100.0 * richer.agreement.nrmse:.2g} %"
        refused[name] = f"free-run error {own_error} with this effect, {100.0 * error:.2g} % without"
    return _predicting(fits, held, fits[least], refused, least_share)


def _by_direction(
    predictions: Predictions, fit: StructureFit, numbers: Numbers, forces: TwoForces
) -> tuple[StructureFit, Numbers]:
    """Return ``fit`` with one friction force for each direction, and its numbers."""
    mean = numbers.of("coulomb_force")
    assert mean is not None
    structure = split_by_direction(fit.structure, forces.ratio)
    again = fit_structure(predictions, structure, steps=0)
    # A moving spool shows their mean; their difference has the error of the start.
    deviation = math.hypot(mean.standard_deviation, mean.value * forces.deviation)
    place = list(numbers.deviations).index("coulomb_force")
    kept = [number for number in range(len(numbers.quantities)) if number != place]
    quantities = [numbers.quantities[number] for number in kept]
    for name in ("forward_force", "backward_force"):
        quantities.append(
            replace(mean, name=name, value=structure.values[name], standard_deviation=deviation)
        )
    correlation = numbers.correlation[np.ix_([*kept, place, place], [*kept, place, place])].copy()
    of_mean = mean.standard_deviation / deviation if deviation > 0.0 else 1.0
    correlation[len(kept) :, : len(kept)] *= of_mean
    correlation[: len(kept), len(kept) :] *= of_mean
    correlation[-2:, -2:] = 2.0 * of_mean**2 - 1.0
    np.fill_diagonal(correlation, 1.0)
    return again, Numbers(tuple(quantities), correlation, numbers.dispersion)


def probabilities_of(
    evidence: Mapping[str, float], chosen: str, rest: float = -math.inf, held: frozenset[str] | None = None
) -> dict[str, float]:
    """Return the probability of each set of effects by its ``evidence``, the most probable first.

    Args:
        evidence: by the names of the effects, joined.
        chosen: the simplest of those that the evidence does not decide between.
        rest: evidence of something that no effect is, over that of ``chosen``.
        held: effects of ``chosen``. Of a set that adds to them no more than noise is known to do, the
            evidence counts as it stands: both are of one model, which other laws are not.
    """
    # The chosen one counts as the likeliest: others must be ahead by more than what decides.
    top = max(evidence.values()) + DECISIVE
    best = {**evidence, chosen: top, UNEXPLAINED: top + rest}
    for name, value in evidence.items():
        if held is not None and held < set(name.split("+")) - {"none"} and name != chosen:
            best[name] = top - TEMPERATURE * (top - value)
    scaled = {name: (value - max(best.values())) / TEMPERATURE for name, value in best.items()}
    total = sum(math.exp(value) for value in scaled.values())
    found = {name: math.exp(value) / total for name, value in scaled.items()}
    return dict(sorted(found.items(), key=lambda row: -row[1]))


def _joined(fit: StructureFit) -> str:
    return "+".join(sorted(fit.structure.effects)) or "none"
