"""The workflow for force records: base, where the gap sits, which force is missing, what is left."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import signal
from spool_sim.model import Model
from spool_sim.terms import term
from spool_stream.errors import InputError
from spool_stream.quantity import Quantity, Validity

from .effect import Effect
from .force_balance import ForceBalance, ForceFit, independent_samples
from .force_record import ForceRecord
from .registry import EFFECTS
from .result import Agreement, Curves, GapResult, GapSettings, Hypothesis, NamedEffect
from .where import Residual, locate, surface

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]
Chosen = tuple[tuple[Effect, dict[str, float]], ...]

#: s of the stretches that are fitted and held out by turns.
STRETCH = 4.0
#: Share of the held-out error, rms, that an effect must take away.
SMALLEST = 0.03
#: Twice the log likelihood ratio, after the price of the parameters, from which an effect counts.
EVIDENCE = 20.0
#: Error over that of a richer effect up to which the simpler one, which it contains, is kept.
SIMPLER = 1.15
#: Correlation of two columns, base taken off, from which they cannot be told apart.
ALIKE = 0.97
#: Ratio of the 95 to the 5 % quantile of the speed below which the speed hardly varies.
VARIED = 6.0
#: Laws of dry friction, which exclude one another.
FRICTIONS = frozenset(
    ("coulomb_friction", "stribeck_friction", "mixed_friction", "asymmetric_friction", "presliding_friction")
)


def analyse_forces(
    records: Sequence[ForceRecord],
    base: Model,
    kind: str,
    *,
    holdout: Sequence[ForceRecord] = (),
    settings: GapSettings | None = None,
    progress: Progress | None = None,
) -> GapResult:
    """Return which force is missing in ``records``.

    Args:
        records: displacement and force.
        base: with ``spring`` and ``viscous_friction``, and ``inertia`` where the force drives a mass.
        kind: ``driven`` or ``imposed``.
        holdout: records to judge on; without them every other stretch is held out.
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
    warnings = _judge(train)
    names = {entry.name for entry in base.terms}
    columns = ["damping"] if "viscous_friction" in names else []
    columns += ["stiffness"] if "spring" in names else []
    columns += ["mass"] if kind == "driven" else []
    balance = ForceBalance(train, held, [*columns, "zero"])
    alike = _cannot_tell(balance)
    steps: list[tuple[Chosen, ForceFit]] = [((), balance.fit([]))]
    ranking: list[Hypothesis] = []
    while len(steps) <= chosen_settings.most_effects:
        tell(f"trying effects beside {' + '.join(steps[-1][1].effects) or 'the base'}", 0.3)
        better = _forward(balance, steps[-1], ranking, kind)
        if better is None:
            break
        steps.append(better)
    tell("measuring what is left", 0.9)
    return _result(records, base, kind, balance, steps, ranking, warnings, alike, begun)


def _split(
    records: Sequence[ForceRecord], holdout: Sequence[ForceRecord]
) -> tuple[list[ForceRecord], list[ForceRecord]]:
    if not records:
        raise InputError("records: none given")
    if holdout:
        return list(records), list(holdout)
    train: list[ForceRecord] = []
    held: list[ForceRecord] = []
    for record in records:
        count = round(record.duration / STRETCH)
        count = max(count, 2)
        edges = (record.force.size * np.arange(count + 1)) // count
        for number, (low, high) in enumerate(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)):
            part = ForceRecord(
                record.name, record.start + low * record.period, record.period,
                record.displacement[low:high], record.force[low:high],
            )  # fmt: skip
            if part.force.size >= 30:
                (train if number % 2 == 0 else held).append(part)
    if not train or not held:
        longest = max(record.duration for record in records)
        raise InputError(
            f"{records[0].name}: too short: its longest stretch has {longest:.2f} s; "
            "record longer, or name another record with --holdout"
        )
    return train, held


def _judge(records: Sequence[ForceRecord]) -> list[str]:
    """Return warnings.

    Raises:
        InputError: nothing moves, or the force does not change.
    """
    first = records[0]
    displacement = np.concatenate([record.displacement for record in records])
    force = np.concatenate([record.force for record in records])
    if not float(np.ptp(displacement)) > 0.0:
        raise InputError(f"{first.name}: displacement_m does not change: check sensor and cable")
    if not float(np.ptp(force)) > 0.0:
        raise InputError(f"{first.name}: force_N does not change: check sensor and cable")
    warnings = []
    if float(np.ptp(displacement)) > 0.5:
        warnings.append(f"the displacement spans {np.ptp(displacement):.3g} m: is it in mm instead of m?")
    return warnings


