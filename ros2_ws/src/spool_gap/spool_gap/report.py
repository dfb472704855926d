"""Report of a result: where the gap sits, sentences, JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from spool_core.numbers import Array
from spool_core.uncertainty import (
    PLUS_MINUS,
    Z_95,
    Quantity,
    as_json,
    by_name,
    interval,
    number,
    percent,
    unit_text,
    with_interval,
)

from spool_gap.catalogue import EFFECTS
from spool_gap.result import Explanation, GapResult, HeldOutAgreement, Remainder, Share, Surface, Where

#: Cells of the restoring-force surface.
CELLS = 24
#: What to look at.
CHECK_CLIPPING = "measuring range against the largest acceleration, amplifier setting"
CHECK_COLOURED = (
    "noise that is louder in the band of the motion than above it: cable and connector, 1/f noise of a MEMS "
    "sensor, vibration across its axis, which a single axis cannot separate from noise"
)
#: Share of the difference's power from which a candidate without a verdict is worth naming with it: half.
SHOWN = 0.5
#: Hypotheses shown at most.
RANKED = 12
#: What a remainder may be that is predictable from each of these.
LOOKS_LIKE = {
    "position": "a spring, a magnet or a stop that the catalogue does not describe",
    "speed": "friction or drag of another law",
    "position and speed": "flow forces, or friction that depends on the place",
    "the way since the last reversal": "hysteresis, such as that of friction before sliding",
    "time": "something that changes over the record: oil that warms, a sensor that drifts",
    "the motion of the body": "a lag or resonance, drag or a spring that changes within the record, or "
    "vibration across a sensor's axis",
    "the motion of the spool": "a force of another law, or a sensor that is not linear",
    "blows at the ends of the stroke": "a stop, or something loose that the spool hits",
    "a wave": "a periodic force, or a vibration or hum that one of the sensors picks up",
    "nothing": "noise louder than the record shows above its excitation, or motion that deviates from "
    "the model's at random",
}


def looks_like(follows: str) -> str:
    """Return what a remainder may be that ``follows`` something."""
    known = next((one for one in LOOKS_LIKE if follows == one or follows.startswith(f"{one} of ")), "nothing")
    return LOOKS_LIKE[known]


@dataclass(frozen=True, slots=True)
class Residual:
    """What the model lacks along a motion; every array has shape (n,).

    Attributes:
        time: s.
        displacement, velocity: m, m/s.
        force: the missing force, N.
        floor: rms of what noise makes of it, N.
        period: s between samples; windows follow one another.
    """

    time: Array
    displacement: Array
    velocity: Array
    force: Array
    floor: float
    period: float


def locate(residual: Residual) -> Where:
    """Return the shares of the residual force's energy."""
    z, v, force = residual.displacement, residual.velocity, residual.force
    z_size = float(np.quantile(np.abs(z), 0.98)) or 1e-9
    v_size = float(np.quantile(np.abs(v), 0.98)) or 1e-9
    z_top, v_top = float(np.abs(z).max()) or 1e-9, float(np.abs(v).max()) or 1e-9
    steps = np.array([0.0, 0.1, 0.25, 0.5, 0.75, 1.0])
    displacement = _shares(np.abs(z), force, _edges(steps * z_size, z_top), "m", residual.floor)
    velocity = _shares(np.abs(v), force, _edges(steps * v_size, v_top), "m/s", residual.floor)
    direction = _shares(np.sign(v), force, [-1.5, 0.0, 1.5], "1", residual.floor)
    low, high = float(residual.time.min()), float(residual.time.max()) + residual.period
    time = _shares(residual.time, force, np.linspace(low, high, 9).tolist(), "s", residual.floor)
    angle = np.arctan2(-v / v_size, z / z_size)
    phase = _shares(angle, force, np.linspace(-np.pi, np.pi, 9).tolist(), "rad", residual.floor)
    frequency = _by_frequency(residual)
    rows = {"frequency": frequency, "displacement": displacement, "velocity": velocity, "time": time}
    return Where(frequency, displacement, velocity, direction, time, phase, _sentence(rows))


def surface(residual: Residual, cells: int = CELLS) -> Surface:
    """Return the mean missing force over displacement and velocity."""
    z, v = residual.displacement, residual.velocity
    z_size = float(np.quantile(np.abs(z), 0.999)) or 1e-9
    v_size = float(np.quantile(np.abs(v), 0.999)) or 1e-9
    z_edges, v_edges = np.linspace(-z_size, z_size, cells + 1), np.linspace(-v_size, v_size, cells + 1)
    count, _, _ = np.histogram2d(z, v, [z_edges, v_edges])
    total, _, _ = np.histogram2d(z, v, [z_edges, v_edges], weights=residual.force)
    mean = np.where(count >= 3, total / np.maximum(count, 1.0), np.nan)
    return Surface(np.asarray(z_edges), np.asarray(v_edges), mean, count)


