"""`./spool plan`: what a planned record would tell, asked of simulated ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from spool_core.errors import InputError
from spool_core.numbers import GRAVITY
from spool_core.uncertainty import LEGEND, Z_95, Quantity, as_json, by_name, number, percent, with_interval
from spool_estimator.identification.determination import Determination, sentences
from spool_estimator.identification.fit import fit
from spool_estimator.identification.fit_result import Fit, FitSettings
from spool_estimator.identification.record import Record
from spool_estimator.identification.spectra import noise_of
from spool_estimator.record_judgement import Analysis, check_rate, noisiness, shortness
from spool_gap.catalogue import EFFECTS
from spool_gap.catalogue import effect as find_effect
from spool_gap.effect import Effect
from spool_gap.evidence.analyse import analyse
from spool_report.outputs import write_json
from spool_report.records.simulation import find_excitation
from spool_report.terminal import progress
from spool_sim.excitation import Excitation
from spool_sim.model import FLUID, Model, load_model
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.terms import term
from spool_sim.valve import FILM, Valve, find_valve

from spool_design.requests import PlanRequest

#: s: longer records cost minutes.
LONGEST = 600.0
#: Ranges that accelerometers come in, g, and how far above the largest sample of a plan one is chosen.
RANGES, MARGIN = (2, 4, 8, 16, 25, 50, 100, 200, 500), 2.0


#: Hz below which the way in the body is not taken from accelerations: their double integral drifts.
SLOWEST = 3.0

#: Standard deviations that separate a size from 0: noise alone gives as much in one of 370 records (normal
#: distribution), and half of the records with that size give more.
TOLD = 3.0
#: Share of the force of inertia that the search for the smallest size begins at; factor of its steps, how
#: many there are at most on the way to a detectable size and one that is not, and halvings: to 1.3.
BEGIN, STRIDE, STEPS, HALVINGS = 0.02, 8.0, 4, 3
#: What an end stop is described by.
STOP = ("stop_gap", "stop_stiffness", "stop_dissipation")
#: Share of the travel at which a stop is put, to see how well its place can be determined.
STOP_SHARE = 0.9


def coulomb_friction(plan: Plan) -> Answer:
    """Answer how small a dry friction the record tells from none."""

    def deviation(found: Fit) -> float:
        return found.parameter("coulomb_force").standard_deviation

    size, found, truth = _smallest(
        plan, load_model("coulomb"), lambda force: {"coulomb_force": force}, deviation
    )
    meaning = "smallest Coulomb force that can be detected (3 standard deviations)"
    return _sized(found, truth, None if size is None else Limit("coulomb_force", size, "N", meaning))


def stribeck_friction(plan: Plan) -> Answer:
    """Answer how small an excess of friction at rest over that at speed the record tells."""
    model = load_model("stribeck")
    force = model.parameter("coulomb_force").start_for(plan.valve)

    def deviation(found: Fit) -> float:
        names = ("static_force", "coulomb_force")
        if not set(names) <= set(found.observable):
            return math.nan
        rest, speed = (found.parameter(name).standard_deviation for name in names)
        place, other = (found.observable.index(name) for name in names)
        shared = float(found.correlation[place, other]) * rest * speed
        return math.sqrt(max(rest**2 + speed**2 - 2.0 * shared, 0.0))

    def values(excess: float) -> dict[str, float]:
        return {"coulomb_force": force, "static_force": force + excess}

    size, found, truth = _smallest(plan, model, values, deviation)
    meaning = (
        f"smallest detectable excess of the force at rest over {force:g} N at speed (3 standard deviations)"
    )
    return _sized(found, truth, None if size is None else Limit("static_excess", size, "N", meaning))


def mixed_friction(plan: Plan) -> Answer:
    """Answer how well the numbers of mixed lubrication can be determined, at those that fits start from."""
    found, truth = _fitted(plan, load_model("mixed"), {})
    return _answer(found, truth, None)


def viscous_coefficient(plan: Plan) -> Answer:
    """Answer how small a change of the drag two such records tell: wear, by the clearance."""
    answer = _change(plan, "viscous_coefficient", "drag (clearance by the same share: wear)")
    valve = plan.valve
    if not valve.oil_ratio_known:
        return replace(answer, notes=("without the oil's name and temperature, warm oil looks like wear",))
    ratio = valve.dynamic_viscosity_at(valve.oil_temperature + 1.0) / valve.dynamic_viscosity
    note = f"a kelvin of the oil changes the drag by {percent(1.0 - ratio)}: record its temperature"
    return replace(answer, notes=(note,))


def spring_stiffness(plan: Plan) -> Answer:
    """Answer how small a change of the stiffness two such records tell."""
    return _change(plan, "spring_stiffness", "stiffness")


def end_stop(plan: Plan) -> Answer:
    """Answer how far the spool comes, which stops it meets, and how well their place can be determined."""
    reach = travel(plan.record(load_model("fluid"), {}, noisy=False))
    model = load_model("fluid_end_stop")
    values = {"stop_gap": STOP_SHARE * reach}
    # From the truth: the gap workflow, unlike a plain fit, tries many stops.
    start = {name: model.values_for(plan.valve, plan.values(values))[name] for name in STOP}
    found, truth = _fitted(plan, model, values, start)
    meaning = "travel of the spool: it does not reach stops beyond, so this record cannot show them"
    return _answer(found, truth, Limit("stop_gap", reach, "m", meaning))


@dataclass(frozen=True, slots=True)
class Plan:
    """Plan of a record: ``seconds`` at ``sample_rate`` (Hz), sensors of ``noise`` (m/s^2 rms per sample)."""

    valve: Valve
    excitation: Excitation
    seconds: float = 40.0
    sample_rate: float = 2000.0
    noise: float = 0.05
    seed: int = 0

    def values(self, changes: Mapping[str, float]) -> dict[str, float]:
        """Return ``changes``, with the drag that fits start from where the valve's film is not known."""
        if self.valve.knows(*FILM):
            return dict(changes)
        return {"viscous_coefficient": self.valve.likely_viscous_coefficient, **changes}

    def record(self, model: Model, values: Mapping[str, float], *, noisy: bool = True) -> Record:
        """Return what the planned sensors would say of a valve with ``model`` and ``values``.

        Raises:
            InputError: excitation and sample rate do not fit, or a value is out of range.
        """
        sensor = Sensor(noise=self.noise if noisy else 0.0)
        simulator = Simulator(
            self.valve,
            self.excitation,
            model=model,
            parameters=self.values(values),
            sample_rate=self.sample_rate,
            seed=self.seed,
            body_sensor=sensor,
            spool_sensor=sensor,
        )
        blocks = list(simulator.records(self.seconds))
        body, spool = (
            np.concatenate([getattr(block, channel) for block in blocks]).astype(np.float64)
            for channel in ("body", "spool")
        )
        return Record("planned", blocks[0].stamp, blocks[0].sample_period, body, spool)