def _cannot_tell(balance: ForceBalance) -> tuple[str, ...]:
    """Return names of forces that these records cannot tell apart."""
    speed = np.abs(np.concatenate([balance.motions[id(record)].velocity for record in balance.train]))
    moving = speed[speed > 0.05 * float(np.quantile(speed, 0.95))]
    spread = float(np.quantile(moving, 0.95) / max(float(np.quantile(moving, 0.05)), 1e-12))
    rows = []
    for record in balance.train:
        motion = balance.motions[id(record)]
        rows.append(np.array([motion.velocity, motion.sign, np.ones(motion.time.size)]))
    velocity, sign, one = np.concatenate(rows, axis=1)
    velocity, sign = velocity - velocity.mean() * one, sign - sign.mean() * one
    alike = abs(float(velocity @ sign)) / max(float(np.linalg.norm(velocity) * np.linalg.norm(sign)), 1e-30)
    return ("viscous_friction", "coulomb_friction") if alike > ALIKE or spread < VARIED else ()


def _forward(
    balance: ForceBalance, step: tuple[Chosen, ForceFit], ranking: list[Hypothesis], kind: str
) -> tuple[Chosen, ForceFit] | None:
    chosen, fit = step
    before = balance.nrmse(fit)
    # One law of dry friction is enough: another beside it would only mend its shape at reversals.
    contained = {name for entry, _ in chosen for name in (entry.id, *entry.replaces)}
    if contained & FRICTIONS:
        contained |= FRICTIONS
    found: list[tuple[float, float, Chosen, ForceFit, Effect]] = []
    independent = sum(independent_samples(row) for row in fit.held)
    for entry in EFFECTS.values():
        # The load cell's zero is in the base, and a constant push is not told from it.
        if (
            kind not in entry.kinds
            or not entry.terms
            or entry.id in contained
            or entry.id == "constant_force"
        ):
            continue
        kept = tuple(pair for pair in chosen if pair[0].id not in entry.replaces)
        shape = balance.best_shape(entry, kept)
        if shape is None:
            continue
        tried = (*kept, (entry, shape))
        result = balance.fit(tried)
        after = balance.nrmse(result)
        evidence = independent * math.log(max(before, 1e-12) ** 2 / max(after, 1e-12) ** 2)
        evidence -= math.log(max(3.0, independent)) * (
            len(result.coefficients) - len(fit.coefficients) + len(shape)
        )
        values = balance.values(entry, shape, result) or {}
        reason = ""
        if after > (1.0 - SMALLEST) * before or evidence < EVIDENCE:
            reason = "it does not close the gap significantly"
        elif entry.id == "asymmetric_friction":
            reason = "the difference of the directions is not told from the load cell's zero"
        ranking.append(
            Hypothesis(entry.id, tuple(e.id for e, _ in chosen), after, evidence, values, False, reason)
        )
        if not reason:
            found.append((evidence, after, tried, result, entry))
    if not found:
        return None
    found.sort(key=lambda row: -row[0])
    best = found[0]
    for row in found[1:]:
        # The simpler one stays where the richer one is hardly better.
        if row[4].id in best[4].replaces and row[1] < SIMPLER * best[1]:
            best = row
    for number, entry_ in enumerate(ranking):
        if entry_.id == best[4].id and entry_.beside == tuple(e.id for e, _ in chosen):
            ranking[number] = Hypothesis(
                entry_.id, entry_.beside, entry_.nrmse_after, entry_.evidence, entry_.parameters, True
            )
    return best[2], best[3]


