"""Decision: the most probable set of effects, how probable it is, and the intervals of its numbers.

Each structure has the evidence of its likelihood; those with the same effects differ in the measuring chain
alone and count by the best of them. A smooth force of any law competes with all: where it explains what
the best structure leaves, something is unexplained. What is named must be decided by the evidence and must
change the motion by more than the stated share.

Intervals: where errors are independent noise of the estimated level, the curvature of the likelihood at its
maximum gives the covariance of the numbers. Errors that go with the motion, as those of a noisy input or of a
law that is a little wrong, repeat from line to line; each window of a second then pulls the numbers another
way than chance allows. The sandwich of curvature and of the scatter of the windows' pulls counts that. Where
a force jumps, its instants scatter, and slopes over short steps seem to tell more than they do: the wider
interval of two lengths of step counts. Under the right model, two corrections of different strength give the
same numbers but for chance; the largest difference to those of the next corrections is added to the interval.

Sources: Kass and Raftery, Bayes factors, 1995; Huber, 1967; White, 1982 (sandwich); Murphy and van der Vaart,
JASA 95, 2000 (profile likelihood); Raue and others, Bioinformatics 25, 2009 (what a profile
shows); Hausman, Specification tests in econometrics, 1978 (two estimators).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from spool_core.numbers import Array
from spool_core.uncertainty import Quantity, Validity

from spool_gap.catalogue import EFFECTS
from spool_gap.evidence.held_out import HeldOut, Judged
from spool_gap.evidence.look import Look
from spool_gap.likelihood.kernel import SwitchableMotion
from spool_gap.likelihood.prediction import Predictions
from spool_gap.likelihood.remainder import patterns_of, phase_kept
from spool_gap.likelihood.rest import (
    Rest,
    TwoForces,
    foreseen,
    rest_of,
    share_between,
    share_of_effect,
    share_of_part,
    split_by_direction,
    two_forces,
)
from spool_gap.likelihood.search import COMPARED, DECISIVE, Search, senseless
from spool_gap.likelihood.structure import DELAY, GAIN
from spool_gap.likelihood.structure_fit import LOOSENESS, Curvature, StructureFit, curvature_of, fit_structure
from spool_gap.result import RISE_95, GapSettings, ProfileLikelihood, verdict_of

#: Temperature of the probabilities: evidence counts windows as independent and laws as exact, which no
#: record and no simulation is. Of 3 to 300 that with the least Brier score in 50 field cases of development.
TEMPERATURE = 10.0
#: Share of records of which every structure is wrong, so that no evidence among them tells: nine of about a
#: hundred field cases of development had another verdict than the truth, most at a probability of 1.
OUTSIDE = 0.1
#: Standard deviations by which gain or delay must exceed its tolerance, and a size zero (95 %).
BEYOND = 2.0
#: Evidence of a remainder in a free run over that in prediction errors, at least. In cases of development it
#: was 0.008 for vibration across the axis, and 0.3 to 4 for laws.
RUNS = 0.1
#: Share of what a named effect changes that may be left unexplained beside it, and by which a plainer law may
#: leave more.
MOST_LEFT = 0.1

#: Share of what play or preload changes by which a record differs from its law: real seats give, and the
#: instants at which a spool comes to them are not known exactly. Less than this is no pattern beside it.
SEATS = 0.05

#: Standard deviations by which a richer law must predict better than a plainer one that predicts well.
CERTAIN = 3.0

#: Minus the logarithm of the probability that noise makes a line at any frequency that was looked at: 1 %.
PERIODIC, PAID = "periodic_force", math.log(100.0)
UNEXPLAINED = "unexplained"


#: Lengths of the steps that slopes of intervals are taken over, in those of a fit.
WIDENED = (1.0, 10.0)
#: Rise of the log likelihood that ends the last fit: far below what moves a number by a standard deviation.
EXACT = 0.05

#: Standard deviations at which a number is held, until the likelihood has fallen enough: the first four show
#: a parabola where there is one, the last a number that is hardly bounded.
STEPS = (1.0, 2.0, 3.0, 5.0, 10.0, 30.0, 100.0)
#: Fall of twice the log likelihood at which a side ends.
FAR_ENOUGH = 1.5 * RISE_95


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

    @property
    def confidence(self) -> float:
        """Probability of the verdict: that among what was fitted, unless the truth is outside of all that."""
        said = UNEXPLAINED if self.unexplained else _joined(self.fit)
        return (1.0 - OUTSIDE) * self.probabilities.get(said, 0.0)


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
    fit = _plainest(predictions, search, search.simplest, refused, settings, held)
    fit = _predicting(search, held, fit, refused, settings.least_share)
    fit = _plainest(predictions, search, fit, refused, settings, held)
    fit, refined, numbers = _beyond_chance(predictions, search, fit, refused)
    forces = two_forces(look.readings, predictions.parts[0].valve, motions, fit)
    fit = refined
    if forces is not None:
        fit, numbers = _by_direction(predictions, fit, numbers, forces)
    own = fit.structure
    shares = {name: share_of_effect(predictions, fit, EFFECTS[name].terms) for name in own.effects}
    small = {name: share for name, share in shares.items() if share < settings.least_share}
    named = [name for name in own.effects if name not in small]
    for name, tolerance in ((GAIN, settings.gain_tolerance), (DELAY, settings.delay_tolerance)):
        one = numbers.of(name)
        # What the body did while its channel clipped is restored by a curve, which says nothing about a gain.
        told_apart = name == DELAY or "body" not in look.limits
        if one is not None and told_apart and abs(one.value) - tolerance > BEYOND * one.standard_deviation:
            named.append(name)
    seats = [share for name, share in shares.items() if EFFECTS[name].local_minima]
    limits = settings.least_share, max(settings.least_share, SEATS * max(seats, default=0.0))
    rest, matters = _left(predictions, fit, numbers.dispersion, held.judged(fit), limits)
    unexplained = matters and rest.gain > DECISIVE
    if unexplained:
        # A name stands beside a remainder only where that is small against what the name explains: a law
        # that is none of the catalogue's looks like the nearest one of them, and leaves the rest.
        least = rest.share / MOST_LEFT
        for name in [one for one in named if shares.get(one, 0.0) < least]:
            named.remove(name)
            refused[name] = "the remainder beside it is too large for its law to be the right one"
    probabilities = _probabilities(search, fit, refused, rest.gain - DECISIVE if matters else -math.inf)
    parts = tuple(key for key in own.parts if share_of_part(predictions, fit, key) >= settings.least_share)
    singles = [one for one in search.fits.values() if len(one.structure.effects) == 1]
    nearest = max(singles, key=lambda one: one.evidence, default=None)
    return Decision(
        fit, numbers, tuple(named), small, shares, rest, unexplained, probabilities, search.base, parts,
        nearest.structure.effects if nearest else (), refused,
        {"rest": rest.gain, "rest_share": rest.share, "dispersion": numbers.dispersion,
         "least_share": min((shares[name] for name in shares if name not in small), default=1.0)},
    )  # fmt: skip


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
    # Nor does a sensor's own error, which is in the measured motion, too, and not in that of a free run.
    if matters and rest.gain > DECISIVE:
        matters = foreseen(predictions, fit, rest.follows) > RUNS * smooth.gain
    known = rest.share if matters and rest.gain > DECISIVE else 0.0
    for one in patterns_of(predictions, fit):
        # A pattern beside which noise leaves more is none that a user would look for.
        noise = math.sqrt(max(0.0, judged.agreement.nrmse**2 - one.share**2))
        loud = one.share >= max(known, least[1], min(judged.floor, noise))
        if loud and one.gain > DECISIVE:
            return Rest(one.gain, one.share, one.follows), True
    return rest, matters


@dataclass(frozen=True, slots=True)
class Numbers:
    """Fitted numbers with their intervals.

    Attributes:
        quantities: each with its standard deviation, in the order of the fit.
        correlation: shape (p, p).
        dispersion: how many times the windows' pulls scatter more than chance allows, in power, 1 at least.
    """

    quantities: tuple[Quantity, ...]
    correlation: Array
    dispersion: float

    def of(self, name: str) -> Quantity | None:
        """Return the number called ``name``, ``None`` where it was not fitted."""
        return next((one for one in self.quantities if one.name == name), None)

    @property
    def deviations(self) -> dict[str, float]:
        """Standard deviation by name."""
        return {one.name: one.standard_deviation for one in self.quantities}


def numbers_of(predictions: Predictions, fit: StructureFit) -> Numbers:
    """Return the numbers of ``fit`` with their intervals."""
    residual = predictions.weighed(fit.lines, predictions.weights(fit.lines))
    found = [_covariances(predictions, curvature_of(predictions, fit, one), residual) for one in WIDENED]
    bread, sandwich = found[0]
    # Never narrower than noise alone makes them.
    spread = np.sqrt(np.max([np.diag(one) for pair in found for one in pair], axis=0).clip(0.0))
    wider = np.diag(sandwich) > np.diag(bread)
    correlation = np.where(wider[:, np.newaxis] & wider, _correlation(sandwich), _correlation(bread))
    np.fill_diagonal(correlation, 1.0)
    dispersion = max(1.0, float(np.trace(np.linalg.pinv(bread) @ sandwich)) / len(fit.names))
    quantities = tuple(
        Quantity(one.name, one.unit, fit.structure.values[one.name], float(deviation), Validity.VALID)
        for one, deviation in zip(fit.unknowns, spread, strict=True)
    )
    return Numbers(quantities, np.clip(correlation, -1.0, 1.0), dispersion)


def _covariances(predictions: Predictions, curvature: Curvature, residual: Array) -> tuple[Array, Array]:
    """Return the covariance by the curvature, and its sandwich with the scatter of the windows' pulls."""
    bread = curvature.covariance
    pulls = _by_window(predictions, curvature.slopes * residual)
    count = pulls.shape[1]
    meat = pulls @ pulls.T * (count / max(count - bread.shape[0], 1))
    return bread, bread @ meat @ bread


