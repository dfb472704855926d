"""Lights of the fleet's page: the state of a valve as a colour, a mark and a word."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from spool_fleet.trends.judgement import CHANGED, LEARNING, MACHINE, UNKNOWN

from .trend_rows import TrendRow

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