def travel(record: Record) -> float:
    """Return the largest way of the spool from its centre, m: the double integral from ``SLOWEST`` Hz on."""
    relative = record.spool - record.body
    frequency = np.fft.rfftfreq(relative.size, record.sample_period)
    spectrum = np.fft.rfft(relative)
    passed = frequency >= SLOWEST
    way = np.zeros_like(spectrum)
    way[passed] = -spectrum[passed] / (2.0 * np.pi * frequency[passed]) ** 2
    return float(np.max(np.abs(np.fft.irfft(way, relative.size))))


@dataclass(frozen=True, slots=True)
class Limit:
    """Limit of what a record tells: the least ``value`` of a quantity, and what that means."""

    quantity: str
    value: float
    unit: str
    meaning: str


@dataclass(frozen=True, slots=True)
class Answer:
    """Answer to a question: parameters with standard deviations, the truth they were made with, a limit."""

    parameters: tuple[Quantity, ...] = ()
    truth: Mapping[str, float] | None = None
    limit: Limit | None = None
    reason: str | None = None
    notes: tuple[str, ...] = ()
    determinations: tuple[Determination, ...] = ()


def _fitted(
    plan: Plan, model: Model, values: Mapping[str, float], start: Mapping[str, float] | None = None
) -> tuple[Fit, dict[str, float]]:
    truth = model.values_for(plan.valve, plan.values(values))
    return fit(
        [plan.record(model, values)], model, plan.valve, FitSettings(start=start or {}, check=True)
    ), truth