def _correlation(covariance: Array) -> Array:
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    return np.asarray(covariance / np.outer(size, size))


def profiles_of(
    predictions: Predictions,
    fit: StructureFit,
    numbers: Numbers,
    names: Sequence[str],
    progress: Callable[[float], None] = lambda _share: None,
) -> tuple[ProfileLikelihood, ...]:
    """Return the profile likelihoods of the fitted numbers ``names`` of ``fit``.

    Rises are divided by the dispersion, so that a profile agrees with the interval near its lowest point.
    """
    found = []
    for count, name in enumerate(names):
        progress(count / len(names))
        if numbers.deviations.get(name, 0.0) > 0.0:
            found.append(_profile(predictions, fit, numbers, name))
    return tuple(found)


def _refined(predictions: Predictions, fit: StructureFit) -> tuple[StructureFit, Numbers]:
    """Return ``fit`` fitted to its end, and its numbers with what other corrections make of them."""
    again = fit_structure(predictions, fit.structure, (fit.looseness,), enough=EXACT)
    numbers = numbers_of(predictions, again)
    place = LOOSENESS.index(again.looseness)
    around = (*LOOSENESS[max(0, place - 1) : place], *LOOSENESS[place + 1 : place + 2])
    nearest = [one for one in around if one <= COMPARED]
    others = [fit_structure(predictions, again.structure, (one,), enough=EXACT).structure for one in nearest]
    quantities = []
    for one in numbers.quantities:
        moved = max(abs(other.values[one.name] - one.value) for other in others)
        quantities.append(replace(one, standard_deviation=math.hypot(one.standard_deviation, moved)))
    return again, replace(numbers, quantities=tuple(quantities))


