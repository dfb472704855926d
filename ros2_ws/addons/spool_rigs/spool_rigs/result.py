"""Result of an analysis of force records: verdict, numbers, what is determined, gap location, remainder."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

import numpy as np
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_core.uncertainty import Z_95, Quantity, Validity, with_interval
from spool_estimator.identification.determination import Determination, by_information, hidden_by_name
from spool_estimator.identification.least_squares import Unknown, sizes_of, unseen_directions
from spool_estimator.identification.spectra import density_of
from spool_gap import report
from spool_gap.catalogue import EFFECTS, FRICTIONS
from spool_gap.result import (
    UNEXPLAINED,
    Curves,
    GapResult,
    HeldOutAgreement,
    NamedEffect,
    RankedHypothesis,
    Remainder,
)
from spool_sim.model import Model

from spool_rigs.balance import BASE_NAMES, ForceBalance, ForceFit, independent_samples
from spool_rigs.position import CONSTANT, Chosen, free_run_error, model_of, parameters_of
from spool_rigs.records import ForceRecord, white_power

#: Error from which the remainder has no name; below, derivatives of the displacement may be the reason.
LEFT = 0.03
#: Error up to which an effect that was added explains the force, and share of the gap's power from which a
#: remainder besides is reported: a tenth of its amplitude.
MUCH, LITTLE = 0.4, 0.01
#: Error of a free run of position over the travel, rms, up to which it follows the motion.
FOLLOWED = 0.01
#: Share of the gap, rms, that each name must close to stay where something else is left.
CLOSES = 1.0 / 3.0
#: Confidence at most, and why: no verdicts on force records of known truth were counted, and of those on
#: records of accelerometers three in four were right at first.
MOST_SURE, NOT_CALIBRATED = 0.75, "not calibrated for force records"
COMPARED = "the force"


def result_of(
    records: Sequence[ForceRecord],
    base: Model,
    kind: str,
    balance: ForceBalance,
    steps: list[tuple[Chosen, ForceFit]],
    ranking: list[RankedHypothesis],
    warnings: list[str],
    alike: tuple[str, ...],
    weak: tuple[str, ...],
    sure: float,
    begun: float,
) -> GapResult:
    """Return the outcome of ``steps``, base first.

    ``alike``: what is not distinguished; ``weak``: what closes too little; ``sure``: the probability.
    """
    chosen, final = steps[-1]
    first = steps[0][1]
    size, floor = _size_and_floor(balance, final)
    before, after = balance.nrmse(steps[0][1]), balance.nrmse(final)
    names = tuple(entry.id for entry, _ in chosen)
    candidates: tuple[str, ...] = weak
    advice = ""
    if alike:
        warnings = [
            *warnings,
            "viscous and Coulomb friction cannot be distinguished here: the speed hardly varies; "
            "the record determines only their sum at this speed",
        ]
        advice = "drive with speeds that differ by a factor of 10 or more"
    verdict = "+".join(names) or "none"
    confidence = sure
    if alike and (FRICTIONS & set(names) or not names):
        verdict, confidence, candidates = UNEXPLAINED, 0.5, (*alike, *names)
    elif names and after > MUCH:
        verdict, confidence, candidates = UNEXPLAINED, 0.5, names
    elif not names and before > 3.0 * floor and before > LEFT:
        verdict, confidence = UNEXPLAINED, 0.6
    elif not names:
        # What may be there all the same is less than derivatives err by.
        confidence = max(sure, 0.5)
    left = _left(base, balance, steps, floor)
    if names and not alike and left is not None:
        verdict, confidence, candidates = "+".join((*names, UNEXPLAINED)), sure, ()
    if UNEXPLAINED not in verdict:
        left = None
    effects = [] if verdict in ("none", UNEXPLAINED) else _named(balance, steps, chosen, final)
    runner = max(
        (h for h in ranking if not h.accepted and not h.jointly_with), key=lambda h: h.evidence, default=None
    )
    if not any(row.accepted for row in ranking):
        ranking = [RankedHypothesis("none", (), after, 0.0, {}, accepted=True), *ranking]
    text = _sentence(base, verdict, effects, (*alike, *candidates), left, (before, after, floor))
    if alike:
        text = (
            "Viscous and Coulomb friction cannot be distinguished in this record: the speed hardly varies. "
            f"{text}"
        )
    runs = [free_run_error(base, balance, *steps[0]), free_run_error(base, balance, chosen, final)]
    parameters = quantities_of(balance, final, chosen)
    warnings = [*warnings, *_below_zero(parameters)]
    where = report.locate(_residual(balance, first, floor * size))
    return GapResult(
        record=", ".join(dict.fromkeys(record.name for record in records)),
        kind=kind, base_model=base.name, verdict=verdict, confidence=min(confidence, MOST_SURE),
        confidence_note=NOT_CALIBRATED, sentence=text, effects=tuple(effects),
        runner_up=runner, candidates=candidates,
        ranking=tuple(sorted(ranking, key=lambda h: (h.id != "none", len(h.jointly_with), -h.evidence))),
        base=quantities_of(balance, first, ()), parameters=parameters,
        where=where, where_after=report.locate(_residual(balance, final, floor * size)),
        surface=report.surface(_residual(balance, first, floor * size)),
        surface_after=report.surface(_residual(balance, final, floor * size)),
        curves=_curves(balance, first, final, floor * size),
        before=HeldOutAgreement(before, math.nan, runs[0]), after=HeldOutAgreement(after, math.nan, runs[1]),
        noise_floor=floor, remainder=left,
        model=model_of(base, balance, chosen, final), warnings=tuple(warnings),
        seconds=sum(record.duration for record in (*balance.train, *balance.held)),
        elapsed=time.monotonic() - begun, advice=advice,
        correlation=final.correlation, correlated=_correlated(balance, final, chosen),
    )  # fmt: skip


def _left(
    base: Model, balance: ForceBalance, steps: list[tuple[Chosen, ForceFit]], floor: float
) -> Remainder | None:
    """Return the remainder after the last of ``steps``; ``None`` where the motion shows none."""
    chosen, final = steps[-1]
    travel = float(np.std(np.concatenate([record.displacement for record in balance.held])))
    # A motion that is followed shows all forces, however well its second derivative is known.
    followed = free_run_error(base, balance, chosen, final) < FOLLOWED * travel
    # A step of friction is smeared at reversals; a force that is missing acts between them, too.
    smeared = any(entry.is_friction for entry, _ in chosen) and balance.sliding_error(final) <= LEFT
    if followed or smeared:
        return None
    return _remainder(balance.nrmse(steps[0][1]), balance.nrmse(final), floor)


def closing(
    base: Model, balance: ForceBalance, steps: list[tuple[Chosen, ForceFit]]
) -> tuple[list[tuple[Chosen, ForceFit]], tuple[str, ...]]:
    """Return ``steps`` without effects that close less than ``CLOSES`` while something is left, and those.

    The zero of a driven force has been judged against a fit without it.
    """
    gone: tuple[str, ...] = ()
    floor = _size_and_floor(balance, steps[-1][1])[1]
    while len(steps) > 1 and _left(base, balance, steps, floor) is not None:
        errors = np.array([balance.nrmse(fit) for _, fit in steps])
        closed = -np.diff(errors) / max(errors[0] - floor, 1e-30)
        weak = [
            n for n, share in enumerate(closed, 1) if share < CLOSES and steps[n][0][-1][0].id != CONSTANT
        ]
        if not weak:
            break
        place = weak[-1]
        gone = (*gone, steps[place][0][-1][0].id)
        kept = [tuple(one for one in chosen if one[0].id not in gone) for chosen, _ in steps[place + 1 :]]
        fits = [balance.fit([one for one in chosen if one[0].id != CONSTANT]) for chosen in kept]
        steps = [*steps[:place], *zip(kept, fits, strict=True)]
    return steps, gone


def _size_and_floor(balance: ForceBalance, fit: ForceFit) -> tuple[float, float]:
    """Return the rms of the held-out force less its zero, N, and that of its noise over it."""
    zero = float(fit.coefficients[balance.base.index("zero")]) * balance.sign
    size = math.sqrt(float(np.mean(np.concatenate([balance.seen(r) - zero for r in balance.held]) ** 2)))
    noise = math.sqrt(float(np.mean([balance.noise_power(record) for record in balance.held])))
    return size, noise / size


def _below_zero(parameters: Sequence[Quantity]) -> list[str]:
    """Return a remark about a spring or a drag below zero."""
    found = []
    for one in parameters:
        if one.name in ("spring_stiffness", "viscous_coefficient") and one.value < 0.0:
            shown = with_interval(one.value, one.standard_deviation, one.unit)
            may_be = abs(one.value) < Z_95 * one.standard_deviation
            why = "zero fits as well" if may_be else "an effect is missing, or the force has the other sign"
            found.append(f"{one.name.replace('_', ' ')} {shown}: below zero, as on no machine; {why}")
    return found


def _remainder(before: float, after: float, floor: float) -> Remainder | None:
    """Return the remainder where it exceeds noise and the error of derivatives, else ``None``."""
    if after < MUCH and (after <= 3.0 * floor or after <= LEFT):
        return None
    if after < MUCH and after**2 < LITTLE * before**2:
        return None
    gap = max(before**2 - floor**2, 1e-30)
    share = max(0.0, after**2 - floor**2) / gap
    return Remainder(share, (after / max(floor, 1e-12)) ** 2, "nothing", report.looks_like("nothing"))


def quantities_of(balance: ForceBalance, fit: ForceFit, chosen: Chosen) -> tuple[Quantity, ...]:
    """Return the numbers of ``fit``: those of the base, then those of the ``chosen`` effects."""
    found = []
    for place, name in enumerate(balance.base):
        own, unit = BASE_NAMES[name]
        sign = balance.sign if name == "zero" else 1.0
        found.append(
            Quantity(
                own, unit, sign * float(fit.coefficients[place]), float(fit.deviations[place]), Validity.VALID
            )
        )
    for entry, shape in chosen:
        found += parameters_of(balance, fit, entry, shape)
    return tuple(found)


def _correlated(balance: ForceBalance, fit: ForceFit, chosen: Chosen) -> tuple[str, ...]:
    """Return the names of the numbers that the rows of the fit's correlation are; columns have their own."""
    own = {BASE_NAMES[name][0]: name for name in balance.base}
    own |= {
        entry.fitted[0]: f"{entry.id}.0" for entry, shape in chosen if len(entry.fitted) == 1 and not shape
    }
    numbers = {column: name for name, column in own.items()}
    return tuple(numbers.get(column, column) for column in fit.names)


