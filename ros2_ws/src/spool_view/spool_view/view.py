"""What browsers get to see: the machine in rows, and one valve with its alarms, spectrum and trends."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from spool_core.block import Block, joined
from spool_core.block_gate import BlockGate, Verdict
from spool_core.errors import InputError
from spool_core.events.language import LANGUAGES
from spool_core.events.sentences import details, headline, title
from spool_core.node.messages import from_event_message
from spool_core.uncertainty import Z_95, interval, number
from spool_monitor.alarm import AlarmState
from spool_monitor.event import Namur
from spool_monitor.listener import ENDS, NO_WORD, HeardValve
from spool_monitor.shown import listed
from spool_monitor.shown import shown as shown_valve
from spool_monitor.state_database import FILE, own_file
from spool_monitor.state_file import valve_folder
from spool_monitor.trend import KEPT, TrendStore, finest
from spool_monitor.trend_outlook import outlook
from spool_msgs.msg import AlarmList, GapAnalysis, HealthEvent, ModelEstimate, Quantity

#: What the monitor says where the strongest line is too weak to be one of the machine's.
AT_REST = "resonance: not enough excitation"

#: The monitor's limit of the distance to the natural frequency.
BAND = "resonance_band"
_STATES = ("unknown", "learning", "tracking", "not_excited", "stale", "settling")
_OTHERS = (
    "natural_frequency", "damping_ratio", "oil_temperature", "residual", "excitation",
    "relative_displacement",
)  # fmt: skip

STATES = {one.value: one.name.lower() for one in AlarmState}
#: Letters of NAMUR NE 107 by the numbers of ``ValveHealth``.
LETTERS = {one.value: one.letter for one in Namur}
#: Alarms that one cause outside of the valves raises at many of them: sender, clock, cable, temperature.
COMMON_KINDS, COMMON_CAUSES = ("data_fault", "stale", "sensor_fault"), ("oil_viscosity",)
_SEVERITIES = {HealthEvent.SEVERITY_WARNING: "warning", HealthEvent.SEVERITY_ALARM: "alarm"}
#: Characters of a text that are shown at most: chosen, it bounds what foreign messages fill.
_LONGEST = 2000

#: s of samples that are looked at; lines lie 0.5 Hz apart.
WINDOW = 2.0
#: Relative distance of lines below which the last line moves by less than four of :data:`MOST_LINES`.
LINES_APART = 0.01
#: Hz, above which no line is shown, and lines that are sent at most.
HIGHEST, MOST_LINES = 200.0, 400
#: Samples of a block, and per second, that are taken at most: chosen, it bounds the work.
MOST_SAMPLES = 100_000

#: Lengths that can be asked for, s; 0: all there is.
RANGES = {"hour": 3600, "day": 86400, "week": 7 * 86400, "year": 366 * 86400, "all": 0}
#: Points that are sent at most.
MOST_POINTS = 1500
#: Shown where nothing else is asked for.
FIRST = "natural_frequency"
#: s that a reading waits for the monitor's own writing.
PATIENCE = 1.0

_VALIDITIES = {
    Quantity.VALIDITY_VALID: "valid",
    Quantity.VALIDITY_HELD: "held",
    Quantity.VALIDITY_IMPLAUSIBLE: "implausible",
}


def margin_of(health: Any) -> float | None:
    """Return how far the strongest line lies from the natural frequency (1, negative: below it)."""
    line, natural = health.dominant_frequency, health.natural_frequency
    if AT_REST in health.judgements or not known(line) or not known(natural) or natural.value <= 0.0:
        return None
    return float(line.value / natural.value - 1.0)


def row_of(valve: HeardValve, now: float) -> dict[str, Any]:
    """Return what the machine's page shows of ``valve`` at ``now`` (s, monotonic)."""
    found, health = shown_valve(valve, now, time.time()), valve.health
    reason = found.reason
    row: dict[str, Any] = {
        "name": valve.name,
        "condition": found.state,
        "rank": found.rank[:2],
        "reason": None if reason is None else reason.name[:_LONGEST],
        "since": round(found.since) or None,
        "waiting": found.waiting,
        "letter": "",
        **dict.fromkeys(("margin", "band", "shakes", "natural", "summary")),
    }
    if health is None or found.state == NO_WORD:
        return row
    row["letter"] = LETTERS.get(health.namur if reason is None else reason.namur, "")
    band = valve.limits.get(BAND)
    row["band"] = None if band is None else rounded(100.0 * band, 3)
    margin = margin_of(health)
    row["margin"] = None if margin is None else round(100.0 * margin)
    row["shakes"] = None if margin is None else hertz(health.dominant_frequency)
    row["natural"] = hertz(health.natural_frequency)
    row["summary"] = health.summary
    return row