def lead(result: GapResult) -> tuple[tuple[str, str], ...]:
    """Return what is missing, how sure that is, and what to check: a sentence each behind its heading."""
    what = "the spool's acceleration" if result.kind == "accelerations" else "the force"
    missing = result.sentence
    if result.effects:
        found = []
        for one in result.effects:
            sizes = ", ".join(f"{own.name.replace('_', ' ')} {rounded(own)}" for own in one.parameters)
            found.append(f"{one.id.replace('_', ' ')} ({sizes})" if sizes else one.id.replace("_", " "))
        missing = f"The model lacks {' and '.join(found)}"
        if result.remainder is not None:
            left = f"{percent(math.sqrt(result.remainder.share) * result.before.nrmse)} of {what}"
            missing += f", and something else is left ({left}; {_followed(result.remainder)})"
        missing += "."
    note = f" ({result.confidence_note})" if result.confidence_note else ""
    errors = f"error {percent(result.before.nrmse)} before, {percent(result.after.nrmse)} after"
    sure = (
        f"Confidence {result.confidence:.2f}{note}; on data that no fit has seen: {errors}, "
        f"in % of {what}{_noise(result.after.nrmse, result.known_floor, ', ')}."
    )
    checks = [one.check for one in result.effects if one.check]
    if result.alternatives or (not checks and result.advice):
        checks.append(result.advice)
    checks += [one.check for one in result.nuisances] if not checks else []
    check = f"{'; '.join(dict.fromkeys(filter(None, checks))) or 'nothing on this valve'}."
    return (
        ("What is missing", missing),
        ("How sure", sure),
        ("What to check", f"{check[:1].upper()}{check[1:]}"),
    )


def rounded(one: Quantity) -> str:
    """Return a number with its 95 % interval, or to four digits where the interval is narrower than these."""
    digit = 10.0 ** (math.floor(math.log10(abs(one.value))) - 3) if one.value else 0.0
    if 0.0 <= Z_95 * one.standard_deviation < digit:
        return f"{number(one.value)}{unit_text(one.unit)}"
    return with_interval(one.value, one.standard_deviation, one.unit)


#: Columns and rows of a table.
Listed: TypeAlias = tuple[tuple[str, ...], list[tuple[object, ...]]]


def explanations(result: GapResult) -> Listed:
    """Return the explanations that the record does not distinguish."""
    columns = ("explanation", "group", "probability", "numbers", "distinguished by")
    return columns, [
        (
            " and ".join(one.effects).replace("_", " ") or "nothing is missing", one.group,
            f"{one.probability:.2f}", _sizes(one.parameters), one.told_apart_by,
        )
        for one in (result.explanations if result.alternatives else ())
    ]  # fmt: skip


def effects(result: GapResult) -> Listed:
    """Return the effects that are missing."""
    columns = ("effect", "numbers", "what it means", "what to check")
    return columns, [
        (one.id.replace("_", " "), _sizes(one.parameters), one.meaning, one.check) for one in result.effects
    ]


def nuisances(result: GapResult) -> Listed:
    """Return the effects of the measuring chain."""
    return ("finding", "channel", "size", "what to check"), [
        (
            f"{one.id.replace('_', ' ')}{', left out' if one.corrected else ''}", one.channel,
            f"{number(one.size, 2)} {one.unit}".removesuffix(" 1"), one.check,
        )
        for one in result.nuisances
    ]  # fmt: skip


def hypotheses(result: GapResult) -> Listed:
    """Return the first hypotheses."""
    return ("hypothesis", "jointly with", "error, %", "evidence", "verdict"), [
        (
            one.id.replace("_", " "),
            ", ".join((*one.jointly_with, *one.measuring_chain)).replace("_", " ") or "the base",
            100.0 * one.nrmse_after, f"{one.evidence:.0f}", result.verdict_of(one),
        )
        for one in result.ranking[:RANKED]
    ]  # fmt: skip


def parameters(result: GapResult) -> Listed:
    """Return the parameters of the base model and with what was found."""
    base, final = ({one.name: one for one in own} for own in (result.base, result.parameters))
    return ("parameter", "base model", "with what was found", "unit"), [
        (
            name.replace("_", " "),
            *(
                str(interval(own[name].value, own[name].standard_deviation)) if name in own else ""
                for own in (base, final)
            ),
            (final.get(name) or base[name]).unit,
        )
        for name in dict.fromkeys([*final, *base])
    ]


