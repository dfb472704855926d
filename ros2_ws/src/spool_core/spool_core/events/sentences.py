"""Sentences of an event, composed from its fields: a headline of twelve words at most, and details."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from spool_core.errors import InputError
from spool_core.events.event import Event, EventState, Facts, Severity
from spool_core.events.language import ENGLISH, LANGUAGES, Language
from spool_core.uncertainty import Quantity, compared, exact, number

#: Environment variable that chooses the language of nodes and commands; English without it.
VARIABLE = "SPOOL_LANGUAGE"

#: Parameters that are shown in per cent, and those that count something.
SHARES = frozenset(
    ("relative_motion", "residual", "channel_level", "flat_share", "dissipation", "period_departure")
)
COUNTS = frozenset(
    (
        "faulty_blocks",
        "lost_blocks",
        "refused_blocks",
        "refused_temperatures",
        "judged_blocks",
        "sent_blocks",
        "outliers",
        "second_estimates",
    )
)

#: Significant digits of a number without an interval: gains of accelerometers are known to per cents.
DIGITS = 3
#: Probability of a cause below which it is not shown: chosen, what is less likely distracts.
WORTH_SHOWING = 0.1
#: s below which the beginning is now: chosen, people notice no less.
NOW = 0.1

_MINUTE, _HOUR, _DAY = 60.0, 3600.0, 86400.0
#: Units as people write them.
_UNITS = {"N s/m": "N·s/m", "m/s^2": "m/s²", "deg C": "°C"}


class Detail(NamedTuple):
    """Row below an event: the ``field`` that it shows, its label and its text."""

    field: str
    label: str
    text: str

    def __str__(self) -> str:
        return f"{self.label}: {self.text}"


def language_of(code: str = "") -> Language:
    """Return the language ``code``; empty: that of ``SPOOL_LANGUAGE``, else English.

    Raises:
        InputError: there are no sentences in that language.
    """
    chosen = code or os.environ.get(VARIABLE, "") or ENGLISH.code
    if chosen not in LANGUAGES:
        where = "language" if code else VARIABLE
        raise InputError(f"{where}: {chosen!r} is not one of {', '.join(LANGUAGES)}")
    return LANGUAGES[chosen]


def headline(event: Event, language: Language = ENGLISH) -> str:
    """Return what happened in twelve words at most: what, how large, and the limit, as far as they are known.

    An event of an earlier version has its own sentence: the first clause of that is returned.
    """
    facts = event.facts
    if not facts.parameter:
        return event.text.partition("; ")[0] or _title(event, language)
    value, limit, _ = _numbers(event, language)
    template = language.cleared if event.state is EventState.CLEARED else language.raised
    sent = next((one.value for one in facts.evidence if one.name == "sent_blocks"), math.nan)
    parts = [template]
    if math.isfinite(sent):  # a share of a whole, which has no limit
        parts = [language.labels["judged_ended" if event.state is EventState.CLEARED else "judged"]]
        limit = f"{sent:.0f}"
    elif facts.parameter in COUNTS:  # any is too many
        parts.append(": {value}")
    elif math.isfinite(facts.value):
        parts += [": {parameter} {value}", language.labels["passed"] if math.isfinite(facts.limit) else ""]
    return "".join(parts).format(
        title=_title(event, language), parameter=language.parameter(facts.parameter), value=value, limit=limit
    )


def details(event: Event, language: Language = ENGLISH) -> tuple[Detail, ...]:
    """Return everything else that is known of ``event``, a line for each field."""
    return tuple(Detail(field, language.labels[field], text) for field, text in _lines(event, language))


def described(event: Event, language: Language = ENGLISH) -> str:
    """Return headline and details as lines."""
    return "\n".join([headline(event, language), *(f"  {one}" for one in details(event, language))])


def duration(seconds: float, language: Language = ENGLISH) -> str:
    """Return a time span as people read it, e.g. ``7.2 s``, ``34 min``, ``12 h``, ``5 days``."""
    for span, digits, unit, most in (
        (1.0, 1, "seconds", 2.0 * _MINUTE),
        (_MINUTE, 0, "minutes", 2.0 * _HOUR),
        (_HOUR, 0, "hours", 2.0 * _DAY),
    ):
        if seconds < most:
            return f"{_marked(f'{seconds / span:.{digits}f}', language)} {language.words[unit]}"
    return f"{seconds / _DAY:.0f} {language.words['days']}"


def title(code: int, kind: str, language: Language = ENGLISH) -> str:
    """Return the title of the number ``code``; without an entry the name of its kind."""
    return language.event(code).title or kind.replace("_", " ").capitalize()


def _title(event: Event, language: Language) -> str:
    own, subject = title(event.code, event.kind, language), event.facts.subject
    order = _order(event.facts, language)
    if order:
        return f"{own} ({order})"
    # A subject without an entry is a name: one word, whatever another program called its valve.
    word = language.words.get(subject) or "_".join(subject.split())
    return f"{own} ({word})" if subject else own


def _order(facts: Facts, language: Language) -> str:
    """Return the order of a component, or of the shaft, that shakes, and its speed; empty where unknown."""
    known = {one.name: one for one in facts.evidence}
    if "order" not in known or "speed" not in known:
        return ""
    order, labels = known["order"].value, language.labels
    shown = _marked(exact(float(number(order, DIGITS))), language)
    if order.is_integer():
        tens, ones = divmod(int(order), 10)
        key = f"order_{ones}" if ones in (1, 2, 3) and tens % 10 != 1 else "order_th"
        shown = labels[key].format(order=shown)
    template = labels["order_of" if facts.subject else "order_of_shaft"]
    speed = _quantity(replace(known["speed"], unit=""), language)
    return template.format(order=shown, component="_".join(facts.subject.split()), speed=speed)


def _lines(event: Event, language: Language) -> Iterator[tuple[str, str]]:
    facts, words = event.facts, language.words
    if event.text:
        yield "note", event.text
    if facts.parameter:
        yield from _measured(event, language)
    yield from _times(event, language)
    listed = [
        f"{language.word(cause)} {_percent(share, language)}"
        for cause, share in zip(facts.causes, facts.probabilities, strict=False)
        if share >= WORTH_SHOWING
    ]
    if listed:
        yield "causes", ", ".join(listed)
    evidence = [f"{language.parameter(one.name)} {_quantity(one, language)}" for one in facts.evidence]
    if evidence:
        yield "evidence", "; ".join(evidence)
    if facts.note:
        yield "note", language.word(facts.note)
    if math.isfinite(facts.false_alarm_interval):
        yield "false_alarm_interval", duration(facts.false_alarm_interval, language)
    if event.state is EventState.RAISED:
        yield "urgency", words.get(facts.urgency.name.lower(), words["unknown"])
        if math.isfinite(facts.time_to_limit):
            yield "time_to_limit", duration(facts.time_to_limit, language)
        elif math.isfinite(facts.baseline):
            yield "time_to_limit", words["alarm_passed" if event.severity is Severity.ALARM else "no_trend"]
    if facts.advice:
        texts, numbered = language.event(facts.advice), language.labels["number"].format(code=facts.advice)
        if texts.meaning:
            yield "meaning", texts.meaning
        yield "advice", f"{texts.advice} ({numbered})" if texts.advice else numbered


def _measured(event: Event, language: Language) -> Iterator[tuple[str, str]]:
    """Yield value, baseline, change and limit; they share their last digit, so that they can be compared."""
    facts = event.facts
    value, limit, baseline = _numbers(event, language)
    name = language.parameter(facts.parameter)
    interval = ""
    if math.isfinite(facts.low) and math.isfinite(facts.high):
        low, high = (_number(facts, one, language) for one in (facts.low, facts.high))
        interval = f" ({language.labels['interval'].format(low=low, high=high)})"
    yield "measured", f"{name} {value}{interval}"
    if math.isfinite(facts.baseline):
        yield "baseline", baseline
    if math.isfinite(facts.change):
        share = facts.change / abs(facts.baseline) if facts.baseline else math.nan
        relative = f" ({_percent(share, language, signed=True)})" if math.isfinite(share) else ""
        sign = "+" if facts.change > 0.0 else ""
        yield "change", f"{sign}{_number(facts, facts.change, language)}{relative}"
    if math.isfinite(facts.limit):
        yield "limit", limit


def _times(event: Event, language: Language) -> Iterator[tuple[str, str]]:
    began = event.facts.began
    # A clock that was set back makes no time negative.
    seconds = 1e-9 * (event.stamp - began) if 0 < began <= event.stamp else math.nan
    if event.state is EventState.CLEARED:
        if seconds >= 0.0:
            yield "lasted", duration(seconds, language)
    elif seconds >= NOW:
        yield "began", language.labels["earlier"].format(time=duration(seconds, language))


def _numbers(event: Event, language: Language) -> tuple[str, str, str]:
    """Return value, limit and baseline with units."""
    facts = event.facts
    value, limit, baseline = (
        _number(facts, one, language) for one in (facts.value, facts.limit, facts.baseline)
    )
    return value, limit, baseline


def _number(facts: Facts, value: float, language: Language) -> str:
    """Return ``value`` in the unit of ``facts``, down to the last digit that its interval leaves."""
    deviation = facts.standard_deviation
    quantity = Quantity(facts.parameter, facts.unit, value, deviation)
    return _quantity(quantity, language, interval=False)


def _quantity(quantity: Quantity, language: Language, *, interval: bool = True) -> str:
    value, deviation, unit = quantity.value, quantity.standard_deviation, quantity.unit
    if not math.isfinite(value):
        return language.labels["unknown"]
    if quantity.name in COUNTS and value.is_integer():
        return f"{int(value)}"
    factor = 1.0
    if quantity.name in SHARES or (quantity.name.endswith("_change") and unit == "1"):
        factor, unit = 100.0, "%"
    elif unit == "m" and abs(value) < 1.0:
        factor, unit = 1e3, "mm"
    elif unit == "s" and 0.0 < abs(value) < 0.1:
        factor, unit = 1e3, "ms"
    value, deviation = factor * value, factor * deviation
    if math.isfinite(deviation) and deviation > 0.0:
        shown = compared((value, deviation))[0]
        text = str(shown) if interval else shown.value
    else:
        text = exact(float(number(value, DIGITS))) if value else "0"
    suffix = "" if unit in ("", "1") else f" {_UNITS.get(unit, unit)}"
    return f"{_marked(text, language)}{suffix}"


def _percent(share: float, language: Language, *, signed: bool = False) -> str:
    value = 100.0 * share
    text = f"{value:{'+' if signed else ''}.0f}"
    return f"{_marked(text, language)} %"


def _marked(text: str, language: Language) -> str:
    return text.replace(".", language.decimal)
