"""Figures of alarms for AlarmMetricsType (OPC 10000-9, 9.2), counted from the messages of the valves."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field
from datetime import datetime, timezone
from typing import NamedTuple

from asyncua import ua
from spool_monitor.alarm_statistics import PEAK_SPAN

_IDS, _KIND = ua.ObjectIds, ua.VariantType


class Figure(NamedTuple):
    """Value with its data type; ``minutes`` that a rate is over, 0 of what is no rate."""

    value: ua.Variant
    data_type: int
    minutes: int = 0


class Seen(NamedTuple):
    """What is known of an alarm: announcements, and since when it is active and unacknowledged, s."""

    occurrence: int
    since: tuple[float | None, ...]


@dataclass(slots=True)
class AlarmFigures:
    """Figures since the start of the server or the last reset, by this host's clock.

    Announcements are counted as in :mod:`spool_monitor.alarm_statistics`: of alarms that are not put aside.
    """

    start: float = field(default_factory=time.time)
    _began: float = field(default_factory=time.monotonic)
    _count: int = 0
    _peak: int = 0
    _longest: tuple[float, ...] = (0.0, 0.0)
    _stamps: deque[float] = field(default_factory=deque)
    _seen: dict[tuple[str, str], Seen] = field(default_factory=dict)

    def renewed(self) -> AlarmFigures:
        """Return figures that begin now; alarms that are active are so from now on."""
        new = AlarmFigures(_began=time.monotonic())
        for key, (occurrence, since) in self._seen.items():
            now = tuple(None if moment is None else new._began for moment in since)
            new._seen[key] = Seen(occurrence, now)
        return new

    def hear(
        self,
        key: tuple[str, str],
        occurrence: int,
        raised: float,
        *,
        shown: bool,
        active: bool,
        waiting: bool,
    ) -> None:
        """Count the alarm ``key`` (valve and name).

        Args:
            key: valve and name.
            occurrence: how often it was announced.
            raised: time of the last announcement, s since 1970.
            shown: whether it is active and not put aside.
            active: whether its cause is there.
            waiting: whether nobody acknowledged it.
        """
        now = time.monotonic()
        before = self._seen.get(key)
        if before is None:
            new = int(raised >= self.start)
        else:
            new = occurrence - before.occurrence if occurrence >= before.occurrence else 1
        if shown and new:
            self._count += new
            self._stamps.extend([now] * new)
            self._forget(now)
            self._peak = max(self._peak, len(self._stamps))
        self._longest = self._lasted(now, before)
        began = (None, None) if before is None or new else before.since
        since = (
            (now if moment is None else moment) if holds else None
            for moment, holds in zip(began, (active, waiting), strict=True)
        )
        self._seen[key] = Seen(occurrence, tuple(since))

    def _lasted(self, now: float, *alarms: Seen | None) -> tuple[float, ...]:
        """Return the longest times so far, s; those of ``alarms`` last until ``now``."""
        return tuple(
            max((longest, *(now - since for since in some if since is not None)))
            for longest, some in zip(
                self._longest,
                zip((None, None), *(one.since for one in alarms if one), strict=True),
                strict=True,
            )
        )

    def values(self) -> dict[str, Figure]:
        """Return the figures by their names in the standard; durations in ms."""
        now = time.monotonic()
        self._forget(now)
        active, waiting = self._lasted(now, *self._seen.values())
        # As long as nobody waited for a whole span, its rate is what came so far.
        average = self._count * PEAK_SPAN / max(PEAK_SPAN, now - self._began)

        def rate(value: float) -> Figure:
            return Figure(ua.Variant(round(value, 3), _KIND.Double), _IDS.Double, round(PEAK_SPAN / 60.0))

        def duration(seconds: float) -> Figure:
            return Figure(ua.Variant(1e3 * float(round(seconds)), _KIND.Double), _IDS.Duration)

        return {
            "AlarmCount": Figure(ua.Variant(self._count, _KIND.UInt32), _IDS.UInt32),
            "StartTime": Figure(ua.Variant(datetime.fromtimestamp(self.start, timezone.utc)), _IDS.UtcTime),
            "MaximumActiveState": duration(active),
            "MaximumUnAck": duration(waiting),
            "CurrentAlarmRate": rate(len(self._stamps)),
            "MaximumAlarmRate": rate(self._peak),
            "MaximumReAlarmCount": Figure(ua.Variant(0, _KIND.UInt32), _IDS.UInt32),
            "AverageAlarmRate": rate(average),
        }

    def _forget(self, now: float) -> None:
        while self._stamps and now - self._stamps[0] >= PEAK_SPAN:
            self._stamps.popleft()