def _sizes(parameters: Sequence[Quantity]) -> str:
    return "; ".join(f"{one.name.replace('_', ' ')} {rounded(one)}" for one in parameters)


def nothing_missing(base: str, after: float, floor: float, of_what: str) -> str:
    """Return the sentence where nothing is missing in the model ``base``.

    Args:
        base: name of the model.
        after: error that it leaves on held-out data.
        floor: error that noise alone leaves.
        of_what: that is compared: "the spool's acceleration" or "the force".
    """
    return f"Nothing is missing: '{base}' leaves {percent(after)} of {of_what}{_noise(after, floor, ', ')}."


def _noise(after: float, floor: float, before: str, behind: str = "") -> str:
    """Return what noise leaves; nothing where only a bound is known, which exceeds the error."""
    return f"{before}noise alone {percent(floor)}{behind}" if floor <= after else ""


def named(
    effects: Sequence[tuple[str, Sequence[Quantity]]], before: float, after: float, floor: float, of_what: str
) -> str:
    """Return the sentence where ``effects`` are missing, each with its numbers; the rest as above."""
    lacking, meanings = [], []
    for name, numbers in effects:
        entry = EFFECTS[name]
        sizes = [f"{one.name} {rounded(one)}" for one in numbers]
        spelled = name.replace("_", " ")
        lacking.append(f"{spelled} ({', '.join(sizes)}; {PLUS_MINUS})")
        meanings.append(f"{spelled.capitalize()} means {entry.on_the_machine}. Check {entry.to_check}.")
    added = "this effect" if len(effects) == 1 else "these effects"
    return (
        f"The model lacks {' and '.join(lacking)}. {' '.join(meanings)} "
        f"With {added} the error falls from {percent(before)} to "
        f"{percent(after)} of {of_what}{_noise(after, floor, ' (', ')')}."
    )


def not_told_apart(effects: Sequence[str], others: Sequence[Explanation]) -> str:
    """Return the sentence on ``others`` that a record does not tell from ``effects``."""
    names = [" and ".join(one.effects).replace("_", " ") or "nothing" for one in others]
    told = "; ".join(dict.fromkeys(one.told_apart_by for one in others if one.told_apart_by))
    own = " and ".join(effects).replace("_", " ") or "nothing missing"
    return (
        f"The record cannot distinguish {own} from {' or '.join(names)}{f'; needed: {told}' if told else ''}."
    )


def unnamed(
    base: str,
    candidates: Sequence[str],
    follows: str,
    before: float,
    after: float,
    floor: float,
    of_what: str,
) -> str:
    """Return the sentence where what is missing has no name.

    Args:
        base: name of the model.
        candidates: effects that come nearest.
        follows: what the remainder is a function of, or "nothing".
        before, after: error on held-out data of ``base`` and of the best model.
        floor: error that noise alone leaves.
        of_what: that is compared.
    """
    near = ""
    if candidates:
        names = " and ".join(name.replace("_", " ") for name in candidates)
        shown = 1.0 - (after / before) ** 2 if before > 0.0 else 0.0
        much = f": with it {percent(shown)} of the difference's power is gone" if shown >= SHOWN else ""
        near = f" Closest is {names}{much}."
    rest = f" The rest follows {follows}: {looks_like(follows)}." if follows != "nothing" else ""
    return (
        f"Something is missing that has no name here: '{base}' misses "
        f"{percent(before)} of {of_what}, the best model {percent(after)}{_noise(after, floor, ', ')}."
        f"{near}{rest}"
    )


def still_missing(left: Remainder) -> str:
    """Return the sentence on the remainder beside names."""
    return (
        f"Something else is left, {left.over_noise_floor:.3g} times the noise's power and "
        f"{percent(left.share)} of the gap's; {_followed(left)}."
    )


def _followed(left: Remainder) -> str:
    follows = "nothing predicts it" if left.function_of == "nothing" else f"it follows {left.function_of}"
    return f"{follows}: {left.looks_like}"