def _beyond_chance(
    predictions: Predictions, search: Search, fit: StructureFit, refused: dict[str, str]
) -> tuple[StructureFit, StructureFit, Numbers]:
    """Return ``fit`` without effects that chance may make, the same fitted to its end, and its numbers."""
    refined, numbers = _refined(predictions, fit)
    own = fit.structure.effects
    chance = {name: "none of its numbers differs from zero" for name in own if _may_be_zero(name, numbers)}
    if PERIODIC in own and phase_kept(predictions, refined) < PAID:
        chance[PERIODIC] = "it keeps no phase, as noise in a narrow band"
    if not chance:
        return fit, refined, numbers
    refused.update(chance)
    fits = search.of_each_set
    # What was fitted without them: the rest of the same set, else the most likely of the smaller ones.
    smaller = [one for kept, one in fits.items() if len(kept) < len(own) and not kept & refused.keys()]
    left = fits.get(frozenset(own) - set(chance)) or max(smaller, key=lambda one: one.evidence)
    return _beyond_chance(predictions, search, left, refused)


def _may_be_zero(name: str, numbers: Numbers) -> bool:
    """Whether the 95 % intervals of all sizes of the effect ``name`` hold zero."""
    entry = EFFECTS[name]
    # What acts in few samples may be of any stiffness; its place shows that it is there.
    sizes = entry.fitted if entry.localised or not entry.amplitudes else entry.amplitudes
    found = [one for one in map(numbers.of, sizes) if one is not None]
    return all(abs(one.value) <= BEYOND * one.standard_deviation for one in found)