def detail_of(valve: HeardValve, now: float) -> dict[str, Any]:
    """Return what the page of ``valve`` shows at ``now`` (s, monotonic)."""
    estimate = valve.estimate
    detail = row_of(valve, now)
    silent = detail["condition"] == NO_WORD
    detail["alarms"] = alarms_of(valve.alarms)
    health = None if silent else valve.health
    detail["resonance"], detail["judgements"] = None, [] if health is None else list(health.judgements)
    if health is not None:
        detail["resonance"] = {
            "margin": detail["margin"],
            "band": detail["band"],
            "shakes": shown(health.dominant_frequency),
            "natural": shown(health.natural_frequency),
            "amplification": shown(health.amplification),
        }
    detail["baseline"] = detail["gap"] = None
    if valve.baseline is not None:
        detail["baseline"] = {
            "version": int(valve.baseline.version),
            **{key: getattr(valve.baseline, key) for key in ("stage", "valve_id", "oil", "frozen_by")},
        }
    if valve.gap is not None:
        detail["gap"] = {
            "done": valve.gap.state == GapAnalysis.STATE_DONE,
            "verdict": valve.gap.verdict,
            "confidence": rounded(valve.gap.confidence.value, 3),
            "sentence": valve.gap.sentence,
            "window": rounded(valve.gap.window, 3),
            "stamp": int(valve.gap.header.stamp.sec),
            "report": bool(valve.gap.json),
        }
    detail["estimate"] = None
    if estimate is not None:
        state = _STATES[estimate.state] if estimate.state < len(_STATES) else "unknown"
        detail["estimate"] = {
            "model": estimate.model,
            "state": "stale" if silent else state,
            "parameters": [_parameter(valve, estimate, one) for one in estimate.parameters],
            "others": [shown(getattr(estimate, name)) for name in _OTHERS],
            "lost": int(estimate.lost_blocks),
            "refused": int(estimate.refused_blocks),
        }
    return detail


def alarms_of(message: AlarmList | None) -> list[dict[str, Any]]:
    """Return the alarms that are shown, as browsers get them."""
    return [
        {
            **{key: getattr(one, key)[:_LONGEST] for key in ("name", "kind", "cause")},
            "code": int(one.code),
            "state": STATES.get(one.state, "unknown"),
            "underlying": STATES.get(one.underlying, "unknown"),
            "severity": _SEVERITIES.get(one.severity, "unknown"),
            "letter": LETTERS.get(one.namur, ""),
            "urgency": int(one.event.urgency),
            "parameter": one.event.parameter[:_LONGEST],
            "common": one.kind in COMMON_KINDS or one.cause in COMMON_CAUSES,
            "occurrence": int(one.occurrence),
            "texts": _texts(one),
            "raised": int(one.raised_at.sec) or None,
            "acknowledged": int(one.acknowledged_at.sec) or None,
            "by": (one.hidden_by or one.acknowledged_by)[:_LONGEST],
            "comment": (one.hidden_comment if one.hidden_by else one.comment)[:_LONGEST],
            "hidden": int(one.hidden_at.sec) or None,
            "shelved_until": int(one.shelved_until.sec) or None,
        }
        for one in listed(message)
    ]