def result_to_dict(result: GapResult) -> dict[str, Any]:
    """Return ``result`` as JSON takes it."""
    written: dict[str, Any] = as_json(
        {
            "record": result.record,
            "kind": result.kind,
            "base_model": result.base_model,
            "where": _where(result.where),
            "where_after": _where(result.where_after),
            "effects": result.effects,
            "verdict": result.verdict,
            "explanations": result.explanations,
            "remainder": result.remainder,
            "nuisances": result.nuisances,
            "linear_anomaly": None
            if result.linear_anomaly is None
            else {
                "frequency_Hz": result.linear_anomaly,
                "group": "linear anomaly",
                "told_apart_by": "a tap test of the sensors' brackets; the record repeated with a "
                "sensor moved",
            },
            "small_effects": result.small_effects,
            "confidence": result.confidence,
            "confidence_note": result.confidence_note or None,
            "confidence_from": result.signs,
            "sentence": result.sentence,
            "candidates": result.candidates,
            "runner_up": result.runner_up,
            "ranking": result.ranking,
            "base": by_name(result.base),
            "parameters": by_name(result.parameters),
            "gap": {
                "before": _agreement(result.before, result.kind),
                "after": _agreement(result.after, result.kind),
                "noise_floor": result.known_floor,
            },
            "predictable_share": result.predictable,
            "profiles": by_name(result.profiles),
            "determined": by_name(result.determinations),
            "warnings": result.warnings,
            "advice": result.advice or None,
            "seconds_of_data": result.seconds,
            "elapsed_s": result.elapsed,
        }
    )
    return written


def anomaly_sentence(frequency: float) -> str:
    """Return the sentence on a resonance at ``frequency`` (Hz) that the description lacks."""
    return (
        f"The valve's description lacks a resonance near {number(frequency, 3)} Hz. "
        "Possible causes: sensor bracket, spring surge or oil column. A tap test distinguishes them."
    )


def _edges(values: Array, top: float) -> list[float]:
    return [*values[:-1].tolist(), max(top, float(values[-1])) * 1.0001]


def _shares(over: Array, force: Array, edges: Sequence[float], unit: str, floor: float) -> tuple[Share, ...]:
    power = np.square(force)
    total = float(power.sum()) or 1.0
    place = np.clip(np.digitize(over, edges) - 1, 0, len(edges) - 2)
    sums = np.bincount(place, power, minlength=len(edges) - 1)
    counts = np.bincount(place, minlength=len(edges) - 1)
    return tuple(
        Share(float(low), float(high), unit, float(part / total), min(1.0, float(count * floor**2 / total)))
        for low, high, part, count in zip(edges[:-1], edges[1:], sums, counts, strict=True)
    )


def _by_frequency(residual: Residual) -> tuple[Share, ...]:
    force = residual.force - residual.force.mean()
    lines = np.abs(np.fft.rfft(force * np.hanning(force.size))) ** 2
    frequency = np.fft.rfftfreq(force.size, residual.period)
    top = float(frequency[-1])
    edges = [0.0, *[edge for edge in (5.0, 10.0, 20.0, 35.0, 60.0, 100.0, 200.0, 400.0) if edge < top], top]
    total = float(lines.sum()) or 1.0
    place = np.clip(np.digitize(frequency, edges) - 1, 0, len(edges) - 2)
    sums = np.bincount(place, lines, minlength=len(edges) - 1)
    mean = float(np.mean(np.square(residual.force))) or 1.0
    return tuple(
        Share(low, high, "Hz", float(part / total), min(1.0, residual.floor**2 / mean * (high - low) / top))
        for low, high, part in zip(edges[:-1], edges[1:], sums, strict=True)
    )


def _sentence(rows: dict[str, tuple[Share, ...]]) -> str:
    """Return what stands out most: the narrowest part with more than half of the gap."""
    best: tuple[float, str] | None = None
    for name, shares in rows.items():
        width = sum(share.high - share.low for share in shares)
        for share in shares:
            part = (share.high - share.low) / width
            if share.share > 0.45 and share.share > 2.5 * part:
                size, unit = (1e3, "mm") if share.unit == "m" else (1.0, share.unit)
                low, high = number(size * share.low, 3), number(size * share.high, 3)
                text = f"{100.0 * share.share:.0f} % of the gap at a {name} of {low} to {high} {unit}"
                if best is None or share.share / part > best[0]:
                    best = (share.share / part, text)
    return best[1] if best else "spread over frequency, displacement, velocity and time"


def _agreement(agreement: HeldOutAgreement, kind: str) -> dict[str, Any]:
    found = {"nrmse": agreement.nrmse, "amplitude_ratio": agreement.amplitude_ratio}
    return found | ({"position_rmse_m": agreement.position_rmse} if kind == "driven" else {})


def _where(where: Where) -> dict[str, Any]:
    rows = {
        name: [
            {f"low_{unit}": one.low, f"high_{unit}": one.high, "share": one.share, "floor": one.floor}
            for one in getattr(where, name)
            for unit in (one.unit.replace("/", "_per_"),)
        ]
        for name in ("frequency", "displacement", "velocity", "direction", "time", "phase")
    }
    return {**rows, "sentence": where.sentence}
