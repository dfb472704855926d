"""News of the fleet: what the last month brought, counted back from the newest bag."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone

from spool_core.text import plural

from spool_fleet.tables.query import ask
from spool_fleet.trends.change_test import MONTH
from spool_fleet.trends.judgement import MACHINE

from .content import PageContent, ValveContent
from .sentences import date
from .trend_rows import TrendRow

#: Services and silent valves of the last month that are named one by one at most.
MOST_NAMED = 10


@dataclass(frozen=True, slots=True)
class Change:
    """Change of one valve, or of several of a machine together, of which ``trend`` is the middle one."""

    valves: tuple[ValveContent, ...]
    trend: TrendRow

    @property
    def noticed(self) -> float:
        """Day on which it could be seen first; where that is not known, when it began."""
        return self.trend.noticed if math.isfinite(self.trend.noticed) else self.trend.since


@dataclass(frozen=True, slots=True)
class News:
    """News of the month since the day ``since``; ``older`` changes were seen before and still stand."""

    since: float
    changes: tuple[Change, ...]
    older: tuple[Change, ...]
    lines: tuple[str, ...]


def news_of(content: PageContent) -> News:
    """Return what the last month brought."""
    since = content.month_ago
    changes = sorted(_changes(content), key=lambda one: -one.trend.share_of_limit)
    lines = [] if content.newest is None else _counts(content, content.newest)
    silent = [one for one in content.valves if one.silent and one.overdue <= MONTH]
    lines += [
        f"{one.name} fell silent: no usable bag for {one.quiet:.0f} days." for one in silent[:MOST_NAMED]
    ]
    if len(silent) > MOST_NAMED:
        lines.append(f"{plural(len(silent) - MOST_NAMED, 'other valve')} fell silent as well.")
    recent = [one for one in content.services if one.day >= since]
    for one in recent[-MOST_NAMED:]:
        whose = " ".join(filter(None, (one.machine, one.valve))) or "all machines"
        said = f" ({one.comment})" if one.comment else ""
        lines.append(f"{whose}: {one.kind.replace('_', ' ')} on {date(one.day)}{said}.")
    return News(
        since,
        tuple(one for one in changes if one.noticed >= since),
        tuple(one for one in changes if not one.noticed >= since),
        tuple(lines),
    )


def _changes(content: PageContent) -> list[Change]:
    single: list[Change] = []
    shared: dict[tuple[str, str], list[tuple[ValveContent, TrendRow]]] = {}
    for valve in content.valves:
        for trend in valve.trends:
            if trend.state == MACHINE:
                shared.setdefault((trend.machine, trend.parameter), []).append((valve, trend))
            elif trend.changed:
                single.append(Change((valve,), trend))
    for same in shared.values():
        middle = sorted((trend for _, trend in same), key=lambda one: one.change)[len(same) // 2]
        single.append(Change(tuple(valve for valve, _ in same), middle))
    return single


def _counts(content: PageContent, newest: datetime) -> list[str]:
    """Return lines on bags and events of the last month."""
    begin = datetime(1970, 1, 1, tzinfo=timezone.utc) + timedelta(days=content.month_ago)
    recent = (
        f"start > TIMESTAMPTZ '{begin:%Y-%m-%d %H:%M:%S}+00' AND start <= TIMESTAMPTZ '{newest.isoformat()}'"
    )
    (row,) = ask(
        content.store,
        f"SELECT (SELECT count(*) FROM bags WHERE {recent}) AS bags, "
        f"(SELECT count(*) FROM bags WHERE {recent} AND status = 'damaged') AS damaged, "
        f"(SELECT count(*) FROM analyses WHERE {recent} AND status <> 'ok') AS failed, "
        f"(SELECT count(*) FROM events WHERE {recent} AND state = 'raised') AS raised, "
        "(SELECT count(DISTINCT (machine, valve)) FROM events "
        f"WHERE {recent} AND state = 'raised') AS valves",
    ).to_pylist()
    lines = [
        f"{plural(row['bags'], 'bag')}; {row['damaged']} of them damaged, "
        f"{plural(row['failed'], 'analysis').replace('analysiss', 'analyses')} failed."
    ]
    if row["raised"]:
        lines.append(
            f"The monitor raised {plural(row['raised'], 'event')} on {plural(row['valves'], 'valve')}."
        )
    return lines
