"""Figures of an alarm system by ISA-18.2 (clause 16) and EEMUA 191, from the journals of its valves."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

from spool_core.errors import InputError

from spool_monitor.journal import JournalEntry

HOUR, DAY = 3600.0, 86400.0

#: s, the span that ISA-18.2 counts peaks and floods in.
PEAK_SPAN = 600.0

#: Alarms in a span of 10 min with which a flood begins, and below which it ends (ISA-18.2, table 5).
FLOOD_BEGINS, FLOOD_ENDS = 11, 5

#: An alarm chatters when it is announced so often within this time, s (EEMUA 191: three times a minute).
CHATTERS, CHATTER_SPAN = 3, 60.0

#: s after which an alarm that stands is stale (ISA-18.2, 16.5.4).
STALE = DAY

#: States of an alarm that stands and is not put aside.
ACTIVE = ("unacknowledged", "acknowledged")

#: Alarms in the list of the most frequent: of ten ISA-18.2 asks for the share.
MOST_FREQUENT = 10

_SECOND = 1e-9


@dataclass(frozen=True, slots=True)
class AlarmLimits:
    """Limits of the site, each the largest value that is acceptable; default: ISA-18.2, table 5, an operator.

    Attributes:
        per_day: alarms a day.
        per_hour: alarms an hour, on average.
        peak: alarms in 10 min, at most.
        flood_share: share of the time in flood.
        frequent_share: share of the ten most frequent alarms.
        chattering: alarms that chatter.
        stale: alarms that have been active for a day.
    """

    per_day: float = 150.0
    per_hour: float = 6.0
    peak: float = 10.0
    flood_share: float = 0.01
    frequent_share: float = 0.05
    chattering: float = 0.0
    stale: float = 5.0

    def changed(self, settings: Iterable[str]) -> AlarmLimits:
        """Return the limits with ``settings``, each ``NAME=VALUE``.

        Raises:
            InputError: there is no such limit, or the value is no number of 0 or more.

        """
        values = {}
        names = [one.name for one in fields(self)]
        for setting in settings:
            name, mark, text = setting.partition("=")
            if name not in names or not mark:
                raise InputError(f"--limit {setting}: write NAME=VALUE; there are: {', '.join(names)}")
            try:
                values[name] = float(text)
            except ValueError:
                values[name] = math.nan
            if not 0.0 <= values[name] < math.inf:
                raise InputError(f"--limit {setting}: use a number of 0 or more")
        return replace(self, **values)


@dataclass(frozen=True, slots=True)
class FrequentAlarm:
    """One of the most frequent alarms.

    Attributes:
        valve: namespace.
        alarm: its name.
        code: number of kind and cause.
        count: how often it was announced.
        share: of all.
    """

    valve: str
    alarm: str
    code: int
    count: int
    share: float


@dataclass(frozen=True, slots=True)
class AlarmStatistics:
    """Figures of a span, by the names of ISA-18.2.

    Attributes:
        since, until: ends of the span, ns since 1970.
        count: alarms that were announced.
        per_day, per_hour: means over the part of the span that the journals cover.
        peak: most alarms in any 10 min.
        flood_share: share of the span in flood: from more than 10 alarms in 10 min to fewer than 5.
        frequent: the ten most frequent alarms.
        frequent_share: their share of all.
        chattering: alarms announced three times in a minute or more often, as ``(valve, alarm)``.
        stale: alarms that stood for a day or longer, as ``(valve, alarm)``.
        by_severity: how many of each severity.
    """

    since: int
    until: int
    count: int
    per_day: float
    per_hour: float
    peak: int
    flood_share: float
    frequent: tuple[FrequentAlarm, ...]
    frequent_share: float
    chattering: tuple[tuple[str, str], ...]
    stale: tuple[tuple[str, str], ...]
    by_severity: dict[str, int]

    def beyond(self, limits: AlarmLimits) -> tuple[str, ...]:
        """Return the names of the figures that are above ``limits``."""
        # The ten most frequent are all of them where there are ten different ones or fewer.
        few = sum(one.count for one in self.frequent) == self.count
        above = [one.name for one in fields(limits) if _plain(self, one.name) > getattr(limits, one.name)]
        return tuple(name for name in above if not (few and name == "frequent_share"))


def statistics(journals: Mapping[str, Sequence[JournalEntry]], since: int, until: int) -> AlarmStatistics:
    """Return the figures of the span from ``since`` to before ``until``, ns since 1970.

    Args:
        journals: entries of each valve by namespace, in the order of writing; those from before ``since``
            show which alarms stood then.
        since: begin of the span.
        until: end of the span.

    Raises:
        InputError: the span is empty.

    """
    if until <= since:
        raise InputError("statistics: the span is empty: it must end after its beginning")
    announced: list[tuple[int, str, JournalEntry]] = []
    chattering: set[tuple[str, str]] = set()
    stale: set[tuple[str, str]] = set()
    for valve, entries in journals.items():
        standing: dict[str, int] = {}
        lately: dict[str, deque[int]] = {}
        for one in entries:
            if one.stamp >= until:
                continue
            if one.state in ACTIVE:
                standing.setdefault(one.alarm, one.stamp)
            else:
                begin = standing.pop(one.alarm, one.stamp)
                if one.stamp > since and (one.stamp - begin) * _SECOND >= STALE:
                    stale.add((valve, one.alarm))
            if one.action != "raise" or one.state not in ACTIVE or one.stamp < since:
                continue
            announced.append((one.stamp, valve, one))
            times = lately.setdefault(one.alarm, deque(maxlen=CHATTERS))
            times.append(one.stamp)
            if len(times) == CHATTERS and (times[-1] - times[0]) * _SECOND <= CHATTER_SPAN:
                chattering.add((valve, one.alarm))
        stale |= {(valve, alarm) for alarm, begin in standing.items() if (until - begin) * _SECOND >= STALE}
    stamps = sorted(stamp for stamp, _, _ in announced)
    first = min((entries[0].stamp for entries in journals.values() if entries), default=since)
    # An hour at least: a rate of a few minutes is none.
    days = max((until - max(first, since)) * _SECOND, HOUR) / DAY
    counts = Counter((valve, one.alarm) for _, valve, one in announced)
    codes = {(valve, one.alarm): one.code for _, valve, one in announced}
    total = len(announced)
    frequent = tuple(
        FrequentAlarm(*key, codes[key], count, count / total)
        for key, count in sorted(counts.items(), key=lambda item: (-item[1], item[0]))[:MOST_FREQUENT]
    )
    return AlarmStatistics(
        since=since,
        until=until,
        count=total,
        per_day=total / days,
        per_hour=total / days / 24.0,
        peak=peak_of(stamps),
        flood_share=flood_share(stamps, since, until),
        frequent=frequent,
        frequent_share=sum(one.share for one in frequent),
        chattering=tuple(sorted(chattering)),
        stale=tuple(sorted(stale)),
        by_severity=dict(sorted(Counter(one.severity for _, _, one in announced).items())),
    )


def peak_of(stamps: Sequence[int]) -> int:
    """Return the most of the sorted ``stamps`` (ns) that lie in any 10 min."""
    span = round(PEAK_SPAN * 1e9)
    return max(
        (place + 1 - bisect_left(stamps, stamp - span + 1) for place, stamp in enumerate(stamps)), default=0
    )


def flood_share(stamps: Sequence[int], since: int, until: int) -> float:
    """Return the share of ``since`` to ``until`` in which an operator is flooded (ISA-18.2, 16.5.3).

    The alarms of the last 10 min are counted at every moment; a flood begins with more than 10 of them and
    ends when there are fewer than 5.

    Args:
        stamps: of announced alarms, sorted, ns.
        since: begin, ns.
        until: end, ns.

    """
    span = round(PEAK_SPAN * 1e9)
    # An alarm enters the window at its stamp and leaves it 10 min later; one that enters goes first.
    moves = sorted([(stamp, -1) for stamp in stamps] + [(stamp + span, 1) for stamp in stamps])
    inside, begun, total = 0, None, 0
    for moment, leaves in moves:
        inside -= leaves
        if begun is None and inside >= FLOOD_BEGINS:
            begun = moment
        elif begun is not None and inside < FLOOD_ENDS:
            total += max(0, min(moment, until) - max(begun, since))
            begun = None
    return total / (until - since)


def figures(found: AlarmStatistics, limits: AlarmLimits) -> list[tuple[str, str, str, bool]]:
    """Return name, value, limit and whether it is kept of each figure; shares in per cent."""
    beyond = found.beyond(limits)
    rows = []
    for one in fields(limits):
        plain, limit = _plain(found, one.name), getattr(limits, one.name)
        scale = 100.0 if one.name.endswith("_share") else 1.0
        digits = 0 if one.name in ("peak", "chattering", "stale") else 2
        rows.append((one.name, f"{scale * plain:.{digits}f}", f"{scale * limit:g}", one.name not in beyond))
    return rows


def _plain(found: AlarmStatistics, name: str) -> float:
    """Return the figure ``name`` as a number: of a list, how many it holds."""
    value = getattr(found, name)
    return float(len(value) if isinstance(value, tuple) else value)