def spectrum_of(blocks: Sequence[Block]) -> dict[str, Any] | None:
    """Return peak accelerations (m/s^2) by line of the newest samples of ``blocks``.

    Args:
        blocks: of one valve, oldest first.

    Returns:
        Distance of the lines (Hz), ``body`` and ``spool``; ``None`` while there are too few samples.
    """
    gate, taken = BlockGate(), list[Block]()
    for block in blocks:
        verdict = gate.judge(block)
        if verdict is not Verdict.CONTINUES:
            taken.clear()
        if verdict is not Verdict.REFUSED:
            taken.append(block)
    period = taken[-1].sample_period if taken else 0.0
    if not WINDOW / MOST_SAMPLES < period < WINDOW / 16:
        return None
    whole, wanted = joined(taken), round(WINDOW / period)
    body, spool = (part[-wanted:].astype(np.float64) for part in (whole.body, whole.spool))
    size = body.size
    if size < 16 or size * period < 0.5 * WINDOW:
        return None
    taper = np.hanning(size)
    scale = 2.0 / taper.sum()
    step = 1.0 / (size * period)
    count = int(min(size // 2, MOST_LINES, HIGHEST / step))
    found: dict[str, Any] = {"step": round(step, 6)}
    for name, samples in (("body", body), ("spool", spool)):
        lines = np.abs(np.fft.rfft((samples - samples.mean()) * taper))[:count] * scale
        found[name] = [float(f"{value:.2e}") for value in lines.tolist()]
    return found


def is_whole(spectrum: Mapping[str, Any]) -> bool:
    """Return whether a spectrum is of a whole window: its lines lie where those of a waterfall do."""
    return bool(abs(WINDOW * spectrum["step"] - 1.0) < LINES_APART)


def trend_of(
    base: Path, valve: str, parameter: str, length: str, begin: int = 0,
    limits: Callable[[str], Mapping[str, float | None]] = lambda _: {},
) -> dict[str, Any]:  # fmt: skip
    """Return the trend of a parameter of ``valve``, or of ``FIRST`` where ``parameter`` is empty.

    Args:
        base: the monitors' ``state_folder``.
        valve: namespace.
        parameter: name.
        length: one of ``RANGES``.
        begin: s since 1970, instead of ``length``; 0: by ``length``.
        limits: return ``baseline``, ``low`` and ``high`` of a parameter.

    Raises:
        InputError: there is none, or the file is damaged.
        OSError: it can't be read.
    """
    path = own_file(valve_folder(base, valve) / FILE, PATIENCE)
    with closing(TrendStore(path, read_only=True, patience=PATIENCE)) as store:
        units = store.units()
        name = parameter or (FIRST if FIRST in units else next(iter(units), ""))
        if name not in units:
            raise InputError(f"{valve}: no trend of that name is kept")
        now = int(time.time())
        since = begin or (now - RANGES[length] if RANGES[length] else 0)
        hours = store.spans(name, 3600, since - since % 3600)
        duration = now - since if since else (now - hours[0].start if hours else 0)
        seconds = finest(KEPT, duration, MOST_POINTS)
        spans = store.spans(name, seconds, since - since % seconds)[-MOST_POINTS:]
        own = limits(name)
        near, reaches = outlook(store, name, own.get("baseline"), [own.get("low"), own.get("high")], now)
    return {
        "parameters": list(units),
        "parameter": name,
        "unit": units[name],
        "seconds": seconds,
        "from": since or None,
        "until": now,
        "start": [span.start for span in spans],
        "minimum": [rounded(span.minimum) for span in spans],
        "mean": [rounded(span.mean) for span in spans],
        "maximum": [rounded(span.maximum) for span in spans],
        "near_days": near,
        "reaches": None if reaches is None else [rounded(reaches.early), rounded(reaches.late)],
    }


def limits_of(valve: HeardValve, parameter: str) -> dict[str, float | None]:
    """Return ``baseline``, ``low`` and ``high`` of a parameter of ``valve``; ``None``: not known."""
    values = [] if valve.baseline is None else valve.baseline.values
    found = {"baseline": next((rounded(one.value) for one in values if one.name == parameter), None)}
    for end in ENDS:
        bound = valve.bound(parameter, end)
        found[end] = rounded(math.nan if bound is None else bound)
    return found


def known(quantity: Any) -> bool:
    """Return whether the message ``quantity`` has a number that holds."""
    usable = quantity.validity in (Quantity.VALIDITY_VALID, Quantity.VALIDITY_HELD)
    return usable and math.isfinite(quantity.value)


def shown(quantity: Any) -> dict[str, Any]:
    """Return ``quantity`` as text with its 95 % half width, and as numbers; lengths below 1 m in mm."""
    unit, scale = quantity.unit, 1.0
    if unit == "m" and abs(quantity.value) < 1.0:
        unit, scale = "mm", 1e3
    value, deviation = scale * quantity.value, scale * quantity.standard_deviation
    found = {
        "name": quantity.name,
        "unit": unit,
        "validity": _VALIDITIES.get(quantity.validity, "unknown"),
        **dict.fromkeys(("text", "half", "value", "width")),
    }
    if found["validity"] == "unknown" or not math.isfinite(value):
        return found
    found["text"], found["value"] = number(value), rounded(value)
    if math.isfinite(deviation):
        text = interval(value, deviation)
        found["text"], found["half"] = text.value, text.half_width
        found["width"] = rounded(Z_95 * deviation)
    return found


def rounded(value: float, digits: int = 6) -> float | None:
    """Return ``value`` with so many significant digits, ``None`` where it is no number."""
    return float(f"{value:.{digits - 1}e}") if math.isfinite(value) else None


def hertz(quantity: Any) -> str | None:
    """Return a frequency with one decimal, ``None`` where there is none."""
    return f"{quantity.value:.1f}" if known(quantity) else None


def _parameter(valve: HeardValve, estimate: ModelEstimate, quantity: Quantity) -> dict[str, Any]:
    """Return an estimate with its baseline and the limits that the monitor warns at."""
    compared = quantity
    if quantity.name == "viscous_coefficient" and known(estimate.referred_viscous_coefficient):
        # The monitor compares what drags at one temperature of the oil.
        compared = estimate.referred_viscous_coefficient
    found = {**shown(quantity), "compared": None, "baseline": None, "low": None, "high": None, "change": None}
    values = [] if valve.baseline is None else valve.baseline.values
    baseline = next((one for one in values if one.name == quantity.name), None)
    if compared is not quantity:
        found["compared"] = shown(compared)
    if baseline is None or not math.isfinite(baseline.value):
        return found
    found |= {**limits_of(valve, quantity.name), "baseline": shown(baseline)}
    if known(compared) and baseline.value:
        found["change"] = rounded(100.0 * (compared.value / baseline.value - 1.0), 3)
    return found


def _texts(alarm: Any) -> dict[str, Any]:
    if not alarm.message:
        return {}
    event = from_event_message(alarm.event)
    texts = {}
    for code, language in LANGUAGES.items():
        lines = details(event, language)
        by_field = {one.field: one.text[:_LONGEST] for one in lines}
        texts[code] = {
            "title": title(event.code, event.kind, language)[:_LONGEST],
            "advice": language.event(event.facts.advice).advice if event.facts.advice else "",
            "urgency": by_field.get("urgency", ""),
            "headline": headline(event, language)[:_LONGEST],
            "details": [(one.label, one.text[:_LONGEST]) for one in lines],
        }
    return texts