def _named(
    balance: ForceBalance, steps: list[tuple[Chosen, ForceFit]], chosen: Chosen, final: ForceFit
) -> list[NamedEffect]:
    found = []
    last = balance.nrmse(steps[0][1])
    for entry, shape in chosen:
        fit = next((fit for some, fit in steps if any(e.id == entry.id for e, _ in some)), final)
        after = balance.nrmse(fit)
        found.append(
            NamedEffect(
                entry.id, tuple(parameters_of(balance, final, entry, shape)), last, after, math.nan,
                entry.on_the_machine, entry.to_check,
            )
        )  # fmt: skip
        last = after
    return found


def _residual(balance: ForceBalance, fit: ForceFit, floor: float) -> report.Residual:
    motions = [balance.motions[id(record)] for record in balance.held]
    return report.Residual(
        np.concatenate([motion.time for motion in motions]),
        np.concatenate([motion.displacement for motion in motions]),
        np.concatenate([motion.velocity for motion in motions]),
        np.concatenate(fit.held), floor, balance.held[0].period,
    )  # fmt: skip


def _curves(balance: ForceBalance, first: ForceFit, final: ForceFit, floor: float) -> Curves:
    loudest = int(np.argmax([float(np.sum(row**2)) for row in first.held]))
    record = balance.held[loudest]
    measured = balance.sign * record.force
    rows = (measured - measured.mean(), first.held[loudest], final.held[loudest])
    spectra = [density_of([row], record.period, 8.0) for row in rows]
    part = slice(0, min(record.force.size, round(5.0 / record.period)))
    frequency = spectra[0][0]
    densities = [density for _, density in spectra]
    return Curves(
        time=record.time[part],
        measured=measured[part],
        before=(measured - first.held[loudest])[part],
        after=(measured - final.held[loudest])[part],
        frequency=frequency,
        measured_density=densities[0],
        before_density=densities[1],
        after_density=densities[2],
        floor_density=np.full(frequency.size, 2.0 * floor**2 * record.period),
        unit="N",
    )