def _smallest(
    plan: Plan,
    model: Model,
    values_of: Callable[[float], dict[str, float]],
    deviation_of: Callable[[Fit], float],
) -> tuple[float | None, Fit, dict[str, float]]:
    """Return the smallest size that is ``TOLD`` of its standard deviations, the fit there and its truth.

    ``None`` where no size up to the force of inertia is detected.
    """
    quiet = plan.record(load_model("fluid"), {}, noisy=False)
    largest = plan.valve.moving_mass * float(np.sqrt(np.mean(quiet.spool**2)))
    best: tuple[float | None, Fit, dict[str, float]]

    def told(size: float) -> bool:
        nonlocal best
        found, truth = _fitted(plan, model, values_of(size))
        deviation = math.nan if found.reason else deviation_of(found)
        enough = bool(deviation * TOLD <= size)
        if enough:
            best = size, found, truth
        elif best[0] is None:
            best = None, found, truth
        return enough

    best = None, Fit(model, plan.valve.id, reason="nothing was tried"), {}
    high = BEGIN * largest
    if told(high):
        low = next(
            (size for size in (high / STRIDE**step for step in range(1, STEPS + 1)) if not told(size)), 0.0
        )
        high = best[0] or high
    else:
        low = high
        high = next((size for size in (high * STRIDE, largest) if told(size)), 0.0)
        if high == 0.0:
            return best
        low = high / STRIDE
    for _ in range(HALVINGS if low > 0.0 else 0):
        middle = math.sqrt(low * high)
        low, high = (low, middle) if told(middle) else (middle, high)
    return best


def _change(plan: Plan, name: str, what: str) -> Answer:
    found, truth = _fitted(plan, load_model("coulomb"), {})
    if found.reason is not None:
        return _answer(found, truth, None)
    # Two records, each with its own error: the difference has sqrt(2) of it.
    least = Z_95 * math.sqrt(2.0) * found.parameter(name).standard_deviation / truth[name]
    meaning = f"smallest relative change of the {what} between two such records (95 %)"
    return _answer(found, truth, Limit(f"relative_change_of_{name}", least, "1", meaning))


def _sized(found: Fit, truth: Mapping[str, float], limit: Limit | None) -> Answer:
    answer = _answer(found, truth, limit)
    untold = "no size up to the spool's force of inertia"
    return answer if limit is not None or answer.reason else replace(answer, reason=untold)


def _answer(found: Fit, truth: Mapping[str, float], limit: Limit | None) -> Answer:
    if found.reason is not None:
        return Answer(truth=truth, limit=limit, reason=found.reason)
    untold = [name for name in found.not_observable if name not in found.held]
    reason = (
        f"{', '.join(untold)}: such a record does not determine them" if limit is None and untold else None
    )
    return Answer(
        (*found.parameters, *found.combinations), truth, limit, reason, determinations=found.determinations
    )


QUESTIONS: Mapping[str, Callable[[Plan], Answer]] = {
    "coulomb_friction": coulomb_friction,
    "stribeck_friction": stribeck_friction,
    "mixed_friction": mixed_friction,
    "viscous_coefficient": viscous_coefficient,
    "spring_stiffness": spring_stiffness,
    "end_stop": end_stop,
}
#: Answered by the gap workflow, effect by effect: see :class:`Named`.
WHICH_EFFECT = "which_effect"

#: Shares of the spool's acceleration (rms) that an effect changes, from plain to just above the least share
#: that a verdict takes into account (0.0025, GapSettings.least_share).
SHARES = (0.2, 0.05, 0.0125)
#: What is tried where no effect is named: friction in two forms, drag, spring, stop.
USUAL = ("coulomb_friction", "stribeck_friction", "quadratic_damping", "cubic_stiffness", "end_stop")
#: Powers of 10 over a term's start values between which an amplitude is looked for, and halvings of it.
RANGE, SHARE_HALVINGS = 5.0, 24