def _plainest(
    predictions: Predictions,
    search: Search,
    fit: StructureFit,
    refused: dict[str, str],
    settings: GapSettings,
    held: HeldOut,
) -> StructureFit:
    """Return ``fit`` with richer laws only where plainer ones do not do, and say in ``refused`` why.

    They do if they differ by less than the least share, or leave no more than noise of a free run and hardly
    more than the richer one: by less than the least share, or so little that no window by window comparison
    tells it from chance.
    """
    for name in fit.structure.effects:
        for plain in EFFECTS[name].replaces:
            effects = frozenset(plain if one == name else one for one in fit.structure.effects)
            other = search.of_each_set.get(effects)
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
                    else f"with {plain.replace('_', ' ')} a free run leaves no more than noise, too"
                )
                fit = other
                break
    return fit


def _gain(plainer: Judged, richer: Judged) -> float:
    """Return what the free run of ``richer`` explains beyond ``plainer``, share of the acceleration, rms."""
    return math.sqrt(max(0.0, plainer.agreement.nrmse**2 - richer.agreement.nrmse**2))


def _predicting(
    search: Search, held: HeldOut, fit: StructureFit, refused: dict[str, str], least_share: float
) -> StructureFit:
    """Return ``fit`` without effects that make the free run over held-out windows no better.

    Where the fewer leave no more than noise, it has to be better by the least share. Those that stay may have
    plainer laws: a richer one may have made up for what the others did wrong.
    """
    own = frozenset(fit.structure.effects)
    known = own.union(*(EFFECTS[name].replaces for name in own))
    fits = search.of_each_set
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
        shown = f"{100.0 * richer.agreement.nrmse:.2g} %, without it {100.0 * error:.2g} %"
        refused[name] = f"with it a free run leaves {shown}"
    return _predicting(search, held, fits[least], refused, least_share)


def _by_direction(
    predictions: Predictions, fit: StructureFit, numbers: Numbers, forces: TwoForces
) -> tuple[StructureFit, Numbers]:
    """Return ``fit`` with one friction force for each direction, and its numbers."""
    mean = numbers.of("coulomb_force")
    assert mean is not None
    structure = split_by_direction(fit.structure, forces.ratio)
    again = fit_structure(predictions, structure, (fit.looseness,), steps=0)
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