def _sentence(
    base: Model,
    verdict: str,
    effects: Sequence[NamedEffect],
    candidates: tuple[str, ...],
    left: Remainder | None,
    errors: tuple[float, float, float],
) -> str:
    if verdict == "none":
        return report.nothing_missing(base.name, *errors[1:], COMPARED)
    if verdict == UNEXPLAINED:
        return report.unnamed(base.name, tuple(dict.fromkeys(candidates)), "nothing", *errors, COMPARED)
    text = report.named([(effect.id, effect.parameters) for effect in effects], *errors, COMPARED)
    return text if left is None else f"{text} {report.still_missing(left)}"


#: Standard deviations of the power of noise in the columns up to which it may be all that they show.
BY_CHANCE = 4.0


def determined(balance: ForceBalance, base: Model, fit: ForceFit) -> tuple[Determination, ...]:
    """Return what the training records of ``balance`` determine of the parameters of ``base`` in ``fit``.

    The balance keeps no sign: limits of parameters hold as sizes on both sides. Derivatives of a measured
    displacement hold its noise, which is no information: what it adds to the columns of a driven mass is
    taken off. The load cell's zero and the effects of ``fit`` are free.
    """
    names = [name for name in balance.base if name != "zero"]
    unknowns: list[Unknown] = []
    if not names:
        return ()
    for name in names:
        limit = base.parameter(BASE_NAMES[name][0])
        unknowns.append(Unknown(limit.name, limit.unit, -limit.high, limit.high, limit.start))
    found = dict(zip(balance.base, fit.coefficients.tolist(), strict=False))
    point = np.array([found[name] for name in names])
    independent = max(8.0, sum(independent_samples(row) for row in fit.train))
    variance = max(fit.squares, np.finfo(float).tiny) / independent
    slopes = _seen(balance, names, fit) / math.sqrt(variance)
    hidden = hidden_by_name(
        unseen_directions(slopes, sizes_of(unknowns, point)), [one.name for one in unknowns]
    )
    return tuple(by_information(unknowns, point, slopes, hidden))


