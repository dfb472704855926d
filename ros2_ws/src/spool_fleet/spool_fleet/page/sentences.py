"""Sentences of the fleet's page: what changed, since when, why, what to do."""

from __future__ import annotations

import math
from datetime import datetime, timedelta, timezone

from spool_core.uncertainty import interval, number
from spool_monitor.detectors import friction_drift, spring_change
from spool_monitor.events.event import EventCause

from spool_fleet.trends.change_test import MONTH
from spool_fleet.trends.judgement import MACHINE
from spool_fleet.trends.observations import STIFFNESS

from .trend_rows import NAMES, TrendRow

#: Months below which days are told: half a month rounded to two digits says too little or too much.
SHORT = 1.0
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)


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
