"""Status of a valve in a light and a sentence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone

from spool_core.uncertainty import interval, number
from spool_monitor.detectors import friction_drift, spring_change
from spool_monitor.events.event import EventCause

from spool_fleet.page.courses import NAMES, TrendRow
from spool_fleet.trends.comparison import MONTH
from spool_fleet.trends.judgement import CHANGED, LEARNING, MACHINE, UNKNOWN
from spool_fleet.trends.observations import STIFFNESS

#: Months: a change that may reach the monitor's limit sooner is to be acted on now, since a spool has to be
#: ordered and a stop of the machine planned, which takes about a quarter of a year.
SOON = 3.0
#: Usual pauses of a valve, and days, after which it is silent: a holiday of two weeks is no silence.
PAUSES, LEAST_SILENCE = 3.0, 14.0


@dataclass(frozen=True, slots=True)
class Light:
    """Light: ``name`` in the page's styles; ``mark`` and ``word`` say it without colour."""

    name: str
    mark: str
    word: str
    meaning: str


ALARM = Light(
    "alarm", "▲", "act now",
    "a parameter changed and is past the limit at which the monitor of the running valve warns, or may be "
    f"there within {SOON:g} months (early end of the 95 % interval)",
)  # fmt: skip
WARNING = Light("warning", "◆", "changed", "a parameter changed, the monitor's limit is not near")
SILENT = Light(
    "silent", "∅", "silent",
    f"no usable bag for {PAUSES:g} times as long as it usually pauses, at least {LEAST_SILENCE:g} days",
)  # fmt: skip
WHOLE = Light(
    "whole", "■", "whole machine",
    "the valves of the machine changed together: look at what they share, first of all the oil",
)  # fmt: skip
NOT_KNOWN = Light("unknown", "?", "unknown", "a parameter cannot be judged; the valve's section says why")
LEARNS = Light("learning", "…", "learning", "too few weeks with bags for a judgement")
GOOD = Light("good", "●", "ok", "all three parameters are judged, none changed")
#: The worst first: a valve of which several are true shows the first of them.
LIGHTS = (ALARM, WARNING, SILENT, WHOLE, NOT_KNOWN, LEARNS, GOOD)
#: Those of which reports are made, and which are opened for print.
CONSPICUOUS = (ALARM, WARNING, WHOLE)

#: Months below which days are told: half a month rounded to two digits says too little or too much.
SHORT = 1.0
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)


def light_of(trends: Sequence[TrendRow], silent: bool) -> Light:
    """Return the light of a valve with ``trends``; without any it is unknown."""
    states = {one.state for one in trends}
    if any(one.state == CHANGED and urgent(one) for one in trends):
        return ALARM
    if CHANGED in states:
        return WARNING
    if silent:
        return SILENT
    for state, light in ((MACHINE, WHOLE), (UNKNOWN, NOT_KNOWN), (LEARNING, LEARNS)):
        if state in states:
            return light
    return GOOD if states else NOT_KNOWN


def urgent(trend: TrendRow) -> bool:
    """Return whether a change is past the monitor's limit or may soon be."""
    soonest = trend.months_earliest if math.isfinite(trend.months_earliest) else trend.months_to_threshold
    return trend.share_of_limit >= 1.0 or soonest <= SOON


def patience(pause: float) -> float:
    """Return the days after which a valve with a usual ``pause`` is silent."""
    return max(PAUSES * pause, LEAST_SILENCE)


def change_sentence(trend: TrendRow) -> str:
    """Return what changed, by how much (95 % interval), since when and how fast."""
    verb = "rose" if trend.change > 0.0 else "fell"
    size = interval(100.0 * abs(trend.change), 100.0 * trend.change_std)
    name = NAMES[trend.parameter]
    text = f"{name[0].upper()}{name[1:]} {verb} by {size} % since about {date(trend.since)}"
    if math.isfinite(trend.rate):
        text += f", {interval(100.0 * abs(trend.rate), 100.0 * trend.rate_std)} % a month"
    return text


def limit_sentence(trend: TrendRow) -> str:
    """Return how near the monitor's limit is, and when it is reached."""
    limit = f"the limit of the running valve's monitor ({percent(trend.threshold)})"
    if trend.share_of_limit >= 1.0:
        return f"past {limit}"
    if math.isnan(trend.months_to_threshold):
        return f"{percent(trend.share_of_limit)} of the way to {limit}; it does not grow"
    return f"at {limit} in {time_left(trend)}"


def time_left(trend: TrendRow) -> str:
    """Return how long until the monitor's limit is reached, with its interval; short times in days."""
    if trend.share_of_limit >= 1.0:
        return "past it"
    if math.isnan(trend.months_to_threshold):
        return "does not grow"
    short = trend.months_to_threshold < SHORT

    def text(months: float) -> str:
        if math.isnan(months):
            return "open"
        return f"{math.ceil(MONTH * months)}" if short else number(months, 2)

    left, earliest, latest = map(
        text, (trend.months_to_threshold, trend.months_earliest, trend.months_latest)
    )
    return f"{left} {'days' if short else 'months'} ({earliest} to {latest})"


def cause_of(trend: TrendRow) -> EventCause:
    """Return the cause as the monitor describes it, with what to do."""
    if trend.parameter == STIFFNESS:
        return spring_change.KIND.cause("softer" if trend.change < 0.0 else "stiffer")
    return friction_drift.KIND.cause(trend.cause or "unknown")


def cause_name(trend: TrendRow) -> str:
    """Return the cause in words."""
    if trend.parameter == STIFFNESS and trend.state != MACHINE:
        return "a spring that is softer" if trend.change < 0.0 else "springs that are stiffer"
    names = {"oil_contamination": "contaminated oil", "oil_viscosity": "the oil's viscosity"}
    return names.get(trend.cause, trend.cause.replace("_", " ")) or "unknown"


def date(day: float) -> str:
    """Return the date of ``day`` since 1970."""
    return (_EPOCH + timedelta(days=day)).strftime("%Y-%m-%d") if math.isfinite(day) else "unknown"


def percent(share: float) -> str:
    """Return ``share`` in per cent without sign, two digits."""
    return f"{number(100.0 * abs(share), 2)} %"