def check_one_mass(balance: ForceBalance, base: Model, name: str) -> bool:
    """Return whether the records of ``balance`` can be compared with a mass that is given.

    Raises:
        InputError: no mass is given, and the records know it only together with others.
    """
    free = balance
    if balance.mass is not None:
        free = ForceBalance(balance.train, balance.held, [*balance.base, "mass"], driven=True)
    mass = next(one for one in determined(free, base, free.fit([])) if one.name == "mass")
    if balance.mass is None and mass.together_with:
        raise InputError(
            f"{name}: {mass.sentence}; state the mass with --mass or --valve, or drive at frequencies "
            "that differ"
        )
    return not mass.together_with


def _seen(balance: ForceBalance, names: list[str], fit: ForceFit) -> Array:
    """Return a square root of the information of the columns ``names``, without noise, shape (u, u)."""
    chosen = [(EFFECTS[name], shape) for name, shape in zip(fit.effects, fit.shapes, strict=True)]
    noise = np.zeros((len(names), len(names)))
    matrix = np.concatenate([balance.columns(record, chosen) for record in balance.train])
    own = [balance.base.index(name) for name in names]
    rows, free = matrix[:, own], np.delete(matrix, own, axis=1)
    free = free / np.maximum(np.linalg.norm(free, axis=0), 1e-30)
    rows = rows - free @ np.linalg.lstsq(free, rows, rcond=None)[0]
    information = rows.T @ rows
    for record in balance.train if balance.driven else ():
        noise += _noise(balance, record, names)
    scale = np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
    strength, directions = np.linalg.eigh((information - noise) / np.outer(scale, scale))
    return np.asarray(np.sqrt(np.maximum(strength, 0.0))[:, np.newaxis] * directions.T * scale)


def _noise(balance: ForceBalance, record: ForceRecord, names: list[str]) -> Array:
    """Return the most that the displacement's noise adds to the information of a record, shape (u, u)."""
    orders = {"stiffness": 0, "damping": 1, "mass": 2}
    answers = np.array([record.answer(orders[name]) for name in names])
    count = float(balance.known[id(record)].sum())
    independent = max(1.0, count / record.smoothing())
    most = 1.0 + BY_CHANCE * math.sqrt(2.0 / independent)
    return np.asarray(most * count * white_power(record.displacement) * (answers @ answers.T))
