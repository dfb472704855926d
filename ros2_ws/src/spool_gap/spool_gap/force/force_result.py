"""Result of an analysis of force records, put together from its fits."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import signal
from scipy.special import expit
from spool_core.errors import InputError
from spool_core.uncertainty import PLUS_MINUS, Quantity, Validity, percent, with_interval
from spool_sim.model import Model
from spool_sim.terms import term

from spool_gap.effect import Effect
from spool_gap.registry import EFFECTS, FRICTIONS
from spool_gap.report.confidence import uncalibrated
from spool_gap.report.location import Residual, locate, surface
from spool_gap.report.outcome import EXPLAINS, LOOKS_LIKE
from spool_gap.result import Curves, GapResult, HeldOutAgreement, NamedEffect, RankedHypothesis, Remainder

from .force_balance import ForceBalance, ForceFit
from .force_record import ForceRecord
from .position_run import position_rmse

Array = NDArray[np.float64]
#: Error over that of a richer law up to which the simpler one, which it contains, is kept.
SIMPLER = 1.15
#: Error from which what is left has no name; below, derivatives of the displacement may be the reason.
LEFT = 0.03
#: Error up to which an effect that was added explains the force, and share of the gap's power from which what
#: is left besides is said: a tenth of its amplitude.
MUCH, LITTLE = 0.4, 0.01
#: Effect that is the zero of a driven record's force: it is in the base of every fit already.
CONSTANT = "constant_force"
#: Error of a free run of position over the travel, rms, up to which it follows the motion.
FOLLOWED = 0.01
Chosen = tuple[tuple[Effect, dict[str, float]], ...]


def result_of(
    records: Sequence[ForceRecord],
    base: Model,
    kind: str,
    balance: ForceBalance,
    steps: list[tuple[Chosen, ForceFit]],
    ranking: list[RankedHypothesis],
    warnings: list[str],
    alike: tuple[str, ...],
    begun: float,
) -> GapResult:
    """Return the outcome of ``steps``, base first; ``alike`` are forces that are not distinguished."""
    chosen, final = steps[-1]
    _, first = steps[0]
    before, after = balance.nrmse(first), balance.nrmse(final)
    zero = float(final.coefficients[balance.base.index("zero")]) * balance.sign
    size = math.sqrt(float(np.mean(np.concatenate([balance.seen(r) - zero for r in balance.held]) ** 2)))
    floor = math.sqrt(float(np.mean([balance.noise_power(record) for record in balance.held]))) / size
    named = tuple(entry.id for entry, _ in chosen)
    candidates: tuple[str, ...] = ()
    advice = ""
    if alike:
        warnings = [
            *warnings,
            "viscous and Coulomb friction cannot be distinguished here: the speed hardly varies; "
            "their sum at this speed is what the record tells",
        ]
        advice = "drive with speeds that differ by a factor of 10 or more"
    verdict = "+".join(named) or "none"
    confidence = _confidence(ranking, named)
    if alike and (FRICTIONS & set(named) or not named):
        verdict, confidence, candidates = "unexplained", 0.5, (*alike, *named)
    elif named and after > MUCH:
        verdict, confidence, candidates = "unexplained", 0.5, named
    elif not named and before > 3.0 * floor and before > LEFT:
        verdict, confidence = "unexplained", 0.6
    runs = [free_run_error(base, balance, *steps[0]), free_run_error(base, balance, chosen, final)]
    travel = float(np.std(np.concatenate([record.displacement for record in balance.held])))
    # A motion that is followed shows all forces, however well its second derivative is known.
    followed = runs[1] < FOLLOWED * travel
    # A step of friction is smeared at reversals; a force that is missing acts between them, too.
    smeared = bool(FRICTIONS & set(named)) and balance.sliding_error(final) <= LEFT
    left = None if followed or smeared else _remainder(before, after, floor)
    if named and not alike and left is not None and 1.0 - left.share >= EXPLAINS:
        verdict, confidence, candidates = "+".join((*named, "unexplained")), _confidence(ranking, named), ()
    left = left if "unexplained" in verdict else None
    effects = [] if verdict in ("none", "unexplained") else _named(balance, steps, chosen, final)
    runner = max(
        (h for h in ranking if not h.accepted and not h.jointly_with), key=lambda h: h.evidence, default=None
    )
    sure = uncalibrated(confidence, "force records")
    where = locate(_residual(balance, first, floor * size))
    return GapResult(
        record=", ".join(dict.fromkeys(record.name for record in records)),
        kind=kind, base_model=base.name, verdict=verdict, confidence=sure.value, confidence_note=sure.note,
        sentence=_sentence(verdict, effects, before, after, floor, alike), effects=tuple(effects),
        runner_up=runner, candidates=candidates,
        ranking=tuple(sorted(ranking, key=lambda h: (len(h.jointly_with), -h.evidence))),
        base=_quantities(balance, first, ()), parameters=_quantities(balance, final, chosen),
        where=where, where_after=locate(_residual(balance, final, floor * size)),
        surface=surface(_residual(balance, first, floor * size)),
        surface_after=surface(_residual(balance, final, floor * size)),
        curves=_curves(balance, first, final, floor * size),
        before=HeldOutAgreement(before, math.nan, runs[0]), after=HeldOutAgreement(after, math.nan, runs[1]),
        noise_floor=floor, remainder=left,
        model=_model(base, balance, chosen, final), warnings=tuple(warnings),
        seconds=sum(record.duration for record in (*balance.train, *balance.held)),
        elapsed=time.monotonic() - begun, advice=advice,
        correlation=final.correlation, correlated=_correlated(balance, final, chosen),
    )  # fmt: skip


def _remainder(before: float, after: float, floor: float) -> Remainder | None:
    """Return what is left where it is more than noise and than what derivatives err by, else ``None``."""
    if after < MUCH and (after <= 3.0 * floor or after <= LEFT):
        return None
    if after < MUCH and after**2 < LITTLE * before**2:
        return None
    gap = max(before**2 - floor**2, 1e-30)
    share = max(0.0, after**2 - floor**2) / gap
    return Remainder(share, (after / max(floor, 1e-12)) ** 2, "nothing", LOOKS_LIKE["nothing"])


def free_run_error(base: Model, balance: ForceBalance, chosen: Chosen, fit: ForceFit) -> float:
    """Return the error of the free run of position over the held-out records, m; NaN for imposed motion."""
    if not balance.driven:
        return math.nan
    try:
        model, zero = model_with(base, balance, chosen, fit)
    except InputError:
        return math.nan
    return position_rmse(balance.held, model, zero, balance.centre, balance.sign)


def model_with(base: Model, balance: ForceBalance, chosen: Chosen, fit: ForceFit) -> tuple[Model, float]:
    """Return ``base`` with ``chosen`` effects by the numbers of ``fit``, and the force's zero apart, N.

    Raises:
        InputError: no mass can be moved by these numbers.
    """
    numbers = fit.coefficients
    mass = balance.mass or (float(numbers[balance.base.index("mass")]) if "mass" in balance.base else 0.0)
    if not np.isfinite(numbers).all() or mass <= 0.0:
        raise InputError("mass: a free run needs one > 0 kg")
    for entry, shape in chosen:
        if entry.id != CONSTANT and balance.values(entry, shape, fit) is None:
            raise InputError(f"{entry.id}: its numbers make no sense on a machine")
    model = _model(base, balance, tuple(pair for pair in chosen if pair[0].id != CONSTANT), fit)
    if "inertia" not in {entry.name for entry in model.terms}:
        raise InputError(f"{base.name}: a free run needs the term inertia")
    return model, float(numbers[balance.base.index("zero")]) if "zero" in balance.base else 0.0


def _confidence(ranking: Sequence[RankedHypothesis], named: tuple[str, ...]) -> float:
    sure = 0.95
    for name in named:
        own = next((h for h in ranking if h.id == name and h.accepted), None)
        if own is None:
            continue
        rivals = [h for h in ranking if h.jointly_with == own.jointly_with and h.id != name and not h.reason]
        # A richer law that was passed over always has more evidence: how near it came to being taken counts.
        richer = [h for h in rivals if name in EFFECTS[h.id].replaces]
        nearest = max([1.0, *(own.nrmse_after / h.nrmse_after for h in richer)])
        sure *= 1.0 - 0.5 * min(1.0, (nearest - 1.0) / (SIMPLER - 1.0))
        others = [h.evidence for h in rivals if h not in richer]
        sure *= float(expit(0.1 * (own.evidence - max([0.0, *others]))))
    return sure


BASE_NAMES = {
    "damping": ("viscous_coefficient", "N s/m"), "stiffness": ("spring_stiffness", "N/m"),
    "mass": ("mass", "kg"),
    "zero": ("force_zero", "N"),
}  # fmt: skip


def _quantities(balance: ForceBalance, fit: ForceFit, chosen: Chosen) -> tuple[Quantity, ...]:
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
        found += _parameters(balance, fit, entry, shape)
    return tuple(found)


def _parameters(
    balance: ForceBalance, fit: ForceFit, entry: Effect, shape: dict[str, float]
) -> list[Quantity]:
    if entry.id == CONSTANT and "zero" in balance.base:
        place = balance.base.index("zero")
        push, spread = -balance.sign * float(fit.coefficients[place]), float(fit.deviations[place])
        return [Quantity("push", "N", push, spread, Validity.VALID)]
    values = balance.values(entry, shape, fit) or {}
    own = [n for n, name in enumerate(fit.names) if name.startswith(f"{entry.id}.")]
    relative = float(np.min(fit.deviations[own] / np.maximum(np.abs(fit.coefficients[own]), 1e-30)))
    units = {p.name: p.unit for name in entry.terms for p in term(name).parameters}
    return [
        Quantity(name, units[name], values[name], abs(values[name]) * relative, Validity.VALID)
        for name in entry.fitted
        if name in values
    ]


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
                entry.id, tuple(_parameters(balance, final, entry, shape)), last, after, math.nan,
                entry.on_the_machine, entry.to_check,
            )
        )  # fmt: skip
        last = after
    return found


def _residual(balance: ForceBalance, fit: ForceFit, floor: float) -> Residual:
    motions = [balance.motions[id(record)] for record in balance.held]
    return Residual(
        np.concatenate([motion.time for motion in motions]),
        np.concatenate([motion.displacement for motion in motions]),
        np.concatenate([motion.velocity for motion in motions]),
        np.concatenate(fit.held), floor, balance.held[0].period,
    )  # fmt: skip


def _curves(balance: ForceBalance, first: ForceFit, final: ForceFit, floor: float) -> Curves:
    loudest = int(np.argmax([float(np.sum(row**2)) for row in first.held]))
    record = balance.held[loudest]
    measured = balance.sign * record.force
    piece = min(record.force.size, round(8.0 / record.period))
    rows = (measured - measured.mean(), first.held[loudest], final.held[loudest])
    spectra = [signal.welch(row, 1.0 / record.period, "hann", piece, detrend=False) for row in rows]
    part = slice(0, min(record.force.size, round(5.0 / record.period)))
    frequency = np.asarray(spectra[0][0])
    densities = [np.asarray(density) for _, density in spectra]
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


def _model(base: Model, balance: ForceBalance, chosen: Chosen, fit: ForceFit) -> Model:
    values = {
        BASE_NAMES[name][0]: float(fit.coefficients[n])
        for n, name in enumerate(balance.base)
        if name != "zero"
    }
    gone = {"spring"} if "stiffness" not in balance.base else set()
    gone |= {"viscous_friction"} if "damping" not in balance.base else set()
    terms = [entry for entry in base.terms if entry.name not in gone]
    terms += [term(name) for entry, _ in chosen for name in entry.terms]
    for entry, shape in chosen:
        own = [] if entry.id != CONSTANT else _parameters(balance, fit, entry, shape)
        values |= {q.name: q.value for q in own} or balance.values(entry, shape, fit) or {}
    known = {p.name: p for entry_ in terms for p in entry_.parameters}
    if balance.mass is not None:
        values["mass"] = balance.mass
    kept = {
        name: float(np.clip(value, known[name].low, known[name].high))
        for name, value in values.items()
        if name in known
    }
    return Model("_".join([base.name, *(e.id for e, _ in chosen)]), tuple(terms), kept)


def _sentence(
    verdict: str,
    effects: Sequence[NamedEffect],
    before: float,
    after: float,
    floor: float,
    alike: tuple[str, ...],
) -> str:
    numbers = f"{percent(before, 3)} to {percent(after, 3)} of the force (noise alone: {percent(floor)})"
    if alike:
        return (
            "Viscous and Coulomb friction cannot be distinguished in this record: the speed hardly varies. "
            f"With all of the catalogue the error goes from {numbers}."
        )
    if verdict == "none":
        return f"Nothing of the catalogue is missing; the error is {percent(after, 3)} of the force."
    if verdict == "unexplained":
        return f"Something is missing that has no name here; the error is {percent(after, 3)} of the force."
    parts = []
    for effect in effects:
        values = ", ".join(
            f"{q.name} {with_interval(q.value, q.standard_deviation, q.unit)}" for q in effect.parameters
        )
        told = f"{values}; {PLUS_MINUS}"
        parts.append(f"{effect.id.replace('_', ' ')} ({told}): {effect.meaning}; check {effect.check}")
    return f"The model lacks {'; and '.join(parts)}. With it the error falls from {numbers}."