def _result(
    records: Sequence[ForceRecord],
    base: Model,
    kind: str,
    balance: ForceBalance,
    steps: list[tuple[Chosen, ForceFit]],
    ranking: list[Hypothesis],
    warnings: list[str],
    alike: tuple[str, ...],
    begun: float,
) -> GapResult:
    chosen, final = steps[-1]
    _, first = steps[0]
    before, after = balance.nrmse(first), balance.nrmse(final)
    zero = float(final.coefficients[balance.base.index("zero")]) * balance.sign
    size = math.sqrt(float(np.mean(np.concatenate([r.force - zero for r in balance.held]) ** 2)))
    floor = math.sqrt(float(np.mean([noise_power(record.force) for record in balance.held]))) / size
    named = tuple(entry.id for entry, _ in chosen)
    candidates: tuple[str, ...] = ()
    advice = ""
    if alike:
        warnings = [
            *warnings,
            "viscous and Coulomb friction cannot be told apart here: the speed hardly varies; "
            "their sum at this speed is what the record tells",
        ]
        advice = "drive with speeds that differ by a factor of 10 or more"
    verdict = "+".join(named) or "none"
    confidence = _confidence(ranking, named)
    if alike and (FRICTIONS & set(named) or not named):
        verdict, confidence, candidates = "unexplained", 0.5, (*alike, *named)
    elif not named and before > 3.0 * floor and before > 0.1:
        verdict, confidence = "unexplained", 0.6
    effects = [] if verdict in ("none", "unexplained") else _named(balance, steps, chosen, final)
    runner = max(
        (h for h in ranking if not h.accepted and not h.beside), key=lambda h: h.evidence, default=None
    )
    where = locate(_residual(balance, first, floor * size))
    return GapResult(
        record=", ".join(dict.fromkeys(record.name for record in records)),
        kind=kind, base_model=base.name, verdict=verdict, confidence=confidence,
        sentence=_sentence(verdict, effects, before, after, floor, alike), effects=tuple(effects),
        runner_up=runner, candidates=candidates,
        ranking=tuple(sorted(ranking, key=lambda h: (len(h.beside), -h.evidence))),
        base=_quantities(balance, first, ()), parameters=_quantities(balance, final, chosen),
        where=where, where_after=locate(_residual(balance, final, floor * size)),
        surface=surface(_residual(balance, first, floor * size)),
        surface_after=surface(_residual(balance, final, floor * size)),
        curves=_curves(balance, first, final, floor * size),
        before=Agreement(before, math.nan), after=Agreement(after, math.nan), noise_floor=floor,
        model=_model(base, balance, chosen, final), warnings=tuple(warnings),
        seconds=sum(record.duration for record in (*balance.train, *balance.held)),
        elapsed=time.monotonic() - begun, advice=advice,
    )  # fmt: skip


def noise_power(row: Array) -> float:
    """Return the power of the white noise in ``row``, from its third differences' quieter half."""
    differences = np.diff(row, 3) ** 2 / 20.0
    return float(np.median(differences) / 0.455)


def _confidence(ranking: Sequence[Hypothesis], named: tuple[str, ...]) -> float:
    sure = 0.95
    for name in named:
        own = next((h for h in ranking if h.id == name and h.accepted), None)
        if own is not None:
            rivals = [h.evidence for h in ranking if h.beside == own.beside and h.id != name and not h.reason]
            sure *= 1.0 / (1.0 + math.exp(-0.1 * (own.evidence - max([0.0, *rivals]))))
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
    values = balance.values(entry, shape, fit) or {}
    own = [n for n, name in enumerate(fit.names) if name.startswith(f"{entry.id}.")]
    relative = float(np.min(fit.deviations[own] / np.maximum(np.abs(fit.coefficients[own]), 1e-30)))
    units = {p.name: p.unit for name in entry.terms for p in term(name).parameters}
    return [
        Quantity(name, units[name], values[name], abs(values[name]) * relative, Validity.VALID)
        for name in entry.fitted
        if name in values
    ]


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
    terms = [*base.terms, *(term(name) for entry, _ in chosen for name in entry.terms)]
    for entry, shape in chosen:
        values |= balance.values(entry, shape, fit) or {}
    known = {p.name: p for entry_ in terms for p in entry_.parameters}
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
    numbers = (
        f"{100.0 * before:.3g} % to {100.0 * after:.3g} % of the force (noise alone: {100.0 * floor:.2g} %)"
    )
    if alike:
        return (
            "Viscous and Coulomb friction cannot be told apart in this record: the speed hardly varies. "
            f"With all of the catalogue the error goes from {numbers}."
        )
    if verdict == "none":
        return f"Nothing of the catalogue is missing; the error is {100.0 * after:.3g} % of the force."
    if verdict == "unexplained":
        return f"Something is missing that has no name here; the error is {100.0 * after:.3g} % of the force."
    parts = []
    for effect in effects:
        values = ", ".join(f"{q.name} {q.value:.3g} {q.unit}" for q in effect.parameters)
        parts.append(f"{effect.id.replace('_', ' ')} ({values}): {effect.meaning}; check {effect.check}")
    return f"The model lacks {'; and '.join(parts)}. With it the error falls from {numbers}."