def _probabilities(
    search: Search, fit: StructureFit, refused: Mapping[str, str], rest: float
) -> dict[str, float]:
    best: dict[str, float] = {}
    for one in search.fits.values():
        if set(one.structure.effects) & (set(refused) - set(fit.structure.effects)):
            continue
        if senseless(one):
            continue
        name = _joined(one)
        best[name] = max(best.get(name, -math.inf), one.evidence)
    return probabilities_of(best, _joined(fit), rest)


def probabilities_of(evidence: Mapping[str, float], chosen: str, rest: float = -math.inf) -> dict[str, float]:
    """Return the probability of each set of effects by its ``evidence``, the most probable first.

    Args:
        evidence: by the names of the effects, joined.
        chosen: the simplest of those that the evidence does not decide between.
        rest: evidence of something that no effect is, over that of ``chosen``.
    """
    # The chosen one counts as the likeliest: others must be ahead by more than what decides.
    top = max(evidence.values()) + DECISIVE
    best = {**evidence, chosen: top, UNEXPLAINED: top + rest}
    scaled = {name: (value - max(best.values())) / TEMPERATURE for name, value in best.items()}
    total = sum(math.exp(value) for value in scaled.values())
    found = {name: math.exp(value) / total for name, value in scaled.items()}
    return dict(sorted(found.items(), key=lambda row: -row[1]))


def _joined(fit: StructureFit) -> str:
    return "+".join(sorted(fit.structure.effects)) or "none"


def _by_window(predictions: Predictions, rows: Array) -> Array:
    """Return the sums of ``rows`` (p, numbers) over each window that counts, shape (p, windows)."""
    sums, begin = [], 0
    for part in predictions.parts:
        windows, lines = int(part.inside.sum()), part.lines.size
        block = rows[:, begin : begin + 2 * windows * lines].reshape(rows.shape[0], 2, windows, lines)
        sums.append(block.sum(axis=(1, 3)))
        begin += 2 * windows * lines
    return np.concatenate(sums, axis=1)


def _profile(predictions: Predictions, fit: StructureFit, numbers: Numbers, name: str) -> ProfileLikelihood:
    unknown = next(one for one in fit.unknowns if one.name == name)
    best = fit.structure.values[name]
    rows = [(best, 0.0)]
    partners: dict[str, float] = {}
    for side in (-1.0, 1.0):
        for value, rise, held in _side(predictions, fit, numbers, name, side):
            rows.append((value, rise))
            for other in numbers.quantities:
                if other.name != name and other.standard_deviation > 0.0:
                    moved = abs(held.structure.values[other.name] - fit.structure.values[other.name])
                    size = moved / other.standard_deviation
                    partners[other.name] = max(partners.get(other.name, 0.0), size)
    rows.sort()
    partner = max(partners, key=lambda one: partners[one], default="")
    values, rises = zip(*rows, strict=True)
    return verdict_of(name, unknown.unit, tuple(values), tuple(rises), best, partner)


def _side(
    predictions: Predictions, fit: StructureFit, numbers: Numbers, name: str, side: float
) -> Iterator[tuple[float, float, StructureFit]]:
    unknown = next(one for one in fit.unknowns if one.name == name)
    place = [one.name for one in numbers.quantities].index(name)
    spread, best = numbers.deviations[name], fit.structure.values[name]
    # The likelihood's own width near its maximum, to which the interval is compared.
    own = math.sqrt(max(curvature_of(predictions, fit).covariance[place, place], 1e-300))
    widened = max(1.0, (spread / own) ** 2)
    start = fit.structure
    for step in STEPS:
        value = min(max(best + side * step * spread, unknown.low), unknown.high)
        held = fit_structure(
            predictions, start.moved({name: value}), (fit.looseness,), held=frozenset({name}), steps=6
        )
        rise = max(0.0, 2.0 * (fit.log_likelihood - held.log_likelihood) / widened)
        yield value, rise, held
        start = held.structure
        if rise > FAR_ENOUGH or value in (unknown.low, unknown.high):
            return
