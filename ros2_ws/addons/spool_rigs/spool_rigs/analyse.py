"""Workflow for force records: base, where the gap sits, which force is missing, what remains."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from spool_core.errors import InputError
from spool_core.uncertainty import Z_95, percent, with_interval
from spool_estimator.identification.determination import ProfileLikelihood, verdict_of
from spool_gap.catalogue import EFFECTS, FRICTIONS
from spool_gap.effect import Effect
from spool_gap.evidence.decision import OUTSIDE, probabilities_of
from spool_gap.likelihood.structure_fit import DECISIVE
from spool_gap.result import Explanation, GapResult, GapSettings, NamedEffect, Progress, RankedHypothesis
from spool_report.requests import GapRequest, Selection
from spool_sim.model import Model
from spool_sim.valve import Valve, find_valve

from spool_rigs.balance import (
    ForceBalance,
    ForceFit,
    check_mass,
    check_motion,
    conditions_of,
    independent_samples,
)
from spool_rigs.position import (
    CONSTANT,
    Chosen,
    cross_validated,
    fitted_by_position,
    free_run_error,
    parameters_of,
)
from spool_rigs.records import LEAST, ForceRecord, force_records
from spool_rigs.result import check_one_mass, closing, determined, quantities_of, result_of

#: s of the stretches that are fitted and held out by turns.
STRETCH = 4.0
#: Share of the held-out error, rms, that an effect must take away.
SMALLEST = 0.03
#: Error over that of a richer law up to which the plain one, which it contains, is kept: derivatives err by
#: more than the motion that is predicted from accelerations.
PLAIN = 1.15
#: Correlation of two columns, base taken off, from which they cannot be distinguished.
ALIKE = 0.97
#: Ratio of the 95 to the 5 % quantile of the speed below which the speed hardly varies, and standard
#: deviations from which viscous and Coulomb friction are two numbers all the same (one in 370 by chance).
VARIED, TWO_NUMBERS = 6.0, 3.0
#: Sets of effects that are extended side by side.
BEAM = 2
#: Why a hypothesis of the ranking is not part of the verdict.
GROWS = "the error on held-out data rises with it"
INSIGNIFICANT = "it does not close the gap significantly"
LITTLE = "it closes less than a third of the gap, and the rest is unexplained"
#: Probability from which another set of effects is listed.
PROBABLE = 0.05
#: Standard deviations of a linear number, and factors on one that shapes a law, at which they are held.
DEVIATIONS = (-4.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.0)
FACTORS = (0.1, 0.3, 0.6, 0.8, 0.9, 0.95, 1.0, 1.05, 1.1, 1.25, 1.6, 3.0, 10.0)


def gap_of_forces(
    request: GapRequest, selection: Selection, base: Model, settings: GapSettings, progress: Progress
) -> tuple[GapResult, Valve | None, list[ForceRecord]]:
    """Return what ``base`` lacks in the records of ``request``, their valve if one is named, and all of them.

    Raises:
        InputError: records or valve cannot be used.
    """
    # Who imposes a motion measures the force on whatever is moved: no mass is known.
    named = request.valve if request.kind == "driven" else None
    valve = None if named is None else find_valve(named)
    mass = request.mass if valve is None or request.mass is not None else valve.moving_mass
    notes: list[str] = []
    records, held = (
        force_records(paths, request.kind, selection, notes) for paths in (request.records, request.holdout)
    )
    found = analyse_forces(
        records, base, request.kind, holdout=held, mass=mass, settings=settings, progress=progress
    )
    found = replace(found, warnings=(*dict.fromkeys(notes), *found.warnings))
    return found, valve, [*records, *held]


def analyse_forces(
    records: Sequence[ForceRecord],
    base: Model,
    kind: str,
    *,
    holdout: Sequence[ForceRecord] = (),
    mass: float | None = None,
    settings: GapSettings | None = None,
    progress: Progress | None = None,
) -> GapResult:
    """Return which force is missing in ``records``.

    Args:
        records: displacement and force.
        base: with ``spring`` and ``viscous_friction``, and ``inertia`` where the force drives a mass.
        kind: ``driven`` or ``imposed``.
        holdout: records to judge on; without them every other stretch is held out.
        mass: kg, that the force drives; ``None`` fits it.
        settings: amounts.
        progress: takes what is done and the share of the work.

    Raises:
        InputError: the records cannot be analysed; what is wrong is named.
    """
    begun = time.monotonic()
    chosen_settings = settings or GapSettings()
    tell = progress or (lambda _what, _share: None)
    tell("checking the records", 0.0)
    train, held = _split(records, holdout)
    warnings = conditions_of(train)
    conditions_of(held)
    names = {entry.name for entry in base.terms}
    columns = ["damping"] if "viscous_friction" in names else []
    columns += ["stiffness"] if "spring" in names else []
    columns += ["mass"] if kind == "driven" and mass is None else []
    balance = ForceBalance(train, held, [*columns, "zero"], driven=kind == "driven", mass=mass)
    if kind == "driven":
        check_motion(balance, train[0].name)
        if check_one_mass(balance, base, train[0].name):
            check_mass(balance, balance.fit([]), train[0].name, mass)
    if kind == "driven" and "stiffness" in columns and not _has_spring(train, balance, base):
        columns.remove("stiffness")
        warnings.append(
            "no spring detected: its stiffness may be zero, or a free run without one fits as well; "
            "the base omits it"
        )
        balance = ForceBalance(train, held, [*columns, "zero"], driven=True, mass=mass)
    alike = _cannot_tell(balance)
    tried = searched(balance, kind, chosen_settings.most_effects, tell)
    decided = decide(tried)
    steps: list[tuple[Chosen, ForceFit]] = [(one.chosen, one.fit) for one in decided.path]
    ranking = _ranked(balance, tried, decided)
    tell("measuring the remainder", 0.9)
    if kind == "driven":
        tell("following the position", 0.6)
        steps = _by_position(train, balance, steps, base)
        steps += _with_constant_force(balance, steps[-1], ranking, base)
    steps, refused = without_growth(balance, steps, ranking)
    found = steps[-1][0]
    steps, weak = closing(base, balance, steps)
    ranking = [
        replace(row, accepted=False, reason=LITTLE) if row.accepted and row.id in weak else row
        for row in ranking
    ]
    shares = probabilities(tried, frozenset(entry.id for entry, _ in steps[-1][0]) - {CONSTANT})
    sure = next(iter(shares.values()))
    told = [*warnings, *refused, *(_differing(balance, found) if holdout else [])]
    result = result_of(records, base, kind, balance, steps, ranking, told, alike, weak, sure, begun)
    known = determined(balance, base, steps[-1][1])
    result = replace(result, sentence=" ".join([result.sentence, *refused]), determinations=known)
    if result.effects:
        result = replace(result, alternatives=_alternatives(balance, tried, shares))
    if chosen_settings.profiles and result.effects:
        result = replace(result, profiles=force_profiles(balance, *steps[-1], result.effects))
    return result


def _split(
    records: Sequence[ForceRecord], holdout: Sequence[ForceRecord]
) -> tuple[list[ForceRecord], list[ForceRecord]]:
    if not records:
        raise InputError("records: no record given, name at least one")
    if holdout:
        return list(records), list(holdout)
    train: list[ForceRecord] = []
    held: list[ForceRecord] = []
    for record in records:
        for number, part in enumerate(record.cut(max(2, round(record.duration / STRETCH)))):
            if part.force.size >= LEAST:
                (train if number % 2 == 0 else held).append(part)
    if not train or not held:
        longest = max(record.duration for record in records)
        raise InputError(
            f"{records[0].name}: too short: its longest stretch has {longest:.2f} s; "
            "record longer, or name another record with --holdout"
        )
    return train, held


def _cannot_tell(balance: ForceBalance) -> tuple[str, ...]:
    """Return names of forces that these records cannot distinguish."""
    motions = [balance.motions[id(record)] for record in balance.train]
    speed = np.abs(np.concatenate([one.velocity for one in motions]))
    moving = speed[speed > 0.05 * float(np.quantile(speed, 0.95))]
    spread = float(np.quantile(moving, 0.95) / max(float(np.quantile(moving, 0.05)), 1e-12))
    rows = [np.array([one.velocity, one.sign, np.ones(one.time.size)]) for one in motions]
    velocity, sign, one = np.concatenate(rows, axis=1)
    velocity, sign = velocity - velocity.mean() * one, sign - sign.mean() * one
    alike = abs(float(velocity @ sign)) / max(float(np.linalg.norm(velocity) * np.linalg.norm(sign)), 1e-30)
    # A driven mass passes through all speeds; an imposed one may have a single speed, and its reversals.
    if alike <= ALIKE and (spread >= VARIED or (balance.driven and _two_numbers(balance))):
        return ()
    return ("viscous_friction", "coulomb_friction")


def _has_spring(train: Sequence[ForceRecord], balance: ForceBalance, base: Model) -> bool:
    """Whether a spring is needed: by both covariances, and by free runs over parts that no fit has seen.

    A free run takes any slow disturbance for a weak spring. The balance of forces does not: its interval of
    such a spring contains zero.
    """
    coulomb = EFFECTS["coulomb_friction"]
    chosen: Chosen = ((coulomb, {}),) if balance.plausible(coulomb, [], {}) else ()
    place = balance.base.index("stiffness")

    def may_be_zero(fit: ForceFit) -> bool:
        return abs(float(fit.coefficients[place])) < TWO_NUMBERS * float(fit.deviations[place])

    fit = balance.fit(chosen)
    if may_be_zero(fit) or may_be_zero(fitted_by_position(base, balance, chosen, fit) or fit):
        return False
    without = [name for name in balance.base if name != "stiffness"]
    errors = [cross_validated(train, names, chosen, base, balance.mass) for names in (balance.base, without)]
    return errors[0] < errors[1] or math.isinf(errors[1])


def _two_numbers(balance: ForceBalance) -> bool:
    """Whether the covariance of a joint fit determines both viscous and Coulomb friction."""
    if "damping" not in balance.base:
        return False
    fit = balance.fit([(EFFECTS["coulomb_friction"], {})])
    size = np.abs(fit.coefficients) / np.maximum(fit.deviations, 1e-300)
    return bool(min(size[balance.base.index("damping")], size[-1]) > TWO_NUMBERS)


def _by_position(
    train: Sequence[ForceRecord], balance: ForceBalance, steps: Sequence[tuple[Chosen, ForceFit]], base: Model
) -> list[tuple[Chosen, ForceFit]]:
    """Return ``steps`` with the numbers that follow the position, where that holds on parts left out, too."""
    chosen, fit = steps[-1]
    found = followed(balance, chosen, fit, base)
    if found is None or any(_grows(balance, found, before) for _, before in steps[:-1]):
        return list(steps)
    errors = [
        cross_validated(train, balance.base, chosen, base, balance.mass, by_position=by_position)
        for by_position in (True, False)
    ]
    return [*steps[:-1], (chosen, found)] if errors[0] < errors[1] else list(steps)


def followed(balance: ForceBalance, chosen: Chosen, fit: ForceFit, base: Model) -> ForceFit | None:
    """Return ``fit`` with the numbers that follow the position, if both held-out errors fall with them.

    These are the errors of the force and of the free run of position. A step of friction at a reversal is
    smeared by the low-pass, and the numbers of the balance follow that: with friction the force counts away
    from reversals.
    """
    found = fitted_by_position(base, balance, chosen, fit)
    if found is None:
        return None
    sliding = any(entry.is_friction for entry, _ in chosen)
    forces = [balance.held_out_error(one, sliding=sliding) for one in (fit, found)]
    places = [free_run_error(base, balance, chosen, one) for one in (fit, found)]
    falls = forces[1] < forces[0] and (places[1] < places[0] or math.isnan(places[0]))
    return found if falls else None


def _grows(balance: ForceBalance, fit: ForceFit, before: ForceFit) -> bool:
    """Whether the held-out error of ``fit`` is larger than that of ``before``, in N or over the force."""
    return balance.held_out_error(fit) > balance.held_out_error(before) or balance.nrmse(fit) > balance.nrmse(
        before
    )


def without_growth(
    balance: ForceBalance, steps: Sequence[tuple[Chosen, ForceFit]], ranking: list[RankedHypothesis]
) -> tuple[list[tuple[Chosen, ForceFit]], list[str]]:
    """Return ``steps`` without those that make the held-out error larger, and a sentence about each."""
    kept, refused = list(steps), []
    while len(kept) > 1 and _grows(balance, kept[-1][1], kept[-2][1]):
        (chosen, fit), (others, before) = kept.pop(), kept[-1]
        names = [entry.id for entry, _ in chosen if entry.id not in {one.id for one, _ in others}]
        told = " and ".join(name.replace("_", " ") for name in names)
        refused.append(
            f"Refused: {told}; on held-out data the error rises with it, from "
            f"{percent(balance.nrmse(before), 3)} to {percent(balance.nrmse(fit), 3)}."
        )
        for place, row in enumerate(ranking):
            if row.accepted and row.id in names:
                ranking[place] = replace(row, accepted=False, reason=GROWS)
    return kept, refused


def _with_constant_force(
    balance: ForceBalance, step: tuple[Chosen, ForceFit], ranking: list[RankedHypothesis], base: Model
) -> list[tuple[Chosen, ForceFit]]:
    """Return ``step`` with its constant force named, if held-out data needs that.

    The force of an actuator has a zero, too, and friction that differs by direction is the same to a record
    without rest: the simpler of them is named.
    """
    entry = EFFECTS[CONSTANT]
    chosen, fit = step
    if any(own.name == CONSTANT for own in base.terms):
        return []
    names = [name for name in balance.base if name != "zero"]
    bare = ForceBalance(balance.train, balance.held, names, driven=True, mass=balance.mass)
    without = bare.fit(chosen)
    without = followed(bare, chosen, without, base) or without
    before, after = (math.sqrt(sum(float(np.sum(row**2)) for row in own.held)) for own in (without, fit))
    place = balance.base.index("zero")
    size = abs(float(fit.coefficients[place])) / max(float(fit.deviations[place]), 1e-300)
    independent = sum(independent_samples(row) for row in without.held)
    evidence = independent * math.log(max(before, 1e-12) / max(after, 1e-12))
    evidence -= 0.5 * math.log(max(3.0, independent))
    enough = after < (1.0 - SMALLEST) * before and evidence > DECISIVE and size > TWO_NUMBERS
    reason = "" if enough else INSIGNIFICANT
    push = -balance.sign * float(fit.coefficients[place])
    known = tuple(e.id for e, _ in chosen)
    row = RankedHypothesis(
        CONSTANT, known, balance.nrmse(fit), 2.0 * evidence, {"push": push}, accepted=enough, reason=reason
    )
    ranking.append(row)
    return [((*chosen, (entry, {})), fit)] if enough else []


# Sets of effects --------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class TriedForces:
    """Set of effects that was fitted to the forces.

    Attributes:
        chosen: the effects with their shapes.
        fit: jointly with the base.
        nrmse: its held-out error over the force.
        before: the set that it adds one effect to; ``None`` for the base.
        gain: log likelihood over that of ``before`` on held-out data, less the penalty of its numbers.
        reason: why it is out of the question, empty where it is not.
    """

    chosen: Chosen
    fit: ForceFit
    nrmse: float
    before: TriedForces | None = None
    gain: float = 0.0
    reason: str = ""

    @property
    def effects(self) -> frozenset[str]:
        """Ids of its effects."""
        return frozenset(self.fit.effects)

    @property
    def error(self) -> float:
        """Held-out error, root of the sum of squares, N."""
        return max(1e-12, math.sqrt(sum(float(row @ row) for row in self.fit.held)))

    @property
    def numbers(self) -> int:
        """How many were fitted."""
        return len(self.fit.coefficients) + sum(map(len, self.fit.shapes))

    @property
    def path(self) -> list[TriedForces]:
        """The sets from the base to this one."""
        return [*(self.before.path if self.before else []), self]


def searched(balance: ForceBalance, kind: str, most: int, tell: Progress) -> list[TriedForces]:
    """Return every set that was fitted, the base first: each effect alone, then with the best sets."""
    fit = balance.fit([])
    found = beam = [TriedForces((), fit, balance.nrmse(fit))]
    for _ in range(most):
        with_these = " or ".join("+".join(one.fit.effects) or "the base" for one in beam)
        tell(f"trying effects jointly with {with_these}", 0.3)
        added = [more for one in beam for more in _extended(balance, one, kind)]
        found = [*found, *added]
        evidence = _evidences(added, found[0])
        beam = []
        for one in sorted(evidence, key=lambda one: -evidence[one]):
            plain = _plain(one, added)
            if plain.effects not in {other.effects for other in beam}:
                beam.append(plain)
        beam = beam[:BEAM]
        if not beam:
            break
    return found


def _extended(balance: ForceBalance, one: TriedForces, kind: str) -> Iterator[TriedForces]:
    # One law of dry friction is enough: another next to it would only repair its shape at reversals.
    contained = one.effects | (FRICTIONS if one.effects & FRICTIONS else frozenset())
    independent = sum(independent_samples(row) for row in one.fit.held)
    for entry in EFFECTS.values():
        # The load cell's zero is in the base, and a constant push is not distinguished from it.
        zero_alone = entry.load_cell_zero and entry.searched
        if kind not in entry.kinds or not entry.terms or entry.id in contained or zero_alone:
            continue
        shape = balance.best_shape(entry, one.chosen)
        if shape is None:
            continue
        chosen = (*one.chosen, (entry, shape))
        fit = balance.fit(chosen)
        more = TriedForces(chosen, fit, balance.nrmse(fit), one)
        if entry.load_cell_zero:
            # The record shows only its sum with the zero: the zero of ``one`` is taken off the force.
            more = replace(more, nrmse=one.nrmse * more.error / one.error)
        gain = _evidence(more, one, independent)
        reason = ""
        if more.error > (1.0 - SMALLEST) * one.error or gain < DECISIVE:
            reason = INSIGNIFICANT
        elif more.nrmse > one.nrmse:
            reason = GROWS
        elif entry.load_cell_zero:
            reason = "the record cannot separate the difference of the directions from the load cell's zero"
        yield replace(more, gain=gain, reason=reason)


def _evidence(one: TriedForces, other: TriedForces, independent: float) -> float:
    """Return the log likelihood of ``one`` over ``other``, less the penalty of its further numbers."""
    gain = independent * math.log(other.error / one.error)
    return gain - 0.5 * (one.numbers - other.numbers) * math.log(max(3.0, independent))


def _evidences(tried: Sequence[TriedForces], base: TriedForces) -> dict[TriedForces, float]:
    """Return the evidence over ``base`` of each set that is not out of the question.

    All count by the independent samples that the best of them leaves.
    """
    possible = [one for one in tried if not one.reason]
    best = min(possible, key=lambda one: one.error, default=base)
    independent = sum(independent_samples(row) for row in best.fit.held)
    return {one: _evidence(one, base, independent) for one in possible}


def _richer(one: TriedForces, plain: TriedForces) -> bool:
    """Whether ``one`` is ``plain`` with a law that contains the one that it replaces."""
    more, less = one.effects - plain.effects, plain.effects - one.effects
    return len(more) == 1 and bool(less) and less <= set(EFFECTS[next(iter(more))].replaces)


def _plain(one: TriedForces, tried: Sequence[TriedForces]) -> TriedForces:
    """Return ``one``, or the set of ``tried`` with a plain law in its place that leaves hardly more."""
    plain = [other for other in tried if not other.reason and _richer(one, other)]
    near = [other for other in plain if other.error < PLAIN * one.error]
    return min(near, key=lambda other: other.error, default=one)


def decide(tried: Sequence[TriedForces]) -> TriedForces:
    """Return the simplest set that the evidence does not decide against, with a plain law where it does."""
    evidence = _evidences(tried, tried[0])
    near = [one for one in evidence if evidence[one] >= max(evidence.values()) - DECISIVE]
    return _plain(min(near, key=lambda one: (one.numbers, -evidence[one])), tried)


def probabilities(tried: Sequence[TriedForces], effects: frozenset[str]) -> dict[frozenset[str], float]:
    """Return how probable each set is that is not out of the question, that of ``effects`` first.

    A plain law counts as much as one that contains it where both leave the same, and half at ``PLAIN``: what
    it loses the richer one gets, up to as much as the plain one keeps.
    """
    evidence = _evidences(tried, tried[0])
    named: dict[str, float] = {}
    sets = {"+".join(sorted(one.effects)): one.effects for one in evidence}
    for one, value in evidence.items():
        name = "+".join(sorted(one.effects))
        named[name] = max(value, named.get(name, -math.inf))
    own = "+".join(sorted(effects))
    shares = probabilities_of(named, own)
    found = {sets.get(name, effects): (1.0 - OUTSIDE) * shares[name] for name in {*sets, own}}
    alike = [one for one in evidence if one.effects == effects]
    ratios = {
        other.effects: plain.error / other.error
        for other in evidence
        for plain in alike
        if _richer(other, plain)
    }
    richer = max(ratios, key=lambda name: ratios[name], default=effects)
    if richer != effects and ratios[richer] > 1.0:
        lost = 0.5 * found[effects] * min(1.0, (ratios[richer] - 1.0) / (PLAIN - 1.0))
        lost = min(lost, 0.5 * (found[effects] - found[richer]))
        found |= {effects: found[effects] - lost, richer: found[richer] + lost}
    return {effects: found[effects], **found}


def _alternatives(
    balance: ForceBalance, tried: Sequence[TriedForces], shares: dict[frozenset[str], float]
) -> tuple[Explanation, ...]:
    """Return the sets besides the first of ``shares`` that are probable, or more so than an unknown cause."""
    (sure, *_), found = shares.values(), []
    left = 1.0 - sure
    for effects, share in sorted(list(shares.items())[1:], key=lambda row: -row[1]):
        if share < PROBABLE and left <= sure:
            break
        best = min((one for one in tried if one.effects == effects), key=lambda one: one.error)
        numbers = [q for entry, shape in best.chosen for q in parameters_of(balance, best.fit, entry, shape)]
        told = "; ".join(entry.distinguished_by for entry, _ in best.chosen)
        found.append(Explanation(tuple(sorted(effects)), share, tuple(numbers), (), told))
        left -= share
    return tuple(found)


def _ranked(
    balance: ForceBalance, tried: Sequence[TriedForces], decided: TriedForces
) -> list[RankedHypothesis]:
    rows, path = [], decided.path
    for one in tried:
        if one.before is not None:
            entry, shape = one.chosen[-1]
            rows.append(RankedHypothesis(
                entry.id, one.before.fit.effects, one.nrmse, 2.0 * one.gain,
                balance.values(entry, shape, one.fit) or {},
                accepted=any(one is step for step in path), reason=one.reason,
            ))  # fmt: skip
    return rows


def _differing(balance: ForceBalance, chosen: Chosen) -> list[str]:
    """Return a line on the numbers that differ between the fitted records and those held out.

    Both are fitted alike, by the balance of forces; a number differs where its 95 % intervals do not overlap.
    The zero of the force is in the base of both, so a constant force takes no second part of it.
    """
    chosen = tuple(pair for pair in chosen if pair[0].id != CONSTANT)
    other = ForceBalance(balance.held, balance.train, balance.base, driven=balance.driven, mass=balance.mass)
    if other.sign != balance.sign:
        return []
    try:
        rows = [quantities_of(own, own.fit(chosen), chosen) for own in (balance, other)]
    except (ValueError, np.linalg.LinAlgError):
        return []
    texts = []
    for one, two in zip(*rows, strict=False):
        apart = abs(one.value - two.value)
        if one.name == two.name and apart > Z_95 * (one.standard_deviation + two.standard_deviation):
            shown = (with_interval(q.value, q.standard_deviation, q.unit) for q in (one, two))
            texts.append(f"{one.name.replace('_', ' ')} {' against '.join(shown)}")
    if not texts:
        return []
    return [
        "no parameters fit all records: fitted and held-out ones differ beyond their 95 % intervals, "
        + "; ".join(texts)
    ]


# Profile likelihood -----------------------------------------------------------------------------------------


def force_profiles(
    balance: ForceBalance, chosen: Chosen, fit: ForceFit, effects: tuple[NamedEffect, ...]
) -> tuple[ProfileLikelihood, ...]:
    """Return the profiles of the numbers of ``effects``, the ``chosen`` ones of ``fit``."""
    found = []
    for entry, shape in chosen:
        named = next((effect for effect in effects if effect.id == entry.id), None)
        for quantity in named.parameters if named else ():
            value, deviation = quantity.value, quantity.standard_deviation
            if quantity.name in shape:
                values, rises = _shaped(balance, chosen, fit, entry, quantity.name)
            else:
                # The law has to exist: friction below zero does not.
                steps = [
                    step
                    for step in DEVIATIONS
                    if (entry.load_cell_zero or value * (value + step * deviation) > 0.0 or not entry.terms)
                ]
                values, rises = tuple(value + step * deviation for step in steps), tuple(s**2 for s in steps)
            found.append(verdict_of(quantity.name, quantity.unit, values, rises, value))
    return tuple(found)


def _shaped(
    balance: ForceBalance, chosen: Chosen, fit: ForceFit, entry: Effect, name: str
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    independent = sum(independent_samples(row) for row in fit.train)
    own = next(shape for other, shape in chosen if other.id == entry.id)
    values, rises = [], []
    for factor in FACTORS:
        held = {**own, name: own[name] * factor}
        tried = balance.fit([(e, held if e.id == entry.id else shape) for e, shape in chosen])
        values.append(held[name])
        rises.append(independent * math.log(max(tried.squares, 1e-300) / max(fit.squares, 1e-300)))
    return tuple(values), tuple(rises)