def plan_record(request: PlanRequest, json: Path | None) -> int:
    """Say what a record as planned would tell; return 1 where it would tell nothing of the question.

    Raises:
        InputError: valve, question, excitation or numbers cannot be used.
    """
    if request.question is None:
        raise InputError("--question: name one")
    if request.question not in (*QUESTIONS, WHICH_EFFECT):
        known = f"{', '.join(QUESTIONS)}, {WHICH_EFFECT}"
        raise InputError(f"--question {request.question}: unknown; known: {known}")
    ask, effects = QUESTIONS.get(request.question), request.effect or USUAL
    valve, seconds, sample_rate = find_valve(request.valve), request.seconds, request.sample_rate
    check_plan(Analysis.GAP if ask is None else Analysis.ESTIMATE, seconds, sample_rate, valve)
    plan = Plan(valve, find_excitation(request.excitation), seconds, sample_rate, request.noise, request.seed)
    quiet, noisy = (plan.record(load_model("fluid"), {}, noisy=one) for one in (False, True))
    unseen = "".join(noisiness(noisy, noise_of(noisy.body, noisy.spool, noisy.sample_rate)))
    answer, found = Answer(), list[Named]()
    with progress(f"planning {request.question}", 1.0, steady=False) as advance:
        if float(np.sqrt(np.mean((quiet.spool - quiet.body) ** 2))) <= plan.noise:
            less = "this excitation moves the spool by less than the sensors' noise"
            answer, unseen = Answer(reason=unseen or less), ""
        elif ask is not None:
            answer = ask(plan)
        else:
            for one in named_effects(plan, effects):
                found.append(one)
                advance(1.0 / (len(effects) * len(SHARES)))
    answer = replace(answer, notes=(*answer.notes, unseen)) if unseen else answer
    result = _dictionary(request, quiet, answer, found)
    if json is not None:
        write_json(json, result)
    _show(result, answer, found)
    told = answer.limit is not None or (answer.parameters and answer.reason is None)
    return 0 if told or any(one.named for one in found) else 1


def check_plan(analysis: Analysis, seconds: float, sample_rate: float, valve: Valve) -> None:
    """Refuse a length or a rate that ``analysis`` does not take.

    Raises:
        InputError: too short, too long or too slow.
    """
    if not seconds <= LONGEST:
        raise InputError(f"--seconds {seconds:g}: plan {LONGEST:g} s or less")
    short = shortness(analysis, [seconds])
    if short:
        raise InputError(f"--seconds {seconds:g}: {short}")
    check_rate(f"--sample-rate {sample_rate:g}", sample_rate, valve)


@dataclass(frozen=True, slots=True)
class Named:
    """What the gap workflow says of an effect that changes ``share`` of the spool's acceleration."""

    JSON_PROPERTIES: ClassVar = ("named",)

    id: str
    share: float
    parameters: Mapping[str, float]
    verdict: str
    confidence: float

    @property
    def named(self) -> bool:
        """Whether the verdict names the effect, and nothing else."""
        return self.verdict == self.id


def named_effects(plan: Plan, effects: Sequence[str]) -> Iterator[Named]:
    """Yield the verdict for each effect, at falling shares until it is not named any more.

    Raises:
        InputError: no such effect, or one that two accelerometers cannot be simulated with.
    """
    base = load_model("fluid")
    plain = plan.record(base, {}, noisy=False)
    for name in effects:
        effect = find_effect(name)
        if not effect.terms or not effect.fitted:
            known = [one for one, entry in EFFECTS.items() if entry.terms and entry.fitted]
            raise InputError(f"--effect {name}: it is no force; use one of {', '.join(known)}")
        model = Model(f"fluid_{name}", tuple(term(one) for one in dict.fromkeys((*FLUID, *effect.terms))))
        for share in SHARES:
            values = _values_for_share(plan, effect, model, plain, share)
            if values is None:
                continue
            result = analyse([plan.record(model, values)], plan.valve, base)
            one = Named(name, share, values, result.verdict, result.confidence)
            yield one
            if not one.named:
                break


def _dictionary(
    request: PlanRequest, quiet: Record, answer: Answer, found: Sequence[Named]
) -> dict[str, Any]:
    truth = answer.truth or {}
    peaks = {channel: float(np.max(np.abs(getattr(quiet, channel)))) for channel in ("body", "spool")}
    return {
        "question": request.question,
        "valve": request.valve,
        "plan": {
            "seconds": request.seconds,
            "sample_rate_Hz": request.sample_rate,
            "noise": request.noise,
            "excitation": request.excitation,
        },
        "parameters": {one.name: {"truth": truth.get(one.name), **as_json(one)} for one in answer.parameters},
        "determined": by_name(answer.determinations),
        "limit": answer.limit,
        "reason": answer.reason,
        "notes": answer.notes,
        "effects": found,
        "record": {
            "body_rms": float(np.sqrt(np.mean(quiet.body**2))),
            "spool_rms": float(np.sqrt(np.mean(quiet.spool**2))),
            "body_peak": peaks["body"],
            "spool_peak": peaks["spool"],
            "travel_m": travel(quiet),
            "range_g": next(
                (float(one) for one in RANGES if one * GRAVITY >= MARGIN * max(peaks.values())), math.nan
            ),
        },
    }


def _show(result: dict[str, Any], answer: Answer, found: Sequence[Named]) -> None:
    record, plan = result["record"], result["plan"]
    print(
        f"planned: {plan['seconds']:g} s of {plan['excitation']} at {plan['sample_rate_Hz']:g} Hz, "
        f"sensors with {plan['noise']:g} m/s^2 of noise"
    )
    print(
        f"body {record['body_rms']:.3g} m/s^2 rms, spool {record['spool_rms']:.3g} m/s^2 rms and "
        f"{record['spool_peak']:.3g} m/s^2 at most: choose a sensor range of {record['range_g']:g} g; "
        f"the spool moves {1e3 * record['travel_m']:.3g} mm from its centre"
    )
    for line in sentences(answer.determinations):
        print(line)
    if answer.parameters:
        print(LEGEND)
    for one in answer.parameters:
        truth = (answer.truth or {}).get(one.name)
        beside = "" if truth is None else f"   (simulated: {number(truth)} {one.unit})"
        value = with_interval(one.value, one.standard_deviation, one.unit)
        print(f"  {one.name.replace('_', ' '):<28} {value}{beside}")
    if answer.limit is not None:
        limit = answer.limit
        value = percent(limit.value) if limit.unit == "1" else f"{number(limit.value)} {limit.unit}"
        print(f"{limit.meaning}: {value}")
    elif answer.reason is None and not found:
        print("no limit: see the results above")
    if answer.reason is not None:
        print(f"such a record does not determine it: {answer.reason}")
    for note in answer.notes:
        print(note)
    for tried in found:
        said = "named" if tried.named else f"not named, but {tried.verdict}"
        own = ", ".join(f"{key} {number(value)}" for key, value in tried.parameters.items())
        print(f"  {tried.id:<20} that changes {percent(tried.share)} of the motion: {said} ({own})")
    print("only noise is counted: unmodelled effects of a real valve add to it")


def _values_for_share(
    plan: Plan, effect: Effect, model: Model, plain: Record, share: float
) -> dict[str, float] | None:
    """Return the effect's parameters where it changes ``share`` of the motion; ``None`` where none does."""
    starts = {name: model.parameter(name).start_for(plan.valve) for name in effect.fitted}
    reach = travel(plain)

    def values(power: float) -> dict[str, float]:
        if effect.id == "end_stop":
            # A stop is as large as its place: nearer stops change more.
            return {**starts, "stop_gap": reach * (1.0 - 1.0 / (1.0 + 10.0**-power))}
        scale = 10.0**power
        changed = {}
        for name, start in starts.items():
            limit = model.parameter(name)
            wanted = (start or 1.0) * scale if name in effect.amplitudes else start
            changed[name] = min(max(wanted, limit.low), limit.high)
        return changed

    def changes(power: float) -> float:
        record = plan.record(model, values(power), noisy=False)
        change = np.sqrt(np.mean((record.spool - plain.spool) ** 2) / np.mean(plain.spool**2))
        return float(change) if math.isfinite(change) else math.inf

    low, high = -RANGE, RANGE
    if changes(high) < share or changes(low) > share:
        return None
    for _ in range(SHARE_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if changes(middle) < share else (low, middle)
    return values(high)
